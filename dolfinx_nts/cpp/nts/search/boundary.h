#pragma once

#include "nts/geometry/triangle.h"
#include "nts/search/tree.h"

/// @brief Triangles of the boundary of a body: what is inside of it.
namespace nts
{
/// @brief A point in which a way meets a boundary.
struct WayCut
{
  std::int32_t way; ///< number of the way
  double s;         ///< place on it, from 0 to 1
};

/// @brief Middles of the parts into which cuts divide ways.
/// @param[in] ways Begin and end of each way, (w, 6) [m].
/// @param[in] cuts The cuts, in any order. Ways without any have no parts.
/// @param[out] found Called with the number of the way and the middle.
template <class OnPart>
void parts_of_ways(std::span<const double> ways, std::vector<WayCut> cuts,
                   OnPart&& found)
{
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
    if (i == 0 || cuts[i - 1].way != way)
      add(0, cuts[i].s);
    const bool last = i + 1 == cuts.size() || cuts[i + 1].way != way;
    add(cuts[i].s, last ? 1 : cuts[i + 1].s);
  }
}

/// @brief Triangles of a closed boundary, or some of them.
///
/// A ray from a point leaves the boundary once more than it enters it if the
/// point is inside. Crossings are sums over triangles, so that the ranks which
/// have some of the triangles may each count their own.
class Boundary
{
public:
  /// @brief How often a ray leaves the boundary, less how often it enters it.
  struct Crossings
  {
    int count = 0;
    bool at_an_edge = false; ///< the count may be wrong
  };

  /// @param[in] x Vertices of the triangles in outward sense, (t, 3, 3) [m].
  explicit Boundary(std::span<const double> x)
      : _triangles(x.size() / 9), _tree(boxes(x, _triangles))
  {
  }

  /// @brief Number of triangles.
  std::size_t size() const noexcept { return _triangles.size(); }

  /// @brief Go on with other positions of the same vertices, (t, 3, 3) [m].
  void move(std::span<const double> x) { _tree.refit(boxes(x, _triangles)); }

  /// @brief Crossings of a ray that begins at a point.
  Crossings crossings(const Vec3& point) const noexcept
  {
    // Along no line of symmetry: such rays seldom hit an edge.
    constexpr Vec3 direction = {0.4819027, 0.2713465, 0.8331541};
    const Box box = _tree.bounds();
    Crossings found;
    if (_triangles.empty())
      return found;
    // Beyond the boundary, wherever the point is.
    const double length
        = norm(box.upper - box.lower) + std::sqrt(box.squared_distance(point));
    const Vec3 end = point + 2 * length * direction;
    _tree.along(point, end,
                [&](std::int32_t i) noexcept
                {
                  if (const auto c = cut(point, end, _triangles[i]);
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
    for (const Triangle& triangle : _triangles)
      sum += nts::winding(point, triangle);
    return sum;
  }

  /// @brief Distance of a point to the nearest triangle [m], infinite without
  /// one.
  /// @param[in] point The point [m].
  /// @param[in] least Distance below which another triangle may be taken that
  /// is as near as that [m].
  double distance(const Vec3& point, double least) const noexcept
  {
    double nearest = INFINITY;
    _tree.nearest(point, nearest,
                  [&](std::int32_t i) noexcept
                  {
                    nearest = std::min(nearest, std::sqrt(squared_distance(
                                                    point, _triangles[i])));
                    return nearest > least ? nearest : 0;
                  });
    return nearest;
  }

  /// @brief Points in which straight ways meet the triangles.
  /// @param[in] ways Begin and end of each way, (w, 6) [m].
  std::vector<WayCut> cuts(std::span<const double> ways) const
  {
    std::vector<WayCut> found;
    for (std::size_t w = 0; w < ways.size() / 6; ++w)
    {
      const Vec3 from = vector(ways, 2 * w), to = vector(ways, 2 * w + 1);
      _tree.along(from, to,
                  [&](std::int32_t i)
                  {
                    const auto c = cut(from, to, _triangles[i]);
                    if (c && c->s >= 0 && c->s <= 1)
                      found.push_back({static_cast<std::int32_t>(w), c->s});
                  });
    }
    return found;
  }

private:
  /// @brief Read the triangles, and make a box around each of them.
  static std::vector<Box> boxes(std::span<const double> x,
                                std::vector<Triangle>& triangles)
  {
    constexpr double margin = 1e-9; // of the triangle, far above round-off
    std::vector<Box> boxes(triangles.size());
    for (std::size_t i = 0; i < triangles.size(); ++i)
    {
      for (std::size_t v = 0; v < 3; ++v)
      {
        triangles[i][v] = vector(x, 3 * i + v);
        boxes[i].include(triangles[i][v]);
      }
      boxes[i].widen(margin * norm(boxes[i].upper - boxes[i].lower));
    }
    return boxes;
  }

  std::vector<Triangle> _triangles;
  Tree _tree;
};
} // namespace nts
