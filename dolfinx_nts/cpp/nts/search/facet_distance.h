#pragma once

#include "nts/geometry/small.h"
#include "nts/search/tree.h"

/// @brief Whether two groups of facets are near each other.
namespace nts
{
/// @brief Lower bound of the distance of two convex hulls along an axis [m].
/// @param[in] x Positions, (l, 3) [m].
/// @param[in] a, b Vertices of both, rows of x.
/// @param[in] axis Direction of any length; 0 gives 0.
inline double distance_along(std::span<const double> x,
                             std::span<const std::int32_t> a,
                             std::span<const std::int32_t> b,
                             const Vec3& axis) noexcept
{
  const double length = std::sqrt(dot(axis, axis));
  if (!(length > 0))
    return 0;
  Vec2 least = {INFINITY, INFINITY}, greatest = {-INFINITY, -INFINITY};
  for (const auto& [rows, side] : {std::pair(a, 0), std::pair(b, 1)})
    for (const std::int32_t row : rows)
    {
      const double at = dot(vector(x, row), axis) / length;
      least[side] = std::min(least[side], at);
      greatest[side] = std::max(greatest[side], at);
    }
  return std::max(least[1] - greatest[0], least[0] - greatest[1]);
}

/// @brief Normal of a facet of any length: area vector of a triangle, or of the
/// diagonals of a quadrilateral; in the plane, perpendicular to an edge.
inline Vec3 any_normal(std::span<const double> x,
                       std::span<const std::int32_t> facet) noexcept
{
  const auto at = [&](std::size_t i) { return vector(x, facet[i]); };
  if (facet.size() == 2)
  {
    const Vec3 edge = at(1) - at(0);
    return {-edge[1], edge[0], 0};
  }
  if (facet.size() == 3)
    return cross(at(1) - at(0), at(2) - at(0));
  return cross(at(3) - at(0), at(2) - at(1)); // tensor order
}

/// @brief Whether any facet of one group may be within a distance of one of the
/// other group.
///
/// Facets are farther apart if their convex hulls are along one of these axes:
/// the coordinate axes, both normals, and the line between the centres.
/// @param[in] x Positions, (l, 3) [m].
/// @param[in] facets, others Vertices of both groups, (n, k) and (m, k).
/// @param[in] k Vertices of a facet.
/// @param[in] reach The distance [m].
inline bool may_be_within(std::span<const double> x,
                          std::span<const std::int32_t> facets,
                          std::span<const std::int32_t> others, std::size_t k,
                          double reach)
{
  const auto each = [&](std::span<const std::int32_t> rows, std::size_t i)
  { return rows.subspan(k * i, k); };
  Box around = bounds(x, facets);
  around.widen(reach);
  std::vector<Box> boxes;
  std::vector<std::size_t> number;
  for (std::size_t i = 0; i < others.size() / k; ++i)
    if (const Box box = bounds(x, each(others, i)); box.meets(around))
    {
      boxes.push_back(box);
      number.push_back(i);
    }
  if (boxes.empty())
    return false;
  Box inner;
  for (const Box& box : boxes)
    inner.include(box);
  inner.widen(reach);
  const Tree tree(boxes);
  for (std::size_t i = 0; i < facets.size() / k; ++i)
  {
    const auto facet = each(facets, i);
    Box box = bounds(x, facet);
    if (!box.meets(inner))
      continue;
    const Vec3 centre = 0.5 * (box.lower + box.upper),
               half = box.upper - centre, normal = any_normal(x, facet);
    box.widen(reach);
    bool found = false;
    const double radius = std::sqrt(dot(half, half)) + reach;
    tree.nearest(
        centre, radius,
        [&](std::int32_t j)
        {
          if (!box.meets(boxes[j]))
            return radius;
          const auto other = each(others, number[j]);
          const Vec3 between = 0.5 * (boxes[j].lower + boxes[j].upper) - centre;
          found = true;
          for (const Vec3& axis : {normal, any_normal(x, other), between})
            found = found && distance_along(x, facet, other, axis) <= reach;
          return found ? NAN : radius;
        });
    if (found)
      return true;
  }
  return false;
}
} // namespace nts
