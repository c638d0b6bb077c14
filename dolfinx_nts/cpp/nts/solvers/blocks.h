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

/// @brief B x B blocks of sparse matrices, one row and column for each
/// component of the displacement of a node: B is 2 or 3.
namespace nts
{
template <std::size_t B>
using Block = Matrix<B, B>;

template <std::size_t B>
inline constexpr Block<B> identity = []
{
  Block<B> result = {};
  for (std::size_t i = 0; i < B; ++i)
    result[i][i] = 1;
  return result;
}();

/// @brief Numbers of a column of a block in one register.
template <std::size_t B>
struct Register;

template <>
struct Register<2>
{
  using type __attribute__((vector_size(2 * sizeof(float)))) = float;
};

template <>
struct Register<3>
{
  using type __attribute__((vector_size(4 * sizeof(float)))) = float;
};

/// A column of a block in single precision; with three components, padded by
/// one unused entry.
template <std::size_t B>
using Column = typename Register<B>::type;

/// @brief Values of a node in a register, padded to four.
using Values __attribute__((vector_size(4 * sizeof(float)))) = float;

/// @brief A block in single precision, column by column.
template <std::size_t B>
struct Columns
{
  Column<B> column[B];

  /// @brief Set to a block, row by row, times a number.
  static Columns of(const double* A, double scale) noexcept
  {
    Columns result = {};
    for (std::size_t c = 0; c < B; ++c)
      for (std::size_t r = 0; r < B; ++r)
        result.column[c][r] = static_cast<float>(scale * A[B * r + c]);
    return result;
  }

  static Columns of(const Block<B>& A, double scale = 1) noexcept
  {
    return of(A.front().data(), scale);
  }

  Block<B> block() const noexcept
  {
    Block<B> A;
    for (std::size_t r = 0; r < B; ++r)
      for (std::size_t c = 0; c < B; ++c)
        A[r][c] = static_cast<double>(column[c][r]);
    return A;
  }

  /// @brief This times a packed block.
  Columns operator*(const float* other) const noexcept
  {
    Columns result;
    for (std::size_t c = 0; c < B; ++c, other += B)
      result.column[c] = times(other);
    return result;
  }

  Columns operator*(const Columns& other) const noexcept
  {
    Columns result;
    for (std::size_t c = 0; c < B; ++c)
      result.column[c] = times(other.column[c]);
    return result;
  }

  Columns operator*(float factor) const noexcept
  {
    Columns result;
    for (std::size_t c = 0; c < B; ++c)
      result.column[c] = column[c] * factor;
    return result;
  }

  Columns& operator+=(const Columns& other) noexcept
  {
    for (std::size_t c = 0; c < B; ++c)
      column[c] += other.column[c];
    return *this;
  }

  Columns& operator-=(const Columns& other) noexcept
  {
    for (std::size_t c = 0; c < B; ++c)
      column[c] -= other.column[c];
    return *this;
  }

  /// @brief Copy with zeros in place of entries so small that their products
  /// would be denormal numbers, which are slow. Round-off of projections causes
  /// many of them.
  Columns without_dust() const noexcept
  {
    constexpr float tiny = 1.1e-19f; // above the root of the least number
    Columns result = *this;
    for (Column<B>& some : result.column)
      some = (some < tiny) & (some > -tiny) ? Column<B>{} : some;
    return result;
  }

private:
  /// @brief This times a vector.
  template <class Vector>
  Column<B> times(const Vector& x) const noexcept
  {
    Column<B> sum = column[0] * x[0];
    for (std::size_t c = 1; c < B; ++c)
      sum += column[c] * x[c];
    return sum;
  }
};

/// @brief y += A x.
template <std::size_t B>
void add_product(const Columns<B>& A, const double* x, double* y) noexcept
{
  for (std::size_t c = 0; c < B; ++c)
    for (std::size_t r = 0; r < B; ++r)
      y[r] += static_cast<double>(A.column[c][r]) * x[c];
}

/// @brief Rows of a sparse matrix with B x B blocks.
template <std::size_t B>
struct BlockMatrix
{
  std::span<const std::int64_t> start;  ///< offsets of the rows
  std::span<const std::int32_t> column; ///< of each block
  std::span<const double> value;        ///< (blocks, B, B)
  std::span<const double> behind = {};  ///< values of the last rows

  /// @brief A block, row by row.
  const double* operator[](std::size_t e) const noexcept
  {
    const std::size_t at = B * B * e;
    return at < value.size() ? value.data() + at
                             : behind.data() + (at - value.size());
  }

  /// @brief Columns of a row.
  std::span<const std::int32_t> row(std::size_t i) const noexcept
  {
    const auto first = static_cast<std::size_t>(start[i]);
    return column.subspan(first,
                          static_cast<std::size_t>(start[i + 1]) - first);
  }

  Columns<B> block(std::size_t e, double scale) const noexcept
  {
    return Columns<B>::of((*this)[e], scale);
  }

  /// @brief Largest entry on the diagonal of a block.
  double diagonal(std::size_t e) const noexcept
  {
    double most = 0;
    for (std::size_t d = 0; d < B; ++d)
      most = std::max(most, std::abs((*this)[e][(B + 1) * d]));
    return most;
  }
};

/// @brief Rows in single precision, filled row by row, entries of a row in any
/// order.
template <std::size_t B>
class BlockRows
{
public:
  /// @brief Remove all rows, but keep their memory.
  /// @param[in] columns Number of columns.
  void clear(std::size_t columns)
  {
    _place.assign(columns, -1);
    start.assign(1, 0);
    column.clear();
    value.clear();
  }

