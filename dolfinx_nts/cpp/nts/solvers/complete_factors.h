#pragma once

#include "nts/solvers/blocks.h"
#include "nts/solvers/dense_panels.h"
#include "nts/solvers/nested_dissection.h"

#include <memory>
#include <optional>

namespace nts
{
/// @brief Complete LU factors of a sparse matrix with a symmetric pattern of
/// blocks, in single precision, by fronts (I. S. Duff, J. K. Reid, ACM Trans.
/// Math. Softw. 9 (1983)).
///
/// A front is the dense matrix of the nodes of one set of `NestedDissection`
/// and of the nodes coupled to them. It is stored in panels of `panel` rows, in
/// the order in which they are read: the inverse D of the diagonal block, the
/// columns L below it, and D times the rows U right of it. Single precision
/// takes half the memory, whose bandwidth limits the solution.
class CompleteFactors
{
public:
  /// @brief Choose the order of elimination.
  /// @param[in] start, column Pattern of the blocks, the same for columns as
  /// for rows, columns of a row ascending.
  /// @param[in] X Positions of the nodes, (n, 3).
  CompleteFactors(std::span<const std::int64_t> start,
                  std::span<const std::int32_t> column,
                  std::span<const double> X)
      : _nodes(start.size() - 1), _blocks(column.size()), _place(_nodes)
  {
    NestedDissection dissection(start, column, X, smallest);
    _order = std::move(dissection.order);
    for (std::size_t i = 0; i < _nodes; ++i)
      _place[_order[i]] = static_cast<std::int32_t>(i);
    std::vector<std::vector<std::int32_t>> children(dissection.sets.size());
    std::vector<std::int32_t> last(_nodes, -1); // front that has a node
    for (std::size_t f = 0; f < dissection.sets.size(); ++f)
    {
      const auto& set = dissection.sets[f];
      Front front
          = {.begin = set.begin, .end = set.end, .children = {}, .reached = {}};
      const auto reach = [&](std::int32_t place)
      {
        if (static_cast<std::size_t>(place) >= front.end
            && std::exchange(last[place], static_cast<std::int32_t>(f))
                   != static_cast<std::int32_t>(f))
          front.reached.push_back(place);
      };
      for (std::size_t i = front.begin; i < front.end; ++i)
        for (auto e = start[_order[i]]; e < start[_order[i] + 1]; ++e)
          reach(_place[column[e]]);
      for (const std::int32_t child : children[f])
        for (const std::int32_t place : _fronts[child].reached)
          reach(place);
      std::ranges::sort(front.reached);
      front.children = std::move(children[f]);
      if (set.parent >= 0)
        children[set.parent].push_back(static_cast<std::int32_t>(f));
      _fronts.push_back(std::move(front));
    }
  }

  /// @brief Whether a pattern agrees with the factors.
  bool fits(std::span<const std::int64_t> start,
            std::span<const std::int32_t> column) const noexcept
  {
    return start.size() == _nodes + 1 && column.size() == _blocks;
  }

  /// @brief Factorise.
  /// @param[in] A Matrix with the pattern.
  /// @return False if a block on the diagonal is singular.
  template <std::size_t B>
  bool factorise(const BlockMatrix<B>& A)
  {
    _dim = B;
    _is_made = false;
    double most = 0;
    for (std::size_t i = 0; i < _nodes; ++i)
      for (auto e = A.start[i]; e < A.start[i + 1]; ++e)
        if (static_cast<std::size_t>(A.column[e]) == i)
          most = std::max(most, A.diagonal(static_cast<std::size_t>(e)));
    _scale = power_of_two(most);
    std::size_t entries = 0;
    for (Front& front : _fronts)
    {
      front.first = entries;
      entries += size(front);
    }
    _entry.resize(entries);
    std::vector<std::vector<float>> updates(_fronts.size());
    std::vector<std::int32_t> local(_nodes); // local numbers in the front
    std::vector<float> F;
    for (std::size_t f = 0; f < _fronts.size(); ++f)
    {
      const Front& front = _fronts[f];
      const std::size_t n = B * front.nodes();
      F.assign(n * n, 0);
      number(front, local);
      gather(A, front, local, F);
      for (const std::int32_t child : front.children)
      {
        add(_fronts[child], updates[child], local, F, n);
        updates[child] = {};
      }
      if (!eliminate(front, F, n))
        return false;
      const std::size_t own = B * front.own(), m = n - own;
      updates[f].resize(m * m);
      for (std::size_t i = 0; i < m; ++i)
        std::copy_n(F.data() + (own + i) * n + own, m,
                    updates[f].data() + i * m);
    }
    _is_made = true;
    return true;
  }

