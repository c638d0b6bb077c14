#pragma once

#include "small.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <span>
#include <utility>
#include <vector>

/// @brief Incomplete LU factors of a sparse matrix with 3 x 3 blocks.
namespace nts
{
using Block = Matrix<3, 3>;

/// @brief C += A B.
inline void add_product(const Block& A, const Block& B, Block& C) noexcept
{
  // A copy: the compiler need not fear that writing to C changes B.
  const Block factor = B;
  for (std::size_t i = 0; i < 3; ++i)
  {
    const Vec3 a = A[i];
    for (std::size_t j = 0; j < 3; ++j)
      C[i][j]
          += a[0] * factor[0][j] + a[1] * factor[1][j] + a[2] * factor[2][j];
  }
}

/// @brief y += A x.
inline void add_product(const Block& A, const double* x, double* y) noexcept
{
  for (std::size_t i = 0; i < 3; ++i)
    y[i] += inner<3>(A[i].data(), x);
}

/// @brief C += A.
inline void add(const Block& A, Block& C) noexcept
{
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j)
      C[i][j] += A[i][j];
}

/// @brief Rows of a sparse matrix with 3 x 3 blocks.
struct BlockMatrix
{
  std::span<const std::int64_t> start;  ///< of each row, and the end
  std::span<const std::int32_t> column; ///< of each block
  std::span<const double> value;        ///< (blocks, 3, 3)
};

inline constexpr Block identity = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

/// @brief A row that is filled block by block in any order.
class BlockRow
{
public:
  explicit BlockRow(std::size_t size) : _place(size, -1) {}

  Block& operator[](std::int32_t column)
  {
    std::int32_t& place = _place[column];
    if (place < 0)
    {
      place = static_cast<std::int32_t>(columns.size());
      columns.push_back(column);
      blocks.push_back({});
    }
    return blocks[place];
  }

  void clear() noexcept
  {
    for (const std::int32_t column : columns)
      _place[column] = -1;
    columns.clear();
    blocks.clear();
  }

  std::vector<std::int32_t> columns;
  std::vector<Block> blocks;

private:
  std::vector<std::int32_t> _place;
};

/// @brief Incomplete LU factors in the pattern of the matrix, ILU(0).
///
/// They lie in the order in which solving reads them: rows of L forward, then
/// rows of U backward, each with the inverse of its diagonal block at the end.
/// @tparam Real Type in which they are kept and solved with. Solving waits for
/// memory, so that `float` nearly halves its time, and a preconditioner need
/// not be exact. Rows are eliminated in double precision.
template <class Real>
class IncompleteFactors
{
public:
  /// @brief Factorise.
  /// @param[in] A Rows; columns beyond them are left out.
  /// @param[in] order The rows in the order of elimination.
  /// @return False if a block on the diagonal is singular.
  bool factorise(const BlockMatrix& A, std::span<const std::int32_t> order)
  {
    const std::size_t n = order.size();
    _order.assign(order.begin(), order.end());
    std::vector<std::int32_t> place(n), at(n, -1); // in the order, in the row
    for (std::size_t i = 0; i < n; ++i)
      place[order[i]] = static_cast<std::int32_t>(i);
    allocate(A, place);
    std::vector<std::pair<std::int32_t, const double*>> entries;
    std::vector<Block> row;
    for (std::size_t i = 0; i < n; ++i)
    {
      entries.clear();
      for (std::int64_t e = A.start[order[i]]; e < A.start[order[i] + 1]; ++e)
        if (static_cast<std::size_t>(A.column[e]) < n)
          entries.push_back({place[A.column[e]], A.value.data() + 9 * e});
      std::ranges::sort(entries);
      row.resize(entries.size());
      for (std::size_t c = 0; c < row.size(); ++c)
      {
        at[entries[c].first] = static_cast<std::int32_t>(c);
        for (std::size_t r = 0; r < 9; ++r)
          row[c][r / 3][r % 3] = _scale * entries[c].second[r];
      }
      const std::size_t diagonal = _begin[i + 1] - _begin[i];
      if (!(diagonal < row.size()
            && static_cast<std::size_t>(entries[diagonal].first) == i))
        return fail();
      for (std::size_t c = 0; c < diagonal; ++c)
      {
        // L_ik = A_ik D_k^-1, then A_ij -= L_ik U_kj.
        const auto k = static_cast<std::size_t>(entries[c].first);
        const std::size_t end = _begin[2 * n - k] - 1;
        Block L = {};
        add_product(row[c], get(end), L);
        put(_begin[i] + c, entries[c].first, L);
        for (double& entry : std::span(L.front().data(), 9))
          entry = -entry;
        for (std::size_t u = _begin[2 * n - 1 - k]; u < end; ++u)
          if (const std::int32_t target = at[_column[u]]; target >= 0)
            add_product(L, get(u), row[target]);
      }
      Block inverse = identity;
      if (!solve(row[diagonal], inverse))
        return fail();
      std::size_t u = _begin[2 * n - 1 - i];
      for (std::size_t c = diagonal + 1; c < row.size(); ++c)
        put(u++, entries[c].first, row[c]);
      put(u, entries[diagonal].first, inverse);
      for (const auto& [column, value] : entries)
        at[column] = -1;
    }
    return true;
  }

