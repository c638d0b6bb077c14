#pragma once

#include "nts/geometry/box.h"

#include <vector>

/// @brief Boundaries that may overlap, by boxes around them, and what of them.
namespace nts
{
/// @brief A boundary of which something may be inside another one.
struct Meeting
{
  std::int32_t inner, outer; ///< numbers of the boundaries
  double depth;              ///< depth from which on it counts [m]
  Box region; ///< where all of the inner one lies that is as deep
};

/// @brief Boundaries whose boxes overlap by more than a touch, in both orders.
/// @param[in] boxes Box around the whole of each boundary (g).
/// @param[in] touch Depth of a touch of each; of two the lesser counts [m] (g).
/// @param[out] apart Distances of any two boxes, infinite on the diagonal
/// (g, g) [m].
inline std::vector<Meeting> meetings(std::span<const Box> boxes,
                                     std::span<const double> touch,
                                     std::span<double> apart)
{
  const std::size_t n = boxes.size();
  std::vector<Meeting> found;
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
    {
      const double depth = std::min(touch[i], touch[j]);
      const double way = i == j ? INFINITY : distance(boxes[i], boxes[j]);
      apart[n * i + j] = way;
      // What is deep in the outer boundary is as deep in its box.
      if (way < -depth)
        found.push_back({static_cast<std::int32_t>(i),
                         static_cast<std::int32_t>(j), depth,
                         part_inside(boxes[i], boxes[j], depth)});
    }
  return found;
}

/// @brief Visit groups of nodes whose box meets a region.
/// @param[in] x Positions, (l, 3) [m].
/// @param[in] groups Rows of x, k of them in each group.
/// @param[in] k Number of nodes in a group.
/// @param[in] region The region.
/// @param[out] found Called with the rows of each such group.
template <class OnGroup>
void groups_in(std::span<const double> x, std::span<const std::int32_t> groups,
               std::size_t k, const Box& region, OnGroup&& found)
{
  for (std::size_t i = 0; i < groups.size(); i += k)
    if (const auto group = groups.subspan(i, k); bounds(x, group).meets(region))
      found(group);
}
} // namespace nts
