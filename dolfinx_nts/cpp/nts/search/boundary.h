#pragma once

#include "nts/geometry/triangle.h"
#include "nts/search/tree.h"

/// @brief Triangles of the boundary of a body, for point-in-body tests.
namespace nts
{
/// @brief Triangles of a closed boundary, or some of them.
///
/// A ray from a point leaves the boundary once more than it enters it if the
/// point is inside. Crossings are sums over triangles, so that each rank can
/// count the crossings of its triangles.
class Boundary
{
public:
  /// @brief Number of exits of a ray through the boundary minus the number of
  /// entries.
  struct Crossings
  {
    int count = 0;
    bool at_an_edge = false; ///< the count may be wrong
  };

  /// @param[in] x Positions, (l, 3) [m], which are not copied.
  /// @param[in] rows Vertices of the triangles in outward sense, (t, 3).
  Boundary(std::span<const double> x, std::span<const std::int32_t> rows)
      : _x(x), _rows(rows.size() / 3), _tree(boxes(x, rows))
  {
    const std::vector<std::int32_t> number = _tree.renumber();
    for (std::size_t i = 0; i < _rows.size(); ++i)
      std::ranges::copy(rows.subspan(3 * number[i], 3), _rows[i].begin());
  }

  /// @brief Set new positions of the vertices, (l, 3) [m], which are not
  /// copied.
  void move(std::span<const double> x)
  {
    _x = x;
    _tree.refit([&](std::size_t i) { return around(bounds(x, _rows[i])); });
  }

  /// @brief Crossings of a ray that starts at a point.
  /// @param[in] point The point [m].
  /// @param[in] whole Box of the whole boundary, of which this object may be a
  /// part.
  Crossings crossings(const Vec3& point, const Box& whole) const noexcept
  {
    Crossings found;
    if (!whole.meets(Box{point, point}))
      return found;
    const Vec3 end = beyond(point, whole);
    _tree.along(point, end,
                [&](std::int32_t i) noexcept
                {
                  if (const auto c = cut(point, end, triangle(i));
                      c && c->s >= 0)
                  {
                    found.count += c->sign;
                    found.at_an_edge = found.at_an_edge || c->at_an_edge;
                  }
                });
    return found;
  }

  /// @brief Solid angle of all triangles over 4 pi.
  double winding(const Vec3& point) const noexcept
  {
    double sum = 0;
    for (std::size_t i = 0; i < _rows.size(); ++i)
      sum += nts::winding(point, triangle(i));
    return sum;
  }

  /// @brief Distance of a point to the nearest triangle [m], infinite without
  /// one.
  /// @param[in] point The point [m].
  /// @param[in] least Distance [m] below which the search may stop.
  double distance(const Vec3& point, double least) const noexcept
  {
    double nearest = INFINITY;
    _tree.nearest(point, nearest,
                  [&](std::int32_t i) noexcept
                  {
                    nearest = std::min(nearest, std::sqrt(squared_distance(
                                                    point, triangle(i))));
                    return nearest > least ? nearest : 0;
                  });
    return nearest;
  }

  /// @brief Coordinates from 0 to 1 at which a straight path intersects
  /// triangles, and the side on which it continues, see `PathCut`.
  template <class OnCut>
  void cuts(const Vec3& begin, const Vec3& end, OnCut&& found) const
  {
    if (begin == end)
      return;
    _tree.along(begin, end,
                [&](std::int32_t i)
                {
                  const auto c = cut(begin, end, triangle(i));
                  if (c && c->s >= 0 && c->s <= 1)
                    found(c->s, c->at_an_edge ? 0 : c->sign);
                });
  }

private:
  /// @brief End of a ray: a point outside a box, on the side nearest to the
  /// start of the ray.
  static Vec3 beyond(const Vec3& point, const Box& box) noexcept
  {
    // Not along a line of symmetry, so that rays rarely hit an edge.
    constexpr Vec3 direction = {0.8331541, 0.4819027, 0.2713465};
    std::size_t axis = 0;
    double sign = 1, nearest = INFINITY;
    for (std::size_t i = 0; i < 3; ++i)
      for (const double side : {-1., 1.})
      {
        const double distance
            = side < 0 ? point[i] - box.lower[i] : box.upper[i] - point[i];
        if (distance < nearest)
          nearest = distance, axis = i, sign = side;
      }
    // Twice the distance of that side of the box, plus a margin above
    // round-off.
    const double length
        = sign * (2 * nearest + 1e-3 * norm(box.upper - box.lower));
    Vec3 end = point;
    for (std::size_t i = 0; i < 3; ++i)
      end[(axis + i) % 3] += length * direction[i];
    return end;
  }

  Triangle triangle(std::size_t i) const noexcept
  {
    const auto& [a, b, c] = _rows[i];
    return {vector(_x, a), vector(_x, b), vector(_x, c)};
  }

  /// @brief Box with a margin far larger than round-off.
  static Box around(Box box) noexcept
  {
    constexpr double margin = 1e-9; // relative to the longest side
    box.widen(margin * std::ranges::max(box.upper - box.lower));
    return box;
  }

  /// @brief Boxes around triangles.
  static std::vector<Box> boxes(std::span<const double> x,
                                std::span<const std::int32_t> rows)
  {
    std::vector<Box> boxes;
    for (std::size_t i = 0; i < rows.size(); i += 3)
      boxes.push_back(around(bounds(x, rows.subspan(i, 3))));
    return boxes;
  }

  std::span<const double> _x;
  std::vector<std::array<std::int32_t, 3>> _rows;
  Tree _tree;
};
} // namespace nts