  /// @brief x = A^-1 b. @param[in] b Right-hand sides, each (n, B),
  /// concatenated.
  /// @param[out] x Solutions; may be b.
  void apply(std::span<const double> b, std::span<double> x)
  {
    const std::size_t n = _dim * _nodes;
    if (b.size() == n)
      return solve<1>(b, x, 1);
    for (std::size_t first = 0; first < b.size(); first += wide * n)
    {
      const std::size_t size = std::min(wide * n, b.size() - first);
      solve<wide>(b.subspan(first, size), x.subspan(first, size), size / n);
    }
  }

  /// @brief Number of rows, 0 without factors.
  std::size_t size() const noexcept { return _is_made ? _nodes : 0; }

  /// @brief Components of a node.
  std::size_t dim() const noexcept { return _dim; }

  /// @brief Number of entries of the factors.
  std::size_t entries() const noexcept { return _entry.size(); }

private:
  /// Least number of nodes that are eliminated together.
  static constexpr std::size_t smallest = panel / 3;

  struct Front
  {
    std::size_t begin, end;             ///< places of its own nodes
    std::vector<std::int32_t> children; ///< fronts whose updates it takes
    std::vector<std::int32_t> reached;  ///< places of other nodes, ascending
    std::size_t first = 0;              ///< entry of the factors

    std::size_t own() const noexcept { return end - begin; }
    std::size_t nodes() const noexcept { return own() + reached.size(); }
  };

  /// @brief Number of entries of the factors of a front.
  std::size_t size(const Front& front) const noexcept
  {
    // Consecutive panels: the square of the whole minus the square of the rest.
    const std::size_t n = _dim * front.nodes(), m = n - _dim * front.own();
    return n * n - m * m;
  }

  /// @brief Number the nodes of a front.
  static void number(const Front& front, std::vector<std::int32_t>& local)
  {
    for (std::size_t i = front.begin; i < front.end; ++i)
      local[i] = static_cast<std::int32_t>(i - front.begin);
    for (std::size_t i = 0; i < front.reached.size(); ++i)
      local[front.reached[i]] = static_cast<std::int32_t>(front.own() + i);
  }

  /// @brief Copy the blocks in rows and columns of the front's own nodes to the
  /// front.
  template <std::size_t B>
  void gather(const BlockMatrix<B>& A, const Front& front,
              const std::vector<std::int32_t>& local,
              std::vector<float>& F) const
  {
    const std::size_t n = B * front.nodes();
    const auto put
        = [&](const double* block, std::size_t row, std::size_t column)
    {
      for (std::size_t r = 0; r < B; ++r)
        for (std::size_t c = 0; c < B; ++c)
          F[(B * row + r) * n + B * column + c]
              = static_cast<float>(_scale * block[B * r + c]);
    };
    for (std::size_t i = front.begin; i < front.end; ++i)
    {
      const std::int32_t node = _order[i];
      const auto row = static_cast<std::size_t>(local[i]);
      for (auto e = A.start[node]; e < A.start[node + 1]; ++e)
      {
        const std::int32_t other = A.column[e], place = _place[other];
        if (static_cast<std::size_t>(place) < front.begin)
          continue;
        const auto column = static_cast<std::size_t>(local[place]);
        put(A[e], row, column);
        if (static_cast<std::size_t>(place) < front.end)
          continue;
        const auto columns = A.row(other);
        const auto at = std::ranges::lower_bound(columns, node);
        put(A[static_cast<std::size_t>(A.start[other]
                                       + (at - columns.begin()))],
            column, row);
      }
    }
  }

  /// @brief Add the Schur complement of a child to a front.
  void add(const Front& child, const std::vector<float>& update,
           const std::vector<std::int32_t>& local, std::vector<float>& F,
           std::size_t n) const
  {
    const std::size_t m = child.reached.size(), B = _dim;
    for (std::size_t i = 0; i < m; ++i)
      for (std::size_t r = 0; r < B; ++r)
      {
        const float* from = update.data() + (B * i + r) * B * m;
        float* row
            = F.data()
              + (B * static_cast<std::size_t>(local[child.reached[i]]) + r) * n;
        for (std::size_t j = 0; j < m; ++j)
        {
          float* to
              = row + B * static_cast<std::size_t>(local[child.reached[j]]);
          for (std::size_t c = 0; c < B; ++c)
            to[c] += from[B * j + c];
        }
      }
  }

