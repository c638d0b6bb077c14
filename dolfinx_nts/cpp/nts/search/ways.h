#pragma once

#include "nts/geometry/box.h"

#include <utility>
#include <vector>

/// @brief Straight ways, along edges or at nodes of one boundary, and the parts
/// of them that may be inside another one.
namespace nts
{
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

/// @brief A point in which a way meets a boundary.
struct WayCut
{
  std::int32_t way; ///< number of the way
  double s;         ///< place on it, from 0 to 1
  /// 1 if the way leaves the boundary there, -1 if it enters it, 0 if it meets
  /// an edge or a vertex of it
  std::int32_t side;
};

/// @brief Ways that are points, and middles of those parts, into which cuts
/// divide the others, that are not known to be outside.
/// @param[in] ways Begin and end of each way, (w, 6) [m].
/// @param[in] cuts The cuts, in any order. Ways without any have no parts.
/// @param[out] found Called with the number of the way and the point; ways that
/// are points come first.
template <class OnPoint>
void points_of_ways(std::span<const double> ways, std::vector<WayCut> cuts,
                    OnPoint&& found)
{
  for (std::size_t w = 0; w < ways.size() / 6; ++w)
    if (const Vec3 point = vector(ways, 2 * w);
        point == vector(ways, 2 * w + 1))
      found(static_cast<std::int32_t>(w), point);
  std::ranges::sort(cuts, {},
                    [](const WayCut& c) { return std::pair(c.way, c.s); });
  for (std::size_t i = 0; i < cuts.size(); ++i)
  {
    const std::int32_t way = cuts[i].way;
    const Vec3 begin = vector(ways, 2 * way), end = vector(ways, 2 * way + 1);
    const auto add = [&](double from, double to)
    {
      const double s = (from + to) / 2;
      found(way, (1 - s) * begin + s * end);
    };
    if ((i == 0 || cuts[i - 1].way != way) && cuts[i].side >= 0)
      add(0, cuts[i].s);
    const bool last = i + 1 == cuts.size() || cuts[i + 1].way != way;
    if (cuts[i].side <= 0 && (last || cuts[i + 1].side >= 0))
      add(cuts[i].s, last ? 1 : cuts[i + 1].s);
  }
}
} // namespace nts