  /// @brief Add to a block of the last row, before `end_row`.
  void add(std::int32_t j, const Columns<B>& A)
  {
    std::int64_t& place = _place[j];
    if (place >= start.back())
    {
      value[place] += A;
      return;
    }
    place = static_cast<std::int64_t>(column.size());
    column.push_back(j);
    value.push_back(A);
  }

  void end_row() { start.push_back(static_cast<std::int64_t>(column.size())); }

  std::size_t size() const noexcept { return start.size() - 1; }

  Columns<B> block(std::size_t e, double scale) const noexcept
  {
    return value[e] * static_cast<float>(scale);
  }

  /// @brief Largest entry on the diagonal of a block.
  double diagonal(std::size_t e) const noexcept
  {
    float most = 0;
    for (std::size_t d = 0; d < B; ++d)
      most = std::max(most, std::abs(value[e].column[d][d]));
    return most;
  }

  std::vector<std::int64_t> start = {0}; ///< where rows begin, and the end
  std::vector<std::int32_t> column;      ///< of each block
  std::vector<Columns<B>> value;

private:
  std::vector<std::int64_t> _place;
};

/// @brief Blocks of rows in single precision, for products that read them one
/// after the other.
///
/// Memory bandwidth limits products, so that half of the memory takes half the
/// time. Single precision is accurate enough for preconditioners.
template <std::size_t B>
class PackedRows
{
public:
  void resize(std::size_t blocks)
  {
    _node.resize(blocks);
    _entry.resize(B * B * blocks + 1); // with three, a column is read as four
  }

  void put(std::size_t e, std::int32_t node, const Columns<B>& A) noexcept
  {
    _node[e] = node;
    for (std::size_t c = 0; c < B; ++c)
      std::memcpy(_entry.data() + B * B * e + B * c, &A.column[c],
                  B * sizeof(float));
  }

  std::size_t size() const noexcept { return _node.size(); }

  std::int32_t node(std::size_t e) const noexcept { return _node[e]; }

  Columns<B> block(std::size_t e) const noexcept
  {
    Columns<B> result;
    for (std::size_t c = 0; c < B; ++c)
      std::memcpy(&result.column[c], (*this)[e] + B * c,
                  sizeof(result.column[c]));
    return result;
  }

  /// @brief A packed block.
  const float* operator[](std::size_t e) const noexcept
  {
    return _entry.data() + B * B * e;
  }

  /// @brief Sum of the next blocks times the values of their nodes.
  /// @param[in,out] e The first block; then `end`.
  [[gnu::always_inline]] Values product(std::size_t& e, std::size_t end,
                                        const float* x) const noexcept
  {
    const float* block = (*this)[e];
    if constexpr (B == 2)
    {
      // Both columns are in one register.
      Values sum = {};
      for (; e < end; ++e, block += 4)
      {
        __builtin_prefetch(block + ahead); // harmless past the end
        Values columns;
        std::memcpy(&columns, block, sizeof(columns));
        const Values values = pair(x + 2 * _node[e]);
        sum += columns * __builtin_shufflevector(values, values, 0, 0, 1, 1);
      }
      return sum + __builtin_shufflevector(sum, sum, 2, 3, 0, 1);
    }
    else
    {
      Values sum[B] = {};
      for (; e < end; ++e, block += B * B)
      {
        __builtin_prefetch(block + ahead); // harmless past the end
        const float* values = x + B * _node[e];
        for (std::size_t c = 0; c < B; ++c)
        {
          Column<B> column;
          std::memcpy(&column, block + B * c, sizeof(column));
          sum[c] += column * values[c];
        }
      }
      for (std::size_t c = 1; c < B; ++c)
        sum[0] += sum[c];
      return sum[0];
    }
  }

private:
  /// @brief Two numbers, loaded together like a double.
  static Values pair(const float* x) noexcept
  {
    double both;
    std::memcpy(&both, x, sizeof(both));
    const double twice __attribute__((vector_size(16))) = {both, both};
    Values result;
    std::memcpy(&result, &twice, sizeof(result));
    return result;
  }

  /// Distance of software prefetching [entries]. Hardware prefetching stops at
  /// the end of a page.
  static constexpr std::size_t ahead = 64 * B * B;

  std::vector<std::int32_t> _node;
  std::vector<float> _entry;
};

/// @brief Largest absolute value, 0 without values.
inline double largest(std::span<const double> values) noexcept
{
  double most = 0;
  for (const double value : values)
    most = std::max(most, std::abs(value));
  return most;
}

/// @brief Power of two that scales a number to the order of 1 without rounding,
/// so that single precision can represent it for any units.
inline double power_of_two(double size) noexcept
{
  return std::isnormal(size) ? std::exp2(-std::ilogb(size)) : 1;
}

/// @brief Magnitude below which numbers are set to zero, to avoid denormal
/// numbers in products, which are slow. Solutions decay exponentially ahead of
/// waves.
inline constexpr float dust = std::numeric_limits<float>::min()
                              / (std::numeric_limits<float>::epsilon()
                                 * std::numeric_limits<float>::epsilon());

/// @brief The value, or zero if it is less than `dust`.
inline float without_dust(float value) noexcept
{
  return std::abs(value) < dust ? 0 : value;
}

inline Values without_dust(const Values& values) noexcept
{
  return (values < dust) & (values > -dust) ? Values{} : values;
}
} // namespace nts
