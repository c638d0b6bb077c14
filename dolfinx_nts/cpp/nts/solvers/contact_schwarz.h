#pragma once

#include "nts/solvers/elimination.h"
#include "nts/solvers/incomplete_factors.h"

#include <numeric>

/// @brief Patch preconditioner: solves with the projected tangent
/// around the contacts.
///
/// A kept factorisation of the bulk knows nothing of contact. After it, the
/// patch solves for what remains at the nodes of the active pairs and their
/// neighbours in the matrix, with the rows of
///
///     A = Z~^T (K + C) Z + E E^T   (see elimination.h)
///
/// there; E E^T, scaled, fills the directions that are given up, in which
/// neither right-hand sides nor results have a part. Rows and factors are in
/// single precision.
namespace nts
{
/// @brief See the head of this file.
class ContactSchwarz
{
public:
  /// @param[in] K Bulk tangent; columns beyond its rows are of nodes that
  /// the patch does not change.
  explicit ContactSchwarz(const BlockMatrix& K) : _K(K)
  {
    std::size_t columns = K.start.size() - 1;
    for (const std::int32_t column : K.column)
      columns = std::max(columns, static_cast<std::size_t>(column) + 1);
    _number.assign(columns, -1);
  }

  /// @brief Nodes of the columns of K, at least those of its rows.
  std::size_t num_columns() const noexcept { return _number.size(); }

  /// @brief Add the active pairs of a contact pair, all nodes rows of K.
  template <class S>
  void add(const Elimination<S>& e)
  {
    constexpr std::size_t k = 1 + S::vertices, n = pair_size<S>;
    for (std::size_t i = 0; i < e.rank.size(); ++i)
    {
      const auto dofs = e.dofs.subspan(k * i, k);
      Pair& pair = _pairs.emplace_back();
      pair.constrained = e.rank[i] > 0;
      pair.nodes.assign(dofs.begin(), dofs.end());
      pair.tangent.resize(k * k);
      const double* C = e.tangent.data() + n * n * i;
      for (std::size_t a = 0; a < k; ++a)
        for (std::size_t b = 0; b < k; ++b)
          for (std::size_t c = 0; c < 3; ++c)
            std::copy_n(C + n * (3 * a + c) + 3 * b, 3,
                        pair.tangent[k * a + b][c].begin());
      if (pair.constrained)
        project(e, i, pair);
    }
  }

  /// @brief Be without pairs, with the memory of those there were.
  void clear() noexcept
  {
    for (const std::int32_t node : _nodes)
      _number[node] = -1;
    _pairs.clear();
    _nodes.clear();
    _size = 0;
    _exists = false;
  }

  /// @brief Choose the nodes and factorise.
  /// @return False if the factors do not exist.
  bool build()
  {
    number_nodes();
    std::vector<Parts> parts(_size);
    for (const Pair& pair : _pairs)
      for (std::size_t a = 0; a < pair.nodes.size(); ++a)
        parts[_number[pair.nodes[a]]].push_back({&pair, a});
    double largest = 0;
    for (std::size_t p = 0; p < _size; ++p)
      largest = std::max(largest, stiffness(p));
    _scale = power_of_two(largest);
    take_rows(parts);
    pack();
    make_projected(parts);
    std::vector<std::int32_t> order(_size);
    std::iota(order.begin(), order.end(), 0);
    return _exists = _factors.factorise(_projected, order);
  }

