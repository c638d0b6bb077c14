#pragma once

#include "nts/processors.h"
#include "nts/solvers/blocks.h"

#include <ranges>
#include <utility>
#include <vector>

namespace nts
{
/// @brief Pattern of incomplete factors of a sparse matrix, row by row.
/// @tparam Rows `BlockMatrix` or `BlockRows`; columns beyond its rows are
/// left out.
template <class Rows>
class FactorPattern
{
public:
  /// Marks an entry of fill-in, which the matrix does not have.
  static constexpr std::int64_t filled = -1;

  /// @brief Columns in the order of elimination, each with the index of its
  /// entry in the matrix, or `filled`.
  using Entries = std::vector<std::pair<std::int32_t, std::int64_t>>;

  /// @param[in] A The matrix.
  /// @param[in] order Its rows in the order of elimination.
  /// @param[in] fill Whether the pattern also has the entries between
  /// neighbours of a node that was eliminated before: ILU(1) instead of
  /// ILU(0).
  FactorPattern(const Rows& A, std::span<const std::int32_t> order, bool fill)
      : _A(A), _order(order), _place(order.size()), _last(order.size(), -1),
        _fill(fill)
  {
    for (std::size_t i = 0; i < order.size(); ++i)
      _place[order[i]] = static_cast<std::int32_t>(i);
  }

  /// @brief Entries of row i in any order, valid until the next call.
  Entries& row(std::int32_t i)
  {
    _entries.clear();
    for_each(i, [&](std::int32_t column, std::int64_t e)
             { _entries.push_back({column, e}); });
    if (_fill)
    {
      for (const auto& [column, e] : _entries)
        _last[column] = i;
      for (std::size_t own = _entries.size(), c = 0; c < own; ++c)
        if (const std::int32_t k = _entries[c].first; k < i)
          for_each(k,
                   [&](std::int32_t column, std::int64_t)
                   {
                     if (column > k && std::exchange(_last[column], i) != i)
                       _entries.push_back({column, filled});
                   });
    }
    return _entries;
  }

private:
  /// @brief Call a function for each entry of the matrix in row i.
  template <class Function>
  void for_each(std::int32_t i, const Function& function) const
  {
    const std::int32_t node = _order[i];
    for (std::int64_t e = _A.start[node]; e < _A.start[node + 1]; ++e)
      if (static_cast<std::size_t>(_A.column[e]) < _order.size())
        function(_place[_A.column[e]], e);
  }

  const Rows& _A;
  std::span<const std::int32_t> _order;
  std::vector<std::int32_t> _place; // place of each row in `_order`
  std::vector<std::int32_t> _last;  // row that had this column
  bool _fill;
  Entries _entries;
};

/// @brief Incomplete LU factors of a sparse matrix with B x B blocks in single
/// precision, see `FactorPattern`.
///
/// They are L D U with diagonal blocks of ones in L and U. They are stored in
/// the order in which the solution reads them: the rows of L forward, then the
/// rows of U backward, each with its block of D^-1 at the end. Each row depends
/// on the previous row, so that latencies add up.
template <std::size_t B>
class IncompleteFactors
{
public:
  /// @brief Factorise.
  /// @param[in] A Rows, `BlockMatrix` or `BlockRows`; columns beyond them are
  /// left out.
  /// @param[in] order The rows in the order of elimination.
  /// @param[in] fill See `FactorPattern`.
  /// @return False if a block on the diagonal is singular.
  template <class Rows>
  NTS_FOR_PROCESSORS bool factorise(const Rows& A,
                                    std::span<const std::int32_t> order,
                                    bool fill = false)
  {
    const std::size_t n = order.size();
    _order.assign(order.begin(), order.end());
    FactorPattern<Rows> pattern(A, order, fill);
    allocate(A, pattern);
    std::vector<std::int32_t> at(n, -1); // columns in the current row
    std::vector<Columns<B>> row;
    for (std::size_t i = 0; i < n; ++i)
    {
      auto& entries = pattern.row(static_cast<std::int32_t>(i));
      if (!std::ranges::is_sorted(entries))
        std::ranges::sort(entries);
      row.clear();
      for (const auto& [column, e] : entries)
      {
        at[column] = static_cast<std::int32_t>(row.size());
        row.push_back(e == pattern.filled ? Columns<B>{}
                                          : A.block(e, _scale).without_dust());
      }
      const std::size_t diagonal = _begin[i + 1] - _begin[i];
      if (!(diagonal < row.size()
            && static_cast<std::size_t>(entries[diagonal].first) == i))
        return fail();
      for (std::size_t c = 0; c < diagonal; ++c)
      {
        // L_ik = A_ik D_k^-1, then A_ij -= A_ik U_kj.
        const auto k = static_cast<std::size_t>(entries[c].first);
        const std::size_t end = _begin[2 * n - k] - 1;
        const Columns<B> A_ik = row[c].without_dust();
        _factors.put(_begin[i] + c, entries[c].first,
                     (A_ik * _factors[end]).without_dust());
        for (std::size_t u = _begin[2 * n - 1 - k]; u < end; ++u)
          if (const std::int32_t target = at[_factors.node(u)]; target >= 0)
            row[target] -= A_ik * _factors[u];
      }
      Block<B> pivot = row[diagonal].block(), inverse = identity<B>;
      if (!solve(pivot, inverse))
        return fail();
      const auto D = Columns<B>::of(inverse).without_dust();
      std::size_t u = _begin[2 * n - 1 - i];
      for (std::size_t c = diagonal + 1; c < row.size(); ++c)
        _factors.put(u++, entries[c].first,
                     (D * row[c].without_dust()).without_dust());
      _factors.put(u, entries[diagonal].first, D);
      for (const auto& [column, e] : entries)
        at[column] = -1;
    }
    return true;
  }

