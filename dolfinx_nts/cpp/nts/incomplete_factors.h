#pragma once

#include "small.h"

#include <algorithm>
#include <cstdint>
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
class IncompleteFactors
{
public:
  /// @brief Be empty, with the memory of what there was.
  void clear() noexcept
  {
    _start.resize(1);
    _column.clear();
    _value.clear();
  }

  /// @brief Add the next row, which must have a block on the diagonal.
  void add(const BlockRow& row)
  {
    _order.clear();
    for (std::size_t e = 0; e < row.columns.size(); ++e)
      _order.push_back({row.columns[e], static_cast<std::int32_t>(e)});
    if (!std::ranges::is_sorted(_order))
      std::ranges::sort(_order);
    for (const auto& [column, e] : _order)
    {
      _column.push_back(column);
      _value.push_back(row.blocks[e]);
    }
    _start.push_back(_value.size());
  }

  /// @brief Overwrite the matrix by its factors.
  /// @return False if a block on the diagonal is singular.
  bool factorise()
  {
    const std::size_t n = _start.size() - 1;
    _diagonal.resize(n);
    std::vector<Block*> at(n, nullptr); // blocks of the present row
    for (std::size_t i = 0; i < n; ++i)
    {
      for (std::size_t e = _start[i]; e < _start[i + 1]; ++e)
        at[_column[e]] = &_value[e];
      std::size_t e = _start[i];
      for (; static_cast<std::size_t>(_column[e]) < i; ++e)
      {
        const std::size_t k = _column[e];
        // L_ik = A_ik D_k^-1, then A_ij -= L_ik U_kj.
        Block L = {};
        add_product(_value[e], _value[_diagonal[k]], L);
        _value[e] = L;
        for (double& entry : std::span(L.front().data(), 9))
          entry = -entry;
        for (std::size_t u = _diagonal[k] + 1; u < _start[k + 1]; ++u)
          if (Block* target = at[_column[u]])
            add_product(L, _value[u], *target);
      }
      _diagonal[i] = e;
      Block A = _value[e];
      _value[e] = identity;
      if (!solve(A, _value[e]))
        return false;
      for (std::size_t e = _start[i]; e < _start[i + 1]; ++e)
        at[_column[e]] = nullptr;
    }
    return true;
  }

  /// @brief x <- (L U)^-1 x.
  void apply(std::span<double> x) const noexcept
  {
    const std::size_t n = _start.size() - 1;
    for (std::size_t i = 0; i < n; ++i)
      subtract_products(i, _start[i], _diagonal[i], x);
    for (std::size_t i = n; i-- > 0;)
    {
      subtract_products(i, _diagonal[i] + 1, _start[i + 1], x);
      Vec3 y = {};
      add_product(_value[_diagonal[i]], x.data() + 3 * i, y.data());
      std::ranges::copy(y, x.begin() + 3 * i);
    }
  }

private:
  void subtract_products(std::size_t i, std::size_t first, std::size_t last,
                         std::span<double> x) const noexcept
  {
    Vec3 sum = {};
    for (std::size_t e = first; e < last; ++e)
      add_product(_value[e], x.data() + 3 * _column[e], sum.data());
    for (std::size_t c = 0; c < 3; ++c)
      x[3 * i + c] -= sum[c];
  }

  std::vector<std::size_t> _start = {0}, _diagonal;
  std::vector<std::int32_t> _column;
  std::vector<Block> _value; // those on the diagonal inverted
  std::vector<std::pair<std::int32_t, std::int32_t>>
      _order; // of a row's blocks
};
} // namespace nts