  /// @brief Constrain z = B r and correct it at the nodes of the patch.
  /// @param[in] r Right-hand side without a part in E, (n, 3).
  /// @param[in,out] z Values at the columns of K.
  void correct(std::span<const double> r, std::span<double> z)
  {
    for (const Pair& pair : _pairs)
      if (pair.constrained)
      {
        Vec3 x = {};
        for (std::size_t a = 0; a < pair.nodes.size(); ++a)
          add_product(pair.right[a], z.data() + 3 * pair.nodes[a], x.data());
        std::ranges::copy(x, z.begin() + 3 * pair.nodes[0]);
      }
    if (!_exists)
      return;
    double largest = 0;
    for (const std::int32_t node : _nodes)
      for (std::size_t c = 0; c < 3; ++c)
        largest = std::max(largest, std::abs(z[3 * node + c]));
    const double scale = power_of_two(largest);
    _z.resize(3 * _nodes.size());
    for (std::size_t p = 0; p < _nodes.size(); ++p)
      for (std::size_t c = 0; c < 3; ++c)
        _z[3 * p + c]
            = without_dust(static_cast<float>(scale * z[3 * _nodes[p] + c]));
    _x.resize(3 * _size);
    std::size_t e = 0;
    for (std::size_t p = 0; p < _size; ++p)
    {
      const Column product = _rows.product(e, _ends[p], _z.data());
      for (std::size_t c = 0; c < 3; ++c)
        _x[3 * p + c] = _scale * r[3 * _nodes[p] + c]
                        - static_cast<double>(product[c]) / scale;
    }
    for (const Pair& pair : _pairs)
    {
      if (!pair.constrained)
        continue;
      const std::size_t s = 3 * _number[pair.nodes[0]];
      const Vec3 rest = {_x[s], _x[s + 1], _x[s + 2]};
      std::fill_n(_x.begin() + s, 3, 0.0);
      for (std::size_t a = 0; a < pair.nodes.size(); ++a)
        add_product(pair.left[a], rest.data(),
                    _x.data() + 3 * _number[pair.nodes[a]]);
    }
    _factors.apply(_x, _x);
    for (std::size_t p = 0; p < _size; ++p)
      for (std::size_t c = 0; c < 3; ++c)
        z[3 * _nodes[p] + c] += _x[3 * p + c];
  }

  /// @brief Number of nodes in the patch.
  std::size_t size() const noexcept { return _size; }

private:
  struct Pair
  {
    bool constrained;
    std::vector<std::int32_t> nodes;  // contact node first
    std::vector<Block> tangent;       // C, (nodes, nodes)
    std::vector<Columns> right, left; // Z_0a and (Z~^T)_a0
    Columns given_up;                 // E E^T at the contact node
  };

  /// Pairs that a node takes part in, and its position in each.
  using Parts = std::vector<std::pair<const Pair*, std::size_t>>;

