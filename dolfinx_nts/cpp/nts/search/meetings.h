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
/// @param[out] apart Distances of any two boxes, 0 where they overlap and
/// infinite on the diagonal (g, g) [m].
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
      apart[n * i + j] = std::max(way, 0.);
      // What is deep in the outer boundary is as deep in its box.
      if (way < -depth)
        found.push_back({static_cast<std::int32_t>(i),
                         static_cast<std::int32_t>(j), depth,
                         part_inside(boxes[i], boxes[j], depth)});
    }
  return found;
}

/// @brief Visit nodes, and edges whose box meets a region, as ways.
/// @param[in] x Positions, (l, 3) [m].
/// @param[in] nodes Rows of x, (n).
/// @param[in] edges Rows of x, (e, 2).
/// @param[in] region The region.
/// @param[out] found Called with begin and end of each way, which are the same
/// at nodes.
template <class OnWay>
void ways_in(std::span<const double> x, std::span<const std::int32_t> nodes,
             std::span<const std::int32_t> edges, const Box& region,
             OnWay&& found)
{
  // Edges have more ends than nodes.
  constexpr std::uint8_t unknown = 0xff;
  std::vector<std::uint8_t> sides(x.size() / 3, unknown);
  const auto beyond = [&](std::int32_t node)
  {
    if (sides[node] == unknown)
      sides[node] = region.sides_beyond(vector(x, node));
    return sides[node];
  };
  for (const std::int32_t node : nodes)
    if (beyond(node) == 0)
      found(vector(x, node), vector(x, node));
  for (std::size_t i = 0; i < edges.size(); i += 2)
    if (const std::int32_t a = edges[i], b = edges[i + 1];
        (beyond(a) & beyond(b)) == 0)
      found(vector(x, a), vector(x, b));
}
} // namespace nts
