#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <utility>

/// @brief Transposition of nodal values to and from SIMD lanes, in which the
/// values of a batch of cells are contiguous.
///
/// Copies of single numbers would take as long as the kernels of small cells.
/// Two numbers are copied together, in a register of 16 bytes.
namespace nts
{
/// @brief W numbers in a register of 16 bytes, or of 8.
template <class T, std::size_t W>
struct PackOf
{
  using type __attribute__((vector_size(W * sizeof(T)))) = T;
};
template <class T, std::size_t W>
using Pack = typename PackOf<T, W>::type;

/// @brief Number of values in a register for batches of L cells.
template <class T, std::size_t L>
inline constexpr std::size_t pack_size = std::min(L, 16 / sizeof(T));

/// @brief Concatenation of the pairs of numbers at some offsets.
template <std::size_t W, class T>
Pack<T, W> pairs(const T* x, const std::size_t* begin) noexcept
{
  Pack<T, W> pack;
  if constexpr (W == 4)
  {
    // Two floats are loaded together like a double.
    double first, second;
    std::memcpy(&first, x + begin[0], sizeof(first));
    std::memcpy(&second, x + begin[1], sizeof(second));
    const Pack<double, 2> both = {first, second};
    std::memcpy(&pack, &both, sizeof(pack));
  }
  else
    std::memcpy(&pack, x + begin[0], sizeof(pack));
  return pack;
}

/// @brief Numbers with the places i, i + 2, i + 4, ... in two registers.
template <std::size_t First, class P, std::size_t... I>
P every_second(const P& a, const P& b, std::index_sequence<I...>) noexcept
{
  return __builtin_shufflevector(a, b, (2 * I + First)...);
}

/// @brief Copy D numbers of each lane side by side.
/// @param[in] x Numbers.
/// @param[in] begin Offsets of the numbers of each lane.
/// @param[out] out (D, L)
template <std::size_t D, class T, std::size_t L>
void rows_to_lanes(const T* x, const std::array<std::size_t, L>& begin,
                   T* out) noexcept
{
  constexpr std::size_t W = pack_size<T, L>;
  constexpr std::make_index_sequence<W> all;
  for (std::size_t l = 0; l < L; l += W)
  {
    const Pack<T, W> a = pairs<W>(x, &begin[l]),
                     b = pairs<W>(x, &begin[l + W / 2]),
                     first = every_second<0>(a, b, all),
                     second = every_second<1>(a, b, all);
    std::memcpy(out + l, &first, sizeof(first));
    std::memcpy(out + L + l, &second, sizeof(second));
  }
  if constexpr (D == 3)
    for (std::size_t l = 0; l < L; ++l)
      out[2 * L + l] = x[begin[l] + 2];
}

/// @brief Add the values of lanes to D numbers of each.
/// @param[in] in (D, L)
/// @param[in] begin Offsets of the numbers of each lane, with possible
/// repetitions.
/// @param[in,out] x Numbers.
template <std::size_t D, class T, std::size_t L>
void add_lanes_to_rows(const T* in, const std::array<std::size_t, L>& begin,
                       double* x) noexcept
{
  for (std::size_t l = 0; l < L; ++l)
  {
    double* row = x + begin[l];
    const Pack<double, 2> more
        = {static_cast<double>(in[l]), static_cast<double>(in[L + l])};
    Pack<double, 2> sum;
    std::memcpy(&sum, row, sizeof(sum));
    sum += more;
    std::memcpy(row, &sum, sizeof(sum));
    if constexpr (D == 3)
      row[2] += static_cast<double>(in[2 * L + l]);
  }
}
} // namespace nts