  /// @brief x = (L U)^-1 b.
  /// @param[in] b Right-hand side of all rows.
  /// @param[out] x Values of the first rows, all or fewer; may be b.
  void apply(std::span<const double> b, std::span<double> x)
  {
    // Numbers have the size of 1 here, whatever the units. What would come near
    // to denormal numbers, which are slow, is left out: far from where waves
    // have got, solutions fall off without end.
    constexpr Real eps = std::numeric_limits<Real>::epsilon(),
                   tiny = std::numeric_limits<Real>::min() / (eps * eps);
    double largest = 0;
    for (const double entry : b)
      largest = std::max(largest, std::abs(entry));
    const double scale = power_of_two(largest);
    const std::size_t n = _order.size();
    _x.resize(3 * n);
    std::size_t e = 0;
    const auto set = [&](std::size_t i, const Column& y)
    {
      for (std::size_t c = 0; c < 3; ++c)
        _x[3 * i + c] = std::abs(y[c]) < tiny ? 0 : y[c];
    };
    for (std::size_t i = 0; i < n; ++i)
    {
      Column y = {};
      for (std::size_t c = 0; c < 3; ++c)
        y[c] = static_cast<Real>(scale * b[3 * _order[i] + c]);
      set(i, y - products(e, _begin[i + 1]));
    }
    const double back = _scale / scale;
    for (std::size_t i = n; i-- > 0;)
    {
      const Column sum = products(e, _begin[2 * n - i] - 1);
      for (std::size_t c = 0; c < 3; ++c)
        _x[3 * i + c] -= sum[c];
      set(i, products(e, _begin[2 * n - i]));
      if (const auto node = static_cast<std::size_t>(_order[i]);
          3 * node < x.size())
        for (std::size_t c = 0; c < 3; ++c)
          x[3 * node + c] = back * static_cast<double>(_x[3 * i + c]);
    }
  }

  /// @brief Number of rows, 0 without factors.
  std::size_t size() const noexcept { return _order.size(); }

private:
  /// A column of a block and one entry that does not count.
  using Column __attribute__((vector_size(4 * sizeof(Real)))) = Real;

  /// @brief Count the blocks of each row, and take the scale of the matrix.
  void allocate(const BlockMatrix& A, std::span<const std::int32_t> place)
  {
    const std::size_t n = place.size();
    _begin.assign(2 * n + 1, 0);
    double largest = 0;
    for (std::size_t node = 0; node < n; ++node)
    {
      const auto i = static_cast<std::size_t>(place[node]);
      for (std::int64_t e = A.start[node]; e < A.start[node + 1]; ++e)
        if (const auto column = static_cast<std::size_t>(A.column[e]);
            column < n)
        {
          const bool lower = place[column] < place[node];
          ++_begin[lower ? i + 1 : 2 * n - i];
          for (std::size_t d = 0; column == node && d < 3; ++d)
            largest = std::max(largest, std::abs(A.value[9 * e + 4 * d]));
        }
    }
    for (std::size_t i = 0; i < 2 * n; ++i)
      _begin[i + 1] += _begin[i];
    _scale = power_of_two(largest);
    _column.resize(_begin.back());
    _factor.resize(9 * _begin.back() + 1); // the last column is read as four
  }

  bool fail()
  {
    _order.clear();
    return false;
  }

  /// @brief What brings a number to the size of 1 without rounding.
  static double power_of_two(double size) noexcept
  {
    return std::isnormal(size) ? std::exp2(-std::ilogb(size)) : 1;
  }

  /// @brief Keep a block, column by column.
  void put(std::size_t e, std::int32_t column, const Block& A) noexcept
  {
    _column[e] = column;
    for (std::size_t r = 0; r < 3; ++r)
      for (std::size_t c = 0; c < 3; ++c)
        _factor[9 * e + 3 * c + r] = static_cast<Real>(A[r][c]);
  }

  Block get(std::size_t e) const noexcept
  {
    Block A;
    for (std::size_t r = 0; r < 3; ++r)
      for (std::size_t c = 0; c < 3; ++c)
        A[r][c] = static_cast<double>(_factor[9 * e + 3 * c + r]);
    return A;
  }

  /// @brief Sum of the next blocks, up to `end`, times their part of x.
  Column products(std::size_t& e, std::size_t end) const noexcept
  {
    Column sum[3] = {};
    const Real* block = _factor.data() + 9 * e;
    for (; e < end; ++e, block += 9)
    {
      const Real* x = _x.data() + 3 * _column[e];
      for (std::size_t c = 0; c < 3; ++c)
      {
        Column column;
        std::memcpy(&column, block + 3 * c, sizeof(column));
        sum[c] += column * x[c];
      }
    }
    return sum[0] + sum[1] + sum[2];
  }

  double _scale = 1; // of the matrix
  std::vector<std::int32_t> _order;
  std::vector<std::size_t> _begin; // of rows of L, then of U from the last
  std::vector<std::int32_t> _column;
  std::vector<Real> _factor;
  std::vector<Real> _x; // in the order
};
} // namespace nts