  /// @brief Blocks of the projections of pair i.
  template <class S>
  static void project(const Elimination<S>& e, std::size_t i, Pair& pair)
  {
    constexpr std::size_t n = pair_size<S>;
    const double* G = e.gradients.data() + 3 * n * i;
    const double* F = e.columns.data() + 3 * n * i;
    const double* normal = e.normal.data() + 3 * i;
    const auto constraints = static_cast<std::size_t>(e.rank[i]);
    // Directions in rows, and the inverses of G^T E and E^T F.
    Block E = identity, GE = identity, EF = identity;
    if (constraints == 1)
      std::copy_n(normal, 3, E[0].begin());
    for (std::size_t a = 0; a < constraints; ++a)
      for (std::size_t b = 0; b < constraints; ++b)
      {
        GE[a][b] = inner<3>(G + n * a, E[b].data());
        EF[a][b] = inner<3>(E[a].data(), F + n * b);
      }
    Block GE_inverse = identity, EF_inverse = identity;
    solve(GE, GE_inverse);
    solve(EF, EF_inverse);
    pair.right.clear();
    pair.left.clear();
    for (std::size_t K = 0; K < pair.nodes.size(); ++K)
    {
      Block right = K == 0 ? identity : Block{}, left = right;
      for (std::size_t a = 0; a < constraints; ++a)
        for (std::size_t b = 0; b < constraints; ++b)
          for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t d = 0; d < 3; ++d)
            {
              right[c][d] -= E[a][c] * GE_inverse[a][b] * G[n * b + 3 * K + d];
              left[c][d] -= F[n * a + 3 * K + c] * EF_inverse[a][b] * E[b][d];
            }
      pair.right.push_back(Columns::of(right));
      pair.left.push_back(Columns::of(left));
    }
    Block given_up = {};
    for (std::size_t a = 0; a < constraints; ++a)
      for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t d = 0; d < 3; ++d)
          given_up[c][d] += E[a][c] * E[a][d];
    pair.given_up = Columns::of(given_up);
  }

  /// @brief Number the nodes of pairs and their neighbours among the rows of
  /// K, and then the nodes outside that their rows reach.
  void number_nodes()
  {
    constexpr std::int32_t chosen = 0;
    const auto choose = [&](std::int32_t node)
    {
      if (_number[node] >= 0)
        return;
      _number[node] = chosen;
      _nodes.push_back(node);
    };
    const auto is_row = [&](std::int32_t node)
    { return static_cast<std::size_t>(node) + 1 < _K.start.size(); };
    for (const Pair& pair : _pairs)
      for (const std::int32_t node : pair.nodes)
      {
        choose(node);
        for (const std::int32_t column : _K.row(node))
          if (is_row(column))
            choose(column);
      }
    std::ranges::sort(_nodes);
    _size = _nodes.size();
    for (std::size_t p = 0; p < _size; ++p)
      for (const std::int32_t column : _K.row(_nodes[p]))
        choose(column);
    for (std::size_t p = 0; p < _nodes.size(); ++p)
      _number[_nodes[p]] = static_cast<std::int32_t>(p);
  }

  /// @brief Take the rows of K + C, with all their columns, scaled.
  void take_rows(const std::vector<Parts>& parts)
  {
    _all.clear(_nodes.size());
    for (std::size_t p = 0; p < _size; ++p)
    {
      for (std::int64_t e = _K.start[_nodes[p]]; e < _K.start[_nodes[p] + 1];
           ++e)
        _all[_number[_K.column[e]]] = _K.block(e, _scale);
      for (const auto& [pair, a] : parts[p])
        for (std::size_t b = 0; b < pair->nodes.size(); ++b)
          _all[_number[pair->nodes[b]]]
              += Columns::of(pair->tangent[pair->nodes.size() * a + b], _scale);
      _all.end_row();
    }
  }

  /// @brief Keep the rows for products.
  void pack()
  {
    _ends.assign(_all.start.begin() + 1, _all.start.end());
    _rows.resize(_all.column.size());
    for (std::size_t e = 0; e < _all.column.size(); ++e)
      _rows.put(e, _all.column[e], _all.value[e]);
  }

  /// @brief Make Z~^T rows Z + E E^T in the patch.
  void make_projected(const std::vector<Parts>& parts)
  {
    std::vector<const Pair*> constrainer(_size, nullptr); // of each node
    for (const Pair& pair : _pairs)
      if (pair.constrained)
        constrainer[_number[pair.nodes[0]]] = &pair;

    const auto add_row = [&](std::size_t p, BlockRows& result)
    {
      for (std::int64_t e = _all.start[p]; e < _all.start[p + 1]; ++e)
      {
        const std::int32_t q = _all.column[e];
        if (static_cast<std::size_t>(q) >= _size)
          continue;
        if (const Pair* pair = constrainer[q])
          for (std::size_t b = 0; b < pair->nodes.size(); ++b)
            result[_number[pair->nodes[b]]] += _all.value[e] * pair->right[b];
        else
          result[q] += _all.value[e];
      }
    };
    // Z~^T adds rows of constrained nodes to those of their pairs.
    _constrained.clear(_size);
    std::vector<std::size_t> place(_size, 0); // in them
    for (std::size_t p = 0; p < _size; ++p)
      if (constrainer[p])
      {
        place[p] = _constrained.size();
        add_row(p, _constrained);
        _constrained.end_row();
      }
    _projected.clear(_size);
    for (std::size_t p = 0; p < _size; ++p)
    {
      if (!constrainer[p])
        add_row(p, _projected);
      for (const auto& [pair, a] : parts[p])
        if (pair->constrained)
        {
          const std::size_t i = place[_number[pair->nodes[0]]];
          for (std::int64_t e = _constrained.start[i];
               e < _constrained.start[i + 1]; ++e)
            _projected[_constrained.column[e]]
                += pair->left[a] * _constrained.value[e];
        }
      if (constrainer[p])
        _projected[static_cast<std::int32_t>(p)]
            += constrainer[p]->given_up
               * static_cast<float>(_scale * stiffness(p));
      _projected.end_row();
    }
  }

  /// @brief Mean size of the entries on the diagonal of K at a node.
  double stiffness(std::size_t p) const noexcept
  {
    double sum = 0;
    for (std::int64_t e = _K.start[_nodes[p]]; e < _K.start[_nodes[p] + 1]; ++e)
      if (_K.column[e] == _nodes[p])
        for (std::size_t d = 0; d < 3; ++d)
          sum += std::abs(_K[e][4 * d]);
    return sum / 3;
  }

  BlockMatrix _K;
  std::vector<Pair> _pairs;
  BlockRows _all, _constrained, _projected; // while the factors are made
  std::vector<std::int32_t> _nodes;         // of the patch, then those outside
  std::vector<std::int32_t> _number; // of each node, -1 where there is none
  std::size_t _size = 0;             // of the patch
  PackedRows _rows;                  // of K + C, times _scale as the factors
  std::vector<std::size_t> _ends;    // of each
  double _scale = 1;
  IncompleteFactors _factors;
  bool _exists = false; // the factors
  std::vector<float> _z;
  std::vector<double> _x;
};
} // namespace nts
