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

/// @brief 3 x 3 blocks of sparse matrices.
namespace nts
{
using Block = Matrix<3, 3>;

inline constexpr Block identity = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

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

/// @brief Rows that are filled one after the other, each in any order.
class BlockRows
{
public:
  /// @param[in] columns Number of columns.
  explicit BlockRows(std::size_t columns) : _place(columns, -1) {}

  /// @brief Block of the last row, which no `end_row` has ended; zero if new.
  Block& operator[](std::int32_t column)
  {
    std::int64_t& place = _place[column];
    if (place < _start.back())
    {
      place = static_cast<std::int64_t>(_column.size());
      _column.push_back(column);
      _value.push_back({});
    }
    return _value[place];
  }

  void end_row()
  {
    _start.push_back(static_cast<std::int64_t>(_column.size()));
  }

  std::size_t size() const noexcept { return _start.size() - 1; }

  /// @brief Columns and blocks of a row.
  auto row(std::size_t i) const noexcept
  {
    const auto first = static_cast<std::size_t>(_start[i]),
               count = static_cast<std::size_t>(_start[i + 1]) - first;
    return std::pair(std::span(_column).subspan(first, count),
                     std::span(_value).subspan(first, count));
  }

  BlockMatrix view() const noexcept
  {
    const double* first = _value.empty() ? nullptr : _value[0][0].data();
    return {.start = _start,
            .column = _column,
            .value = {first, 9 * _value.size()}};
  }

private:
  std::vector<std::int64_t> _start = {0}, _place;
  std::vector<std::int32_t> _column;
  std::vector<Block> _value;
};

/// A column of a block in single precision and one entry that does not count.
using Column __attribute__((vector_size(4 * sizeof(float)))) = float;

/// @brief A block in single precision, column by column.
struct Columns
{
  Column column[3];

  /// @brief Take a block, row by row, times a number.
  static Columns of(const double* A, double scale) noexcept
  {
    Columns result = {};
    for (std::size_t c = 0; c < 3; ++c)
      for (std::size_t r = 0; r < 3; ++r)
        result.column[c][r] = static_cast<float>(scale * A[3 * r + c]);
    return result;
  }

  Block block() const noexcept
  {
    Block A;
    for (std::size_t r = 0; r < 3; ++r)
      for (std::size_t c = 0; c < 3; ++c)
        A[r][c] = static_cast<double>(column[c][r]);
    return A;
  }

  /// @brief This times a packed block.
  Columns operator*(const float* B) const noexcept
  {
    Columns result;
    for (std::size_t c = 0; c < 3; ++c, B += 3)
      result.column[c] = column[0] * B[0] + column[1] * B[1] + column[2] * B[2];
    return result;
  }

  Columns& operator-=(const Columns& other) noexcept
  {
    for (std::size_t c = 0; c < 3; ++c)
      column[c] -= other.column[c];
    return *this;
  }
};

/// @brief Blocks of rows in single precision, for products that read them one
/// after the other.
///
/// Products wait for memory, so that half of it takes half the time; where
/// preconditioners are made of, it is exact enough.
class PackedRows
{
public:
  void resize(std::size_t blocks)
  {
    _node.resize(blocks);
    _entry.resize(9 * blocks + 1); // the last column is read as four
  }

  void put(std::size_t e, std::int32_t node, const Columns& A) noexcept
  {
    _node[e] = node;
    for (std::size_t c = 0; c < 3; ++c)
      std::memcpy(_entry.data() + 9 * e + 3 * c, &A.column[c],
                  3 * sizeof(float));
  }

  std::int32_t node(std::size_t e) const noexcept { return _node[e]; }

  /// @brief A packed block.
  const float* operator[](std::size_t e) const noexcept
  {
    return _entry.data() + 9 * e;
  }

  /// @brief Sum of the next blocks times the values of their nodes.
  /// @param[in,out] e The first block; then `end`.
  Column product(std::size_t& e, std::size_t end, const float* x) const noexcept
  {
    Column sum[3] = {};
    const float* block = (*this)[e];
    for (; e < end; ++e, block += 9)
    {
      const float* values = x + 3 * _node[e];
      for (std::size_t c = 0; c < 3; ++c)
      {
        Column column;
        std::memcpy(&column, block + 3 * c, sizeof(column));
        sum[c] += column * values[c];
      }
    }
    return sum[0] + sum[1] + sum[2];
  }

private:
  std::vector<std::int32_t> _node;
  std::vector<float> _entry;
};

/// @brief What brings a number to the size of 1 without rounding: numbers in
/// single precision shall have it, whatever the units.
inline double power_of_two(double size) noexcept
{
  return std::isnormal(size) ? std::exp2(-std::ilogb(size)) : 1;
}

/// @brief Zero for what is so much less than 1 that products come near to
/// denormal numbers, which are slow. Far from where waves have got, solutions
/// fall off without end.
inline float without_dust(float value) noexcept
{
  constexpr float eps = std::numeric_limits<float>::epsilon(),
                  tiny = std::numeric_limits<float>::min() / (eps * eps);
  return std::abs(value) < tiny ? 0 : value;
}
} // namespace nts
