#pragma once

#include "nts/geometry/facet.h"

#include <vector>

/// @brief Polygons in the reference cell of a facet.
namespace nts
{
/// @brief A polygon.
using Polygon = std::vector<Vec2>;

/// @brief Area of a polygon, > 0 where it runs counterclockwise.
inline double area(const Polygon& polygon) noexcept
{
  double sum = 0;
  for (std::size_t i = 0; i < polygon.size(); ++i)
  {
    const Vec2& a = polygon[i];
    const Vec2& b = polygon[(i + 1) % polygon.size()];
    sum += a[0] * b[1] - a[1] * b[0];
  }
  return sum / 2;
}

/// @brief Numbers of the vertices of a segment type, once around.
template <class S>
constexpr std::array<std::size_t, S::vertices> around() noexcept
{
  if constexpr (S::vertices == 3)
    return {0, 1, 2};
  else
    return {0, 1, 3, 2};
}

/// @brief Part of a convex polygon inside of the reference cell (Sutherland and
/// Hodgman).
template <class S>
Polygon clipped(Polygon polygon)
{
  // Sides of the cell: a . xi + c >= 0 inside.
  static constexpr std::array<std::array<double, 3>, 4> square
      = {{{1, 0, 0}, {0, 1, 0}, {-1, 0, 1}, {0, -1, 1}}};
  static constexpr std::array<std::array<double, 3>, 3> triangle
      = {{{1, 0, 0}, {0, 1, 0}, {-1, -1, 1}}};
  constexpr double round_off = 1e-12; // distance that is none
  const auto cut = [&](const std::array<double, 3>& side)
  {
    const auto inside = [&](const Vec2& p)
    { return side[0] * p[0] + side[1] * p[1] + side[2]; };
    Polygon part;
    for (std::size_t i = 0; i < polygon.size(); ++i)
    {
      const Vec2 &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      // Round-off must not cut slivers from sides that lie on each other.
      const auto rounded = [](double distance)
      { return std::abs(distance) < round_off ? 0 : distance; };
      const double at_a = rounded(inside(a)), at_b = rounded(inside(b));
      if (at_a >= 0)
        part.push_back(a);
      if ((at_a > 0 && at_b < 0) || (at_a < 0 && at_b > 0))
      {
        const double t = at_a / (at_a - at_b);
        part.push_back({a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])});
      }
    }
    polygon = std::move(part);
  };
  if constexpr (S::vertices == 3)
    std::ranges::for_each(triangle, cut);
  else
    std::ranges::for_each(square, cut);
  return polygon;
}

/// @brief Whether a convex polygon holds a point.
inline bool holds(const Polygon& polygon, const Vec2& xi) noexcept
{
  const double sense = area(polygon) < 0 ? -1 : 1;
  for (std::size_t i = 0; i < polygon.size(); ++i)
  {
    const Vec2 &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
    if (sense
            * ((b[0] - a[0]) * (xi[1] - a[1]) - (b[1] - a[1]) * (xi[0] - a[0]))
        < 0)
      return false;
  }
  return true;
}

/// @brief Call add(xi, weight) for the points of a rule on a convex polygon
/// that is exact for polynomials of degree 2, or 4.
template <std::size_t degree, class Add>
void integrate(const Polygon& p, Add&& add)
{
  static_assert(degree == 2 || degree == 4);
  if (p.size() == 4)
  {
    // Gauss' points on [0, 1] and their weights.
    static const std::array<double, 2> two
        = {0.5 - std::sqrt(1. / 12), 0.5 + std::sqrt(1. / 12)};
    static const std::array<double, 3> three
        = {0.5 - std::sqrt(3. / 20), 0.5, 0.5 + std::sqrt(3. / 20)};
    constexpr std::size_t n = degree == 2 ? 2 : 3;
    const auto at = [](std::size_t i) { return n == 2 ? two[i] : three[i]; };
    const auto part = [](std::size_t i)
    { return n == 2 ? 1. / 2 : (i == 1 ? 4. / 9 : 5. / 18); };
    for (std::size_t i = 0; i < n; ++i)
      for (std::size_t j = 0; j < n; ++j)
      {
        const double a = at(i), b = at(j);
        Vec2 xi, d1, d2;
        for (std::size_t d = 0; d < 2; ++d)
        {
          xi[d] = (1 - a) * (1 - b) * p[0][d] + a * (1 - b) * p[1][d]
                  + a * b * p[2][d] + (1 - a) * b * p[3][d];
          d1[d] = (1 - b) * (p[1][d] - p[0][d]) + b * (p[2][d] - p[3][d]);
          d2[d] = (1 - a) * (p[3][d] - p[0][d]) + a * (p[2][d] - p[1][d]);
        }
        add(xi, part(i) * part(j) * std::abs(d1[0] * d2[1] - d1[1] * d2[0]));
      }
    return;
  }
  // From the mean of the vertices, so that it does not matter which is the
  // first.
  Vec2 mean = {};
  for (const Vec2& vertex : p)
    for (std::size_t d = 0; d < 2; ++d)
      mean[d] += vertex[d] / static_cast<double>(p.size());
  // Three points for each pair: weight, and the part of the other two corners.
  using Orbit = std::array<double, 2>;
  static constexpr std::array<Orbit, 1> second = {{{1. / 3, 1. / 6}}};
  static constexpr std::array<Orbit, 2> fourth // Dunavant (1985)
      = {{{0.22338158967801147, 0.44594849091596489},
          {0.10995174365532187, 0.091576213509770743}}};
  const auto add_triangle = [&](const std::array<Vec2, 3>& corner)
  {
    const double whole = std::abs(area({corner[0], corner[1], corner[2]}));
    const auto add_orbit = [&](const Orbit& orbit)
    {
      const double other = orbit[1], own = 1 - 2 * other;
      for (std::size_t q = 0; q < 3; ++q)
      {
        Vec2 xi;
        for (std::size_t d = 0; d < 2; ++d)
          xi[d] = other * (corner[0][d] + corner[1][d] + corner[2][d])
                  + (own - other) * corner[q][d];
        add(xi, orbit[0] * whole);
      }
    };
    if constexpr (degree == 2)
      std::ranges::for_each(second, add_orbit);
    else
      std::ranges::for_each(fourth, add_orbit);
  };
  if (p.size() == 3)
    add_triangle({p[0], p[1], p[2]});
  else
    for (std::size_t i = 0; i < p.size(); ++i)
      add_triangle({mean, p[i], p[(i + 1) % p.size()]});
}
} // namespace nts
