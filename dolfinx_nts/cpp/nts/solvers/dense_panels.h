#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>
#include <span>
#include <utility>
#include <vector>

/// @file
/// Products of dense matrices in single precision, row by row in memory.

// The library chooses at run time what the processor has.
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__)
#define NTS_FOR_PROCESSORS                                                     \
  __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define NTS_FOR_PROCESSORS
#endif

namespace nts
{
/// Rows and columns that are eliminated at once.
inline constexpr std::size_t panel = 48;

/// @brief Some numbers in one or two registers.
using Wide = float __attribute__((vector_size(16 * sizeof(float))));
inline constexpr std::size_t wide = 16;

/// @brief C -= A B, with few columns of A, at most `panel`.
/// @param[in] rows, inner, columns Numbers: A is (rows, inner).
/// @param[in] a, b, c Distances of rows in memory.
NTS_FOR_PROCESSORS
inline void subtract_product(const float* A, std::size_t a, const float* B,
                             std::size_t b, float* C, std::size_t c,
                             std::size_t rows, std::size_t inner,
                             std::size_t columns)
{
  constexpr std::size_t height = 8;
  Wide strip[panel];
  float block[height * panel];
  for (std::size_t j = 0; j < columns; j += wide)
  {
    const std::size_t w = columns - j < wide ? columns - j : wide;
    for (std::size_t k = 0; k < inner; ++k)
    {
      strip[k] = Wide{};
      std::memcpy(&strip[k], B + k * b + j, w * sizeof(float));
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
      Wide s0 = {}, s1 = {}, s2 = {}, s3 = {}, s4 = {}, s5 = {}, s6 = {},
           s7 = {};
      for (std::size_t k = 0; k < inner; ++k)
      {
        const Wide x = strip[k];
        const float* y = left + k;
        s0 += x * y[0];
        s1 += x * y[distance];
        s2 += x * y[2 * distance];
        s3 += x * y[3 * distance];
        s4 += x * y[4 * distance];
        s5 += x * y[5 * distance];
        s6 += x * y[6 * distance];
        s7 += x * y[7 * distance];
      }
      const Wide* const sums[height] = {&s0, &s1, &s2, &s3, &s4, &s5, &s6, &s7};
      for (std::size_t r = 0; r < h; ++r)
      {
        float* target = C + (i + r) * c + j;
        Wide value = {};
        std::memcpy(&value, target, w * sizeof(float));
        value -= *sums[r];
        std::memcpy(target, &value, w * sizeof(float));
      }
    }
  }
}

/// @brief y -= A x.
/// @param[in] A (rows, columns), dense in memory.
NTS_FOR_PROCESSORS
inline void subtract_from_vector(const float* A, const float* x, float* y,
                                 std::size_t rows, std::size_t columns)
{
  for (std::size_t i = 0; i < rows; ++i, A += columns)
  {
    Wide sum = {};
    std::size_t j = 0;
    for (; j + wide <= columns; j += wide)
    {
      Wide left, right;
      std::memcpy(&left, A + j, sizeof(left));
      std::memcpy(&right, x + j, sizeof(right));
      sum += left * right;
    }
    float total = 0;
    for (; j < columns; ++j)
      total += A[j] * x[j];
    for (std::size_t l = 0; l < wide; ++l)
      total += sum[l];
    y[i] -= total;
  }
}

/// @brief The same for K vectors at once, (columns, K) and (rows, K): one, or
/// as many as are `wide`.
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
