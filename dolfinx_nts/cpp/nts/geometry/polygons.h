#pragma once

#include "nts/geometry/facet.h"

#include <vector>

/// @brief Polygons in the reference cell of a facet.
namespace nts
{
/// @brief A polygon.
using Polygon = std::vector<Vec2>;

/// @brief Area of a polygon, > 0 if its vertices are counterclockwise.
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

/// @brief Numbers of the vertices of a segment type in cyclic order.
template <class S>
constexpr std::array<std::size_t, S::vertices> around() noexcept
{
  if constexpr (S::vertices == 3)
    return {0, 1, 2};
  else
    return {0, 1, 3, 2};
}

/// @brief Sides of a convex region: a . p + c >= 0 inside, for each {a, c}.
template <std::size_t m>
using Sides = std::array<std::array<double, 3>, m>;

/// @brief Part of a convex polygon inside a convex region (Sutherland and
/// Hodgman). The values of the sides are of the order of 1.
template <std::size_t m>
Polygon clipped(Polygon polygon, const Sides<m>& sides)
{
  constexpr double round_off = 1e-12; // distance that counts as zero
  const auto cut = [&](const std::array<double, 3>& side)
  {
    const auto inside = [&](const Vec2& p)
    { return side[0] * p[0] + side[1] * p[1] + side[2]; };
    Polygon part;
    for (std::size_t i = 0; i < polygon.size(); ++i)
    {
      const Vec2 &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      // Round-off must not leave slivers at coinciding sides.
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
  std::ranges::for_each(sides, cut);
  return polygon;
}

/// @brief Part of a convex polygon inside of the reference cell.
template <class S>
Polygon clipped(Polygon polygon)
{
  if constexpr (S::vertices == 3)
    return clipped(std::move(polygon),
                   Sides<3>{{{1, 0, 0}, {0, 1, 0}, {-1, -1, 1}}});
  else
    return clipped(std::move(polygon),
                   Sides<4>{{{1, 0, 0}, {0, 1, 0}, {-1, 0, 1}, {0, -1, 1}}});
}

/// @brief Whether a convex polygon contains a point.
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

/// @brief Area, centroid, and second moments about it divided by the area.
struct Moments
{
  double area;
  Vec2 centroid;
  Matrix<2, 2> second;
};

/// @brief Moments of a convex polygon, independent of its first vertex.
inline Moments moments(const Polygon& p) noexcept
{
  const auto sum = [&](const Vec2& from, auto&& add)
  {
    for (std::size_t i = 0; i < p.size(); ++i)
    {
      const Vec2 &u = p[i], &v = p[(i + 1) % p.size()];
      const Vec2 a = {u[0] - from[0], u[1] - from[1]},
                 b = {v[0] - from[0], v[1] - from[1]};
      add(std::abs(a[0] * b[1] - a[1] * b[0]) / 2, a, b);
    }
  };
  Vec2 mean = {};
  for (const Vec2& vertex : p)
    for (std::size_t d = 0; d < 2; ++d)
      mean[d] += vertex[d] / static_cast<double>(p.size());
  Moments m = {0, mean, {}};
  Vec2 first = {};
  sum(mean,
      [&](double area, const Vec2& a, const Vec2& b)
      {
        m.area += area;
        for (std::size_t d = 0; d < 2; ++d)
          first[d] += area * (a[d] + b[d]) / 3;
      });
  for (std::size_t d = 0; d < 2; ++d)
    m.centroid[d] += first[d] / m.area;
  sum(m.centroid,
      [&](double area, const Vec2& a, const Vec2& b)
      {
        for (std::size_t d = 0; d < 2; ++d)
          for (std::size_t e = 0; e < 2; ++e)
            m.second[d][e] += area / m.area / 12
                              * (a[d] * a[e] + b[d] * b[e]
                                 + (a[d] + b[d]) * (a[e] + b[e]));
      });
  return m;
}

/// @brief Symmetric square root of a symmetric positive semidefinite matrix.
inline Matrix<2, 2> root(const Matrix<2, 2>& A) noexcept
{
  const double product = std::sqrt(std::max(det(A), 0.));
  const double sum = std::sqrt(A[0][0] + A[1][1] + 2 * product);
  return {{{(A[0][0] + product) / sum, A[0][1] / sum},
           {A[1][0] / sum, (A[1][1] + product) / sum}}};
}

/// @brief Call add(xi, weight) for the points of a rule on a convex polygon in
/// the reference cell of a facet that is exact for polynomials of degree 2.
///
/// Points of equal weights with the mean and the covariance of the polygon: the
/// symmetric root of the covariance times vectors that are permuted by the
/// symmetries of the cell, so that the rule does not depend on the numbering of
/// vertices. In a square they point to its corners; a triangle is first mapped
/// to a regular one. A ball of this radius is inside any convex polygon with
/// the covariance 1 (Kannan, Lovasz and Simonovits 1995).
template <class S, class Add>
void integrate(const Polygon& p, Add&& add)
{
  static const double height = std::sqrt(0.75);
  const Moments m = moments(p);
  if constexpr (S::vertices == 4)
  {
    const Matrix<2, 2> R = root(m.second);
    for (const Vec2& v : {Vec2{-1, -1}, {1, -1}, {1, 1}, {-1, 1}})
    {
      const Vec2 offset = R * v;
      add(Vec2{m.centroid[0] + offset[0], m.centroid[1] + offset[1]},
          m.area / 4);
    }
  }
  else
  {
    // To the regular triangle with the same first edge, and back.
    const Matrix<2, 2> T = {{{1, 0.5}, {0, height}}};
    const Matrix<2, 2> back = inverse(T), &J = m.second;
    Matrix<2, 2> K = {};
    for (std::size_t a = 0; a < 2; ++a)
      for (std::size_t b = 0; b < 2; ++b)
        for (std::size_t c = 0; c < 2; ++c)
          for (std::size_t d = 0; d < 2; ++d)
            K[a][b] += T[a][c] * J[c][d] * T[b][d];
    const Matrix<2, 2> R = root(K);
    const double length = std::sqrt(2.);
    for (const Vec2& v : {Vec2{-height, -0.5}, {height, -0.5}, {0, 1}})
    {
      const Vec2 offset = back * (R * v);
      add(Vec2{m.centroid[0] + length * offset[0],
               m.centroid[1] + length * offset[1]},
          m.area / 3);
    }
  }
}

/// @brief Call add(xi, weight) for the points of a rule that is exact for
/// polynomials of degree 4.
template <class Add>
void integrate_fourth(const Polygon& p, Add&& add)
{
  if (p.size() == 4)
  {
    // Gauss points on [0, 1] and their weights.
    static const double offset = std::sqrt(3. / 20);
    static const std::array<Vec2, 3> rule
        = {{{0.5 - offset, 5. / 18}, {0.5, 4. / 9}, {0.5 + offset, 5. / 18}}};
    for (const auto& [a, first] : rule)
      for (const auto& [b, second] : rule)
      {
        Vec2 xi, d1, d2;
        for (std::size_t d = 0; d < 2; ++d)
        {
          xi[d] = (1 - a) * (1 - b) * p[0][d] + a * (1 - b) * p[1][d]
                  + a * b * p[2][d] + (1 - a) * b * p[3][d];
          d1[d] = (1 - b) * (p[1][d] - p[0][d]) + b * (p[2][d] - p[3][d]);
          d2[d] = (1 - a) * (p[3][d] - p[0][d]) + a * (p[2][d] - p[1][d]);
        }
        add(xi, first * second * std::abs(d1[0] * d2[1] - d1[1] * d2[0]));
      }
    return;
  }
  // Three points for each entry: weight, and barycentric coordinate of two
  // corners (Dunavant 1985).
  static constexpr std::array<Vec2, 2> rule
      = {{{0.22338158967801147, 0.44594849091596489},
          {0.10995174365532187, 0.091576213509770743}}};
  const auto add_triangle = [&](const std::array<Vec2, 3>& corner)
  {
    const double whole = std::abs(area({corner[0], corner[1], corner[2]}));
    for (const auto& [weight, other] : rule)
      for (std::size_t q = 0; q < 3; ++q)
      {
        Vec2 xi;
        for (std::size_t d = 0; d < 2; ++d)
          xi[d] = other * (corner[0][d] + corner[1][d] + corner[2][d])
                  + (1 - 3 * other) * corner[q][d];
        add(xi, weight * whole);
      }
  };
  if (p.size() == 3)
    return add_triangle({p[0], p[1], p[2]});
  const Vec2 middle = moments(p).centroid;
  for (std::size_t i = 0; i < p.size(); ++i)
    add_triangle({middle, p[i], p[(i + 1) % p.size()]});
}
} // namespace nts
