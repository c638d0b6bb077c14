#pragma once

#include "nts/geometry/small.h"

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

  static Columns of(const Block& A, double scale = 1) noexcept
  {
    return of(A.front().data(), scale);
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

  Columns operator*(const Columns& B) const noexcept
  {
    Columns result;
    for (std::size_t c = 0; c < 3; ++c)
      result.column[c] = column[0] * B.column[c][0] + column[1] * B.column[c][1]
                         + column[2] * B.column[c][2];
    return result;
  }

  Columns operator*(float factor) const noexcept
  {
    return {{column[0] * factor, column[1] * factor, column[2] * factor}};
  }

  Columns& operator+=(const Columns& other) noexcept
  {
    for (std::size_t c = 0; c < 3; ++c)
      column[c] += other.column[c];
    return *this;
  }

  Columns& operator-=(const Columns& other) noexcept
  {
    for (std::size_t c = 0; c < 3; ++c)
      column[c] -= other.column[c];
    return *this;
  }

  /// @brief The block with zeros where entries are so much less than 1 that
  /// products of two of them would be denormal numbers, which are slow.
  /// Rounding in projections leaves many.
  Columns without_dust() const noexcept
  {
    constexpr float tiny = 1.1e-19f; // above the root of the least number
    Columns result = *this;
    for (Column& some : result.column)
      some = (some < tiny) & (some > -tiny) ? Column{} : some;
    return result;
  }
};

/// @brief y += A x.
inline void add_product(const Columns& A, const double* x, double* y) noexcept
{
  for (std::size_t c = 0; c < 3; ++c)
    for (std::size_t r = 0; r < 3; ++r)
      y[r] += static_cast<double>(A.column[c][r]) * x[c];
}

/// @brief Rows of a sparse matrix with 3 x 3 blocks.
struct BlockMatrix
{
  std::span<const std::int64_t> start;  ///< where each row begins, and the end
  std::span<const std::int32_t> column; ///< of each block
  std::span<const double> value;        ///< (blocks, 3, 3)

  /// @brief A block, row by row.
  const double* operator[](std::size_t e) const noexcept
  {
    return value.data() + 9 * e;
  }

  /// @brief Columns of a row.
  std::span<const std::int32_t> row(std::size_t i) const noexcept
  {
    const auto first = static_cast<std::size_t>(start[i]);
    return column.subspan(first,
                          static_cast<std::size_t>(start[i + 1]) - first);
  }

  Columns block(std::size_t e, double scale) const noexcept
  {
    return Columns::of((*this)[e], scale);
  }

  /// @brief Largest entry on the diagonal of a block.
  double diagonal(std::size_t e) const noexcept
  {
    const double* A = (*this)[e];
    return std::max({std::abs(A[0]), std::abs(A[4]), std::abs(A[8])});
  }
};

/// @brief Rows in single precision that are filled one after the other, each in
/// any order.
class BlockRows
{
public:
  /// @brief Remove all rows; their memory is used again.
  /// @param[in] columns Number of columns.
  void clear(std::size_t columns)
  {
    _place.assign(columns, -1);
    start.assign(1, 0);
    column.clear();
    value.clear();
  }

  /// @brief Block of the last row, which no `end_row` has ended; zero if new.
  Columns& operator[](std::int32_t j)
  {
    std::int64_t& place = _place[j];
    if (place < start.back())
    {
      place = static_cast<std::int64_t>(column.size());
      column.push_back(j);
      value.push_back({});
    }
    return value[place];
  }

  void end_row() { start.push_back(static_cast<std::int64_t>(column.size())); }

  std::size_t size() const noexcept { return start.size() - 1; }

  Columns block(std::size_t e, double scale) const noexcept
  {
    return value[e] * static_cast<float>(scale);
  }

  /// @brief Largest entry on the diagonal of a block.
  double diagonal(std::size_t e) const noexcept
  {
    const Columns& A = value[e];
    return std::max({std::abs(A.column[0][0]), std::abs(A.column[1][1]),
                     std::abs(A.column[2][2])});
  }

  std::vector<std::int64_t> start = {0}; ///< where rows begin, and the end
  std::vector<std::int32_t> column;      ///< of each block
  std::vector<Columns> value;

private:
  std::vector<std::int64_t> _place;
};

/// @brief Blocks of rows in single precision, for products that read them one
/// after the other.
///
/// Products wait for memory, so that half of it takes half the time, and
/// preconditioners need no more digits.
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
      __builtin_prefetch(block + ahead); // may be beyond the last
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
  /// Number of entries by which memory is asked for in advance. Processors by
  /// themselves look no farther than the end of a page.
  static constexpr std::size_t ahead = 64 * 9;

  std::vector<std::int32_t> _node;
  std::vector<float> _entry;
};

/// @brief Largest absolute value, 0 of none.
inline double largest(std::span<const double> values) noexcept
{
  double most = 0;
  for (const double value : values)
    most = std::max(most, std::abs(value));
  return most;
}

/// @brief Factor that brings a number to the size of 1 without rounding, so
/// that it is in the range of single precision whatever the units.
inline double power_of_two(double size) noexcept
{
  return std::isnormal(size) ? std::exp2(-std::ilogb(size)) : 1;
}

/// @brief The value, or zero if it is so much less than 1 that its products
/// come near to denormal numbers, which are slow. Where waves have not got yet,
/// solutions decay without end.
inline float without_dust(float value) noexcept
{
  constexpr float eps = std::numeric_limits<float>::epsilon(),
                  tiny = std::numeric_limits<float>::min() / (eps * eps);
  return std::abs(value) < tiny ? 0 : value;
}
} // namespace nts
