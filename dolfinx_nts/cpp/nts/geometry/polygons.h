#pragma once

#include "nts/geometry/segment.h"

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

/// @brief Coordinates in the reference cell of a point in the plane of a
/// facet with corners c; any, but one function of the point, if there are none.
template <class S>
Vec2 pulled_back(const Vec2& y, const std::array<Vec2, S::vertices>& c) noexcept
{
  constexpr int max_iterations = 20;
  constexpr double accurate = 1e-14, longest = 2, degenerate = 1e-12;
  const auto at = [&](const auto& weights)
  {
    Vec2 sum = {};
    for (std::size_t i = 0; i < S::vertices; ++i)
      for (std::size_t d = 0; d < 2; ++d)
        sum[d] += weights[i] * c[i][d];
    return sum;
  };
  const auto jacobian = [&](const Vec2& xi) -> Matrix<2, 2>
  {
    const Matrix<2, S::vertices> d = S::dphi(xi);
    const Vec2 a = at(d[0]), b = at(d[1]);
    return {{{a[0], b[0]}, {a[1], b[1]}}};
  };
  Vec2 xi = S::centre;
  const Matrix<2, 2> first = jacobian(xi);
  for (int iteration = 0; iteration < max_iterations; ++iteration)
  {
    const Vec2 there = at(S::phi(xi));
    Matrix<2, 2> J = jacobian(xi);
    if (!(std::abs(det(J)) > degenerate * std::abs(det(first))))
      J = first;
    Vec2 step = inverse(J) * Vec2{y[0] - there[0], y[1] - there[1]};
    const double way = std::max(std::abs(step[0]), std::abs(step[1]));
    // The first step goes to where the affine part of the map leads.
    if (iteration > 0 && way > longest)
      step = {longest / way * step[0], longest / way * step[1]};
    xi = {xi[0] + step[0], xi[1] + step[1]};
    if (way < accurate)
      break;
  }
  return xi;
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
/// that is exact for polynomials of degree 2.
template <class Add>
void integrate(const Polygon& p, Add&& add)
{
  if (p.size() == 4)
  {
    static const double offset = std::sqrt(1. / 12);
    for (const double a : {0.5 - offset, 0.5 + offset})
      for (const double b : {0.5 - offset, 0.5 + offset})
      {
        Vec2 xi, d1, d2;
        for (std::size_t d = 0; d < 2; ++d)
        {
          xi[d] = (1 - a) * (1 - b) * p[0][d] + a * (1 - b) * p[1][d]
                  + a * b * p[2][d] + (1 - a) * b * p[3][d];
          d1[d] = (1 - b) * (p[1][d] - p[0][d]) + b * (p[2][d] - p[3][d]);
          d2[d] = (1 - a) * (p[3][d] - p[0][d]) + a * (p[2][d] - p[1][d]);
        }
        add(xi, std::abs(d1[0] * d2[1] - d1[1] * d2[0]) / 4);
      }
    return;
  }
  // From the mean of the vertices, so that it does not matter which is the
  // first.
  Vec2 mean = {};
  for (const Vec2& vertex : p)
    for (std::size_t d = 0; d < 2; ++d)
      mean[d] += vertex[d] / static_cast<double>(p.size());
  const auto add_triangle = [&](const std::array<Vec2, 3>& corner)
  {
    const double weight = std::abs(area({corner[0], corner[1], corner[2]})) / 3;
    for (std::size_t q = 0; q < 3; ++q)
    {
      Vec2 xi;
      for (std::size_t d = 0; d < 2; ++d)
        xi[d] = (corner[0][d] + corner[1][d] + corner[2][d] + 3 * corner[q][d])
                / 6;
      add(xi, weight);
    }
  };
  if (p.size() == 3)
    add_triangle({p[0], p[1], p[2]});
  else
    for (std::size_t i = 0; i < p.size(); ++i)
      add_triangle({mean, p[i], p[(i + 1) % p.size()]});
}
} // namespace nts