  /// @brief Eliminate a front's own nodes, and keep the factors.
  bool eliminate(const Front& front, std::vector<float>& F, std::size_t n)
  {
    float* entry = _entry.data() + front.first;
    for (std::size_t k = 0, own = _dim * front.own(); k < own; k += panel)
    {
      const std::size_t p = std::min(panel, own - k), m = n - k - p;
      float* const D = entry;
      for (std::size_t i = 0; i < p; ++i)
        std::copy_n(F.data() + (k + i) * n + k, p, D + i * p);
      if (!invert(D, p))
        return false;
      float* const L = D + p * p;
      for (std::size_t i = 0; i < m; ++i)
        std::copy_n(F.data() + (k + p + i) * n + k, p, L + i * p);
      float* const U = L + m * p;
      std::fill_n(U, p * m, 0.f);
      // The rows are stored with the opposite sign.
      subtract_product(D, p, F.data() + k * n + k + p, n, U, m, p, p, m);
      for (std::size_t i = 0; i < p * m; ++i)
        U[i] = -U[i];
      subtract_product(L, p, U, m, F.data() + (k + p) * n + k + p, n, m, p, m);
      entry = U + p * m;
    }
    return true;
  }

  /// @brief Solve for up to K right-hand sides together.
  template <std::size_t K>
  void solve(std::span<const double> b, std::span<double> x, std::size_t count)
  {
    const std::size_t n = _dim * _nodes;
    _x.assign(K * n, 0);
    double scale[K];
    const auto place = [&](std::size_t i, std::size_t c)
    { return _dim * static_cast<std::size_t>(_order[i]) + c; };
    for (std::size_t k = 0; k < count; ++k)
    {
      const std::span one = b.subspan(k * n, n);
      scale[k] = power_of_two(largest(one));
      for (std::size_t i = 0; i < _nodes; ++i)
        for (std::size_t c = 0; c < _dim; ++c)
          _x[K * (_dim * i + c) + k]
              = static_cast<float>(scale[k] * one[place(i, c)]);
    }
    for (const Front& front : _fronts)
      forward<K>(front);
    for (std::size_t f = _fronts.size(); f-- > 0;)
      backward<K>(_fronts[f]);
    for (std::size_t k = 0; k < count; ++k)
    {
      const double back = _scale / scale[k];
      for (std::size_t i = 0; i < _nodes; ++i)
        for (std::size_t c = 0; c < _dim; ++c)
          x[k * n + place(i, c)]
              = back * static_cast<double>(_x[K * (_dim * i + c) + k]);
    }
  }

  /// @brief Copy the values of a front's nodes to the work space.
  template <std::size_t K>
  void load(const Front& front)
  {
    const std::size_t width = K * _dim;
    _w.resize(width * front.nodes());
    std::copy_n(_x.data() + width * front.begin, width * front.own(),
                _w.data());
    float* w = _w.data() + width * front.own();
    for (const std::int32_t place : front.reached)
      w = std::copy_n(_x.data() + width * static_cast<std::size_t>(place),
                      width, w);
  }

  template <std::size_t K>
  void forward(const Front& front)
  {
    load<K>(front);
    const std::size_t n = _dim * front.nodes(), own = _dim * front.own(),
                      width = K * _dim;
    const float* entry = _entry.data() + front.first;
    for (std::size_t k = 0; k < own; k += panel)
    {
      const std::size_t p = std::min(panel, own - k), m = n - k - p;
      float* const w = _w.data() + K * k;
      float y[K * panel] = {};
      subtract_product<K>(entry, w, y, p, p);
      for (std::size_t i = 0; i < K * p; ++i)
        w[i] = without_dust(-y[i]);
      entry += p * p;
      subtract_product<K>(entry, w, w + K * p, m, p);
      entry += 2 * p * m;
    }
    std::copy_n(_w.data(), K * own, _x.data() + width * front.begin);
    const float* w = _w.data() + K * own;
    for (const std::int32_t place : front.reached)
    {
      std::copy_n(w, width,
                  _x.data() + width * static_cast<std::size_t>(place));
      w += width;
    }
  }

  template <std::size_t K>
  void backward(const Front& front)
  {
    load<K>(front);
    const std::size_t n = _dim * front.nodes(), own = _dim * front.own();
    const float* end = _entry.data() + front.first + size(front);
    // The last panel has the remaining columns.
    for (std::size_t p = own % panel ? own % panel : panel, k = own; k > 0;
         p = panel)
    {
      k -= p;
      const std::size_t m = n - k - p;
      float* const w = _w.data() + K * k;
      subtract_product<K>(end - p * m, w + K * p, w, p, m);
      end -= p * p + 2 * p * m;
      for (std::size_t i = 0; i < K * p; ++i)
        w[i] = without_dust(w[i]);
    }
    std::copy_n(_w.data(), K * own, _x.data() + K * _dim * front.begin);
  }

  std::size_t _nodes, _blocks, _dim = 3;
  bool _is_made = false;
  double _scale = 1;                // scale of the matrix
  std::vector<std::int32_t> _order; // nodes in the order of elimination
  std::vector<std::int32_t> _place; // position of each node in _order
  std::vector<Front> _fronts;       // each after its children
  std::vector<float> _entry;        // the factors
  std::vector<float> _x, _w;        // work space: all values, front
};
} // namespace nts