  /// @brief x = (L U)^-1 b.
  /// @param[in] b Right-hand side of all rows, or of the first ones.
  /// @param[out] x Values of the first rows, all or fewer; may be b.
  /// @param[in] behind Right-hand side of the rows after b.
  void apply(std::span<const double> b, std::span<double> x,
             std::span<const double> behind = {})
  {
    _x.resize(B * size());
    substitute(std::views::iota(std::size_t(0), size()), b, x, behind);
  }

  /// @brief x = (L U)^-1 b for some rows, with zero in place of all other
  /// entries of b.
  /// @param[in] places Places of these rows in the order of elimination,
  /// ascending.
  /// @param[in] b Right-hand side of all rows, or of the first ones.
  /// @param[out] x Values of the first rows, all or fewer; only the given rows
  /// are changed.
  /// @param[in] behind Right-hand side of the rows after b.
  void apply_at(std::span<const std::int32_t> places, std::span<const double> b,
                std::span<double> x, std::span<const double> behind = {})
  {
    _x.assign(B * size(), 0);
    substitute(places, b, x, behind);
  }

  /// @brief Number of rows, 0 without factors.
  std::size_t size() const noexcept { return _order.size(); }

private:
  /// @brief Forward and backward substitution at some places, ascending.
  template <class Places>
  NTS_FOR_PROCESSORS void
  substitute(const Places& places, std::span<const double> b,
             std::span<double> x, std::span<const double> behind)
  {
    const double scale = power_of_two(std::max(largest(b), largest(behind)));
    const std::size_t n = size();
    const auto set = [&](std::size_t i, const Values& y)
    {
      const Values values = without_dust(y);
      std::memcpy(_x.data() + B * i, &values, B * sizeof(float));
    };
    for (const std::size_t i : places)
    {
      Values y = {};
      const std::size_t at = B * static_cast<std::size_t>(_order[i]);
      const double* known
          = at < b.size() ? b.data() + at : behind.data() + (at - b.size());
      for (std::size_t c = 0; c < B; ++c)
        y[c] = static_cast<float>(scale * known[c]);
      std::size_t e = _begin[i];
      set(i, y - _factors.product(e, _begin[i + 1], _x.data()));
    }
    const double back = _scale / scale;
    for (const std::size_t i : std::views::reverse(places))
    {
      std::size_t e = _begin[2 * n - 1 - i];
      const Values sum = _factors.product(e, _begin[2 * n - i] - 1, _x.data());
      set(i, _factors.product(e, _begin[2 * n - i], _x.data()) - sum);
      if (const auto node = static_cast<std::size_t>(_order[i]);
          B * node < x.size())
        for (std::size_t c = 0; c < B; ++c)
          x[B * node + c] = back * static_cast<double>(_x[B * i + c]);
    }
  }

  /// @brief Count the blocks of each row, and find the scale of the matrix.
  template <class Rows>
  void allocate(const Rows& A, FactorPattern<Rows>& pattern)
  {
    const std::size_t n = _order.size();
    _begin.assign(2 * n + 1, 0);
    double largest = 0;
    for (std::size_t i = 0; i < n; ++i)
      for (const auto& [column, e] : pattern.row(static_cast<std::int32_t>(i)))
      {
        const auto j = static_cast<std::size_t>(column);
        ++_begin[j < i ? i + 1 : 2 * n - i];
        if (j == i && e != pattern.filled)
          largest = std::max(largest, A.diagonal(e));
      }
    for (std::size_t i = 0; i < 2 * n; ++i)
      _begin[i + 1] += _begin[i];
    _scale = power_of_two(largest);
    _factors.resize(_begin.back());
  }

  bool fail()
  {
    _order.clear();
    return false;
  }

  double _scale = 1; // scale of the matrix
  std::vector<std::int32_t> _order;
  std::vector<std::size_t> _begin; // rows of L, then of U from the last
  PackedRows<B> _factors;
  std::vector<float> _x; // values in the order of elimination
};
} // namespace nts
