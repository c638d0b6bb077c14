#pragma once

#include "nts/processors.h"

#include <cmath>
#include <cstddef>
#include <cstring>
#include <span>
#include <utility>
#include <vector>

/// @file
/// Products of dense matrices in single precision, row by row in memory.

namespace nts
{
/// Rows and columns that are eliminated together.
inline constexpr std::size_t panel = 48;

/// Columns that are computed together.
inline constexpr std::size_t wide = 16;

/// @brief L numbers in a register of this size; compilers would keep wider
/// vectors in memory.
template <std::size_t L>
struct FloatRegister
{
  using type __attribute__((vector_size(L * sizeof(float)))) = float;
};

/// @brief C -= A B, with few columns of A, at most `panel`.
/// @tparam L Numbers in a register.
/// @tparam height Rows whose sums are in registers.
/// @param[in] rows, inner, columns Numbers: A is (rows, inner).
/// @param[in] a, b, c Distances of rows in memory.
template <std::size_t L, std::size_t height>
[[gnu::always_inline]] inline void
subtract_strips(const float* A, std::size_t a, const float* B, std::size_t b,
                float* C, std::size_t c, std::size_t rows, std::size_t inner,
                std::size_t columns)
{
  using Lanes = typename FloatRegister<L>::type;
  constexpr std::size_t parts = wide / L;
  Lanes strip[panel][parts];
  float block[height * panel];
  for (std::size_t j = 0; j < columns; j += wide)
  {
    const std::size_t w = columns - j < wide ? columns - j : wide;
    for (std::size_t k = 0; k < inner; ++k)
    {
      float row[wide] = {};
      std::memcpy(row, B + k * b + j, w * sizeof(float));
      std::memcpy(strip[k], row, sizeof(row));
    }
    for (std::size_t i = 0; i < rows; i += height)
    {
      const std::size_t h = rows - i < height ? rows - i : height;
      const float* left = A + i * a;
      std::size_t distance = a;
      if (h < height)
      {
        std::memset(block, 0, sizeof(block));
        for (std::size_t r = 0; r < h; ++r)
          std::memcpy(block + r * panel, left + r * a, inner * sizeof(float));
        left = block;
        distance = panel;
      }
      Lanes sums[height][parts] = {};
      for (std::size_t k = 0; k < inner; ++k)
#pragma GCC unroll 8
        for (std::size_t r = 0; r < height; ++r)
#pragma GCC unroll 8
          for (std::size_t p = 0; p < parts; ++p)
            sums[r][p] += strip[k][p] * left[r * distance + k];
      for (std::size_t r = 0; r < h; ++r)
      {
        float* target = C + (i + r) * c + j;
        float values[wide];
        std::memcpy(values, sums[r], sizeof(values));
        for (std::size_t l = 0; l < w; ++l)
          target[l] -= values[l];
      }
    }
  }
}

/// @brief y -= A x.
/// @tparam L Numbers in a register.
/// @param[in] A (rows, columns), dense in memory.
template <std::size_t L>
[[gnu::always_inline]] inline void subtract_rows(const float* A, const float* x,
                                                 float* y, std::size_t rows,
                                                 std::size_t columns)
{
  using Lanes = typename FloatRegister<L>::type;
  constexpr std::size_t parts = wide / L;
  for (std::size_t i = 0; i < rows; ++i, A += columns)
  {
    Lanes sums[parts] = {};
    std::size_t j = 0;
    for (; j + wide <= columns; j += wide)
#pragma GCC unroll 8
      for (std::size_t p = 0; p < parts; ++p)
      {
        Lanes left, right;
        std::memcpy(&left, A + j + p * L, sizeof(left));
        std::memcpy(&right, x + j + p * L, sizeof(right));
        sums[p] += left * right;
      }
    float total = 0;
    for (; j < columns; ++j)
      total += A[j] * x[j];
    float values[wide];
    std::memcpy(values, sums, sizeof(values));
    // Recursively by halves: a sequential sum would wait for each addition.
#pragma GCC unroll 4
    for (std::size_t half = wide / 2; half > 0; half /= 2)
      for (std::size_t l = 0; l < half; ++l)
        values[l] += values[half + l];
    y[i] -= total + values[0];
  }
}

/// @brief `subtract_strips`, chosen by the processor.
#ifdef NTS_BY_PROCESSOR
NTS_FOR("arch=x86-64-v4")
inline void subtract_product(const float* A, std::size_t a, const float* B,
                             std::size_t b, float* C, std::size_t c,
                             std::size_t rows, std::size_t inner,
                             std::size_t columns)
{
  subtract_strips<16, 8>(A, a, B, b, C, c, rows, inner, columns);
}
NTS_FOR("arch=x86-64-v3")
inline void subtract_product(const float* A, std::size_t a, const float* B,
                             std::size_t b, float* C, std::size_t c,
                             std::size_t rows, std::size_t inner,
                             std::size_t columns)
{
  subtract_strips<8, 6>(A, a, B, b, C, c, rows, inner, columns);
}
#endif
NTS_FOR("default")
inline void subtract_product(const float* A, std::size_t a, const float* B,
                             std::size_t b, float* C, std::size_t c,
                             std::size_t rows, std::size_t inner,
                             std::size_t columns)
{
  subtract_strips<4, 3>(A, a, B, b, C, c, rows, inner, columns);
}

/// @brief `subtract_rows`, chosen by the processor.
#ifdef NTS_BY_PROCESSOR
NTS_FOR("arch=x86-64-v4")
inline void subtract_from_vector(const float* A, const float* x, float* y,
                                 std::size_t rows, std::size_t columns)
{
  subtract_rows<16>(A, x, y, rows, columns);
}
NTS_FOR("arch=x86-64-v3")
inline void subtract_from_vector(const float* A, const float* x, float* y,
                                 std::size_t rows, std::size_t columns)
{
  subtract_rows<8>(A, x, y, rows, columns);
}
#endif
NTS_FOR("default")
inline void subtract_from_vector(const float* A, const float* x, float* y,
                                 std::size_t rows, std::size_t columns)
{
  subtract_rows<4>(A, x, y, rows, columns);
}

/// @brief y -= A x for K vectors together, (columns, K) and (rows, K), with K =
/// 1 or `wide`.
template <std::size_t K>
void subtract_product(const float* A, const float* x, float* y,
                      std::size_t rows, std::size_t columns)
{
  if constexpr (K == 1)
    return subtract_from_vector(A, x, y, rows, columns);
  for (std::size_t k = 0; k < columns; k += panel)
    subtract_product(A + k, columns, x + K * k, K, y, K, rows,
                     columns - k < panel ? columns - k : panel, K);
}

/// @brief Replace a matrix of at most `panel` rows by its inverse.
///
/// Rows are exchanged where a larger pivot lies below.
/// @param[in,out] A The matrix, dense in memory.
/// @return False if it is singular.
NTS_FOR_PROCESSORS
inline bool invert(float* A, std::size_t n)
{
  std::size_t from[panel];
  for (std::size_t k = 0; k < n; ++k)
  {
    std::size_t best = k;
    for (std::size_t i = k + 1; i < n; ++i)
      if (std::abs(A[i * n + k]) > std::abs(A[best * n + k]))
        best = i;
    from[k] = best;
    if (best != k)
      for (std::size_t j = 0; j < n; ++j)
        std::swap(A[k * n + j], A[best * n + j]);
    const float pivot = A[k * n + k];
    if (!(std::abs(pivot) > 0) || !std::isfinite(1 / pivot))
      return false;
    A[k * n + k] = 1;
    for (std::size_t j = 0; j < n; ++j)
      A[k * n + j] /= pivot;
    for (std::size_t i = 0; i < n; ++i)
    {
      if (i == k)
        continue;
      const float factor = A[i * n + k];
      A[i * n + k] = 0;
      for (std::size_t j = 0; j < n; ++j)
        A[i * n + j] -= factor * A[k * n + j];
    }
  }
  for (std::size_t k = n; k-- > 0;)
    if (from[k] != k)
      for (std::size_t i = 0; i < n; ++i)
        std::swap(A[i * n + k], A[i * n + from[k]]);
  return true;
}
} // namespace nts
