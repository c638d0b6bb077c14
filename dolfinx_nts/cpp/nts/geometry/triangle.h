#pragma once

#include "nts/geometry/small.h"

#include <optional>

/// @brief Triangles of a boundary: distance, solid angle, and intersections
/// with lines.
namespace nts
{
/// @brief Vertices; the product of the edges 01 and 02 points out of the body.
using Triangle = std::array<Vec3, 3>;

/// @brief Squared distance of a point to a segment of a line [m^2].
inline double squared_distance(const Vec3& point, const Vec3& begin,
                               const Vec3& end) noexcept
{
  const Vec3 along = end - begin, r = point - begin;
  const double square = dot(along, along);
  const double s = square > 0 ? std::clamp(dot(r, along) / square, 0., 1.) : 0.;
  const Vec3 offset = r - s * along;
  return dot(offset, offset);
}

/// @brief Squared distance of a point to a triangle [m^2].
inline double squared_distance(const Vec3& point, const Triangle& t) noexcept
{
  const Vec3 normal = cross(t[1] - t[0], t[2] - t[0]);
  const double square = dot(normal, normal);
  bool above = square > 0; // the point lies above the triangle or below it
  double nearest = INFINITY;
  for (std::size_t i = 0; i < 3; ++i)
  {
    const Vec3 &begin = t[i], &end = t[(i + 1) % 3];
    nearest = std::min(nearest, squared_distance(point, begin, end));
    above = above && dot(cross(end - begin, point - begin), normal) >= 0;
  }
  if (!above)
    return nearest;
  const double height = dot(point - t[0], normal);
  return std::min(nearest, height * height / square);
}

/// @brief Solid angle of a triangle over 4 pi, > 0 for points behind it (Van
/// Oosterom, Strackee 1983): over a closed boundary it sums to 1 inside, 0
/// outside.
inline double winding(const Vec3& point, const Triangle& t) noexcept
{
  constexpr double two_pi = 6.283185307179586;
  const Vec3 a = t[0] - point, b = t[1] - point, c = t[2] - point;
  const double la = norm(a), lb = norm(b), lc = norm(c);
  const double up = dot(a, cross(b, c));
  const double down
      = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
  return std::atan2(up, down) / two_pi;
}

/// @brief Intersection of a line with the plane of a triangle.
struct Cut
{
  double s;        ///< place on the line, 0 at its begin, 1 at its end
  int sign;        ///< 1 if it leaves the body there, -1 if it enters it
  bool at_an_edge; ///< whether round-off decides on which side of an edge
};

/// @brief Intersection of the line through two points with a triangle, none if
/// the line misses the triangle or lies in its plane.
///
/// The sign of the volume of the tetrahedron of line and edge gives the side on
/// which the line passes the edge.
inline std::optional<Cut> cut(const Vec3& begin, const Vec3& end,
                              const Triangle& t) noexcept
{
  constexpr double rounding
      = 1e-12; // round-off of volumes over products of edges
  const Vec3 along = end - begin;
  std::array<Vec3, 3> r;
  double size = 0;
  for (std::size_t i = 0; i < 3; ++i)
  {
    r[i] = t[i] - begin;
    size = std::max(size, dot(r[i], r[i]));
  }
  const double tolerance = rounding * norm(along) * size;
  bool positive = false, negative = false, zero = false;
  double sum = 0;
  for (std::size_t i = 0; i < 3; ++i)
  {
    const double volume = dot(along, cross(r[i], r[(i + 1) % 3]));
    sum += volume;
    zero = zero || std::abs(volume) <= tolerance;
    positive = positive || volume > tolerance;
    negative = negative || volume < -tolerance;
  }
  // On both sides, or in the plane.
  if (positive == negative || std::abs(sum) <= tolerance)
    return std::nullopt;
  return Cut{dot(r[0], cross(r[1], r[2])) / sum, positive ? 1 : -1, zero};
}
} // namespace nts
