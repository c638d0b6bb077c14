#pragma once

#include "nts/geometry/box.h"

#include <utility>
#include <vector>

/// @brief Edges of one boundary as straight paths, nodes as paths of length
/// zero, and the parts of them that may be inside another boundary.
namespace nts
{
/// @brief Visit nodes, and edges whose box meets a region, as paths.
/// @param[in] x Positions, (l, 3) [m].
/// @param[in] nodes Rows of x, (n).
/// @param[in] edges Rows of x, (e, 2).
/// @param[in] region The region.
/// @param[out] found Called with start and end of each path, which are equal
/// for nodes.
template <class OnPath>
void paths_in(std::span<const double> x, std::span<const std::int32_t> nodes,
              std::span<const std::int32_t> edges, const Box& region,
              OnPath&& found)
{
  // Several edges share a node: store its sides once.
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

/// @brief An intersection of a path with a boundary.
struct PathCut
{
  std::int32_t path; ///< number of the path
  double s;          ///< place on it, from 0 to 1
  /// 1 if the path leaves the boundary, -1 if it enters, 0 if it intersects an
  /// edge or a vertex
  std::int32_t side;
};

/// @brief Paths of length zero, and midpoints of the parts of other paths
/// between intersections that are not known to be outside.
/// @param[in] paths Start and end of each path, (w, 6) [m].
/// @param[in] cuts Intersections in any order. Paths without any have no parts.
/// @param[out] found Called with the number of the path and the point; paths of
/// length zero come first.
template <class OnPoint>
void points_of_paths(std::span<const double> paths, std::vector<PathCut> cuts,
                     OnPoint&& found)
{
  for (std::size_t w = 0; w < paths.size() / 6; ++w)
    if (const Vec3 point = vector(paths, 2 * w);
        point == vector(paths, 2 * w + 1))
      found(static_cast<std::int32_t>(w), point);
  std::ranges::sort(cuts, {},
                    [](const PathCut& c) { return std::pair(c.path, c.s); });
  for (std::size_t i = 0; i < cuts.size(); ++i)
  {
    const std::int32_t path = cuts[i].path;
    const Vec3 begin = vector(paths, 2 * path),
               end = vector(paths, 2 * path + 1);
    const auto add = [&](double from, double to)
    {
      const double s = (from + to) / 2;
      found(path, (1 - s) * begin + s * end);
    };
    if ((i == 0 || cuts[i - 1].path != path) && cuts[i].side >= 0)
      add(0, cuts[i].s);
    const bool last = i + 1 == cuts.size() || cuts[i + 1].path != path;
    if (cuts[i].side <= 0 && (last || cuts[i + 1].side >= 0))
      add(cuts[i].s, last ? 1 : cuts[i + 1].s);
  }
}
} // namespace nts
