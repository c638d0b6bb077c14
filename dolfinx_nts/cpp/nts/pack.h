#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>

/// @brief Values of a function cell by cell, as the kernels of a form read
/// them.
namespace nts
{
/// @brief Copy values that have changed.
/// @return Whether a bit has.
inline bool follow(std::span<const double> values,
                   std::span<double> kept) noexcept
{
  if (values.empty()
      || std::memcmp(values.data(), kept.data(), values.size_bytes()) == 0)
    return false;
  std::ranges::copy(values, kept.begin());
  return true;
}

/// @brief Copy the values at the nodes of each cell to some columns.
/// @param[in] x Values at all nodes, (l, 3).
/// @param[in] nodes Of each cell, (c, k).
/// @param[in] k Nodes of a cell.
/// @param[in] first The first of 3 k columns.
/// @param[out] rows (c, width)
/// @param[in] width Columns of all functions.
inline void pack(std::span<const double> x, std::span<const std::int32_t> nodes,
                 std::size_t k, std::size_t first, std::span<double> rows,
                 std::size_t width) noexcept
{
  for (std::size_t c = 0; c < nodes.size() / k; ++c)
  {
    double* row = rows.data() + width * c + first;
    for (const std::int32_t node : nodes.subspan(k * c, k))
      for (std::size_t i = 0; i < 3; ++i)
        *row++ = x[3 * node + i];
  }
}
} // namespace nts
