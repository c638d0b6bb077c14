#pragma once

#include "nts/geometry/triangle.h"
#include "nts/search/tree.h"

/// @brief Triangles of the boundary of a body: what is inside of it.
namespace nts
{
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

  /// @brief A point in which a way meets the boundary.
  struct WayCut
  {
    std::int32_t way; ///< number of the way
    double s;         ///< place on it, from 0 to 1
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
  double distance(const Vec3& point) const noexcept
  {
    double nearest = INFINITY;
    _tree.nearest(point, nearest,
                  [&](std::int32_t i) noexcept
                  {
                    nearest = std::min(nearest, std::sqrt(squared_distance(
                                                    point, _triangles[i])));
                    return nearest;
                  });
    return nearest;
  }

  /// @brief Points in which straight ways meet the triangles.
  /// @param[in] begin, end Ends of the ways, (w, 3) [m].
  std::vector<WayCut> cuts(std::span<const double> begin,
                           std::span<const double> end) const
  {
    std::vector<WayCut> found;
    for (std::size_t w = 0; w < begin.size() / 3; ++w)
    {
      const Vec3 from = vector(begin, w), to = vector(end, w);
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
