#pragma once

#include "nts/geometry/patch.h"

#include <type_traits>

/// @brief Shape functions of whole facets: of degree 2 in the order of Basix;
/// facets of degree 1 are segments.
///
/// `Linear` is the segment type on the same reference cell, whose shape
/// functions belong to the vertices, which come first. Facets of degree 2 are
/// smooth segments, too, with their nodes as control points, see `patch.h`.
namespace nts
{
/// @brief Quadratic edge in the plane, see `Line2`.
struct Line3
{
  using Linear = Line2;
  static constexpr std::size_t vertices = 3;
  static constexpr bool is_patch = true, is_plane = true;
  static constexpr Vec2 centre = Line2::centre;

  static constexpr std::array<double, 3> phi(const Vec2& xi) noexcept
  {
    const double a = xi[0];
    return {(1 - a) * (1 - 2 * a), a * (2 * a - 1), 4 * a * (1 - a)};
  }

  static constexpr std::array<double, 3> slopes(double a) noexcept
  {
    return {4 * a - 3, 4 * a - 1, 4 - 8 * a};
  }

  static constexpr Matrix<2, 3> dphi(const Vec2& xi) noexcept
  {
    return {slopes(xi[0]), {0, 0, 0}};
  }

  static constexpr std::array<double, 3> curvatures() noexcept
  {
    return {4, 4, -8};
  }

  static constexpr Matrix<3, 3> d2phi(const Vec2&) noexcept
  {
    return {curvatures(), {}, {}};
  }

  static std::array<Vec3, 2> tangents(const std::array<Vec3, 3>& x,
                                      const Vec2& xi) noexcept
  {
    return {combine(slopes(xi[0]), x), out_of_plane(x[1] - x[0])};
  }
};

/// @brief Quadratic triangle.
struct Tri6
{
  using Linear = Tri3;
  static constexpr std::size_t vertices = 6;
  static constexpr bool is_patch = true, is_plane = false;
  static constexpr Vec2 centre = Tri3::centre;

  static constexpr std::array<double, 6> phi(const Vec2& xi) noexcept
  {
    const double a = xi[0], b = xi[1], c = 1 - a - b;
    return {c * (2 * c - 1), a * (2 * a - 1), b * (2 * b - 1),
            4 * a * b,       4 * b * c,       4 * a * c};
  }

  static constexpr Matrix<2, 6> dphi(const Vec2& xi) noexcept
  {
    const double a = xi[0], b = xi[1], c = 1 - a - b;
    return {{{1 - 4 * c, 4 * a - 1, 0, 4 * b, -4 * b, 4 * (c - a)},
             {1 - 4 * c, 0, 4 * b - 1, 4 * a, 4 * (c - b), -4 * a}}};
  }

  static constexpr Matrix<3, 6> d2phi(const Vec2&) noexcept
  {
    return {{{4, 4, 0, 0, 0, -8}, {4, 0, 0, 4, -4, -4}, {4, 0, 4, 0, -8, 0}}};
  }

  static std::array<Vec3, 2> tangents(const std::array<Vec3, 6>& x,
                                      const Vec2& xi) noexcept
  {
    return tangents_in_space<Tri6>(x, xi);
  }
};

/// @brief Biquadratic quadrilateral: products of the functions of `Line3`.
struct Quad9
{
  using Linear = Quad4;
  static constexpr std::size_t vertices = 9;
  static constexpr bool is_patch = true, is_plane = false;
  static constexpr Vec2 centre = Quad4::centre;
  /// Functions of the first and of the second coordinate of each node.
  static constexpr std::array<std::array<std::size_t, 2>, 9> factors = {
      {{0, 0}, {1, 0}, {0, 1}, {1, 1}, {2, 0}, {0, 2}, {1, 2}, {2, 1}, {2, 2}}};

  static constexpr std::array<double, 9> phi(const Vec2& xi) noexcept
  {
    return product(Line3::phi({xi[0], 0}), Line3::phi({xi[1], 0}));
  }

  static constexpr Matrix<2, 9> dphi(const Vec2& xi) noexcept
  {
    return {product(Line3::slopes(xi[0]), Line3::phi({xi[1], 0})),
            product(Line3::phi({xi[0], 0}), Line3::slopes(xi[1]))};
  }

  static constexpr Matrix<3, 9> d2phi(const Vec2& xi) noexcept
  {
    return {product(Line3::curvatures(), Line3::phi({xi[1], 0})),
            product(Line3::slopes(xi[0]), Line3::slopes(xi[1])),
            product(Line3::phi({xi[0], 0}), Line3::curvatures())};
  }

  static std::array<Vec3, 2> tangents(const std::array<Vec3, 9>& x,
                                      const Vec2& xi) noexcept
  {
    return tangents_in_space<Quad9>(x, xi);
  }

private:
  static constexpr std::array<double, 9>
  product(const std::array<double, 3>& first,
          const std::array<double, 3>& second) noexcept
  {
    std::array<double, 9> values = {};
    for (std::size_t i = 0; i < 9; ++i)
      values[i] = first[factors[i][0]] * second[factors[i][1]];
    return values;
  }
};

/// @brief Tangents of a facet; in the plane the tangent of an edge, and one
/// along z, see `Line2`.
template <class F>
std::array<Vec3, 2> tangents(const std::array<Vec3, F::vertices>& x,
                             const Vec2& xi) noexcept
{
  const Matrix<2, F::vertices> d = F::dphi(xi);
  const Vec3 first = combine(d[0], x);
  if constexpr (std::is_same_v<typename F::Linear, Line2>)
    return {first, out_of_plane(first)};
  else
    return {first, combine(d[1], x)};
}

/// @brief Area of a facet, mapped from its reference cell [m^2]; of an edge,
/// its length [m].
template <class F>
double area_ratio(const std::array<Vec3, F::vertices>& x,
                  const Vec2& xi) noexcept
{
  const auto [first, second] = tangents<F>(x, xi);
  if constexpr (std::is_same_v<typename F::Linear, Line2>)
    return norm(first);
  else
    return norm(cross(first, second));
}

/// @brief Reference coordinates of a point in the plane of a facet with nodes
/// c. If none exist, the result is arbitrary, but depends on the point alone.
template <class F>
Vec2 pulled_back(const Vec2& y, const std::array<Vec2, F::vertices>& c) noexcept
{
  constexpr int max_iterations = 20;
  constexpr double accurate = 1e-14, longest = 2, degenerate = 1e-12;
  const auto at = [&](const auto& weights)
  {
    Vec2 sum = {};
    for (std::size_t i = 0; i < F::vertices; ++i)
      for (std::size_t d = 0; d < 2; ++d)
        sum[d] += weights[i] * c[i][d];
    return sum;
  };
  const auto jacobian = [&](const Vec2& xi) -> Matrix<2, 2>
  {
    const Matrix<2, F::vertices> d = F::dphi(xi);
    const Vec2 a = at(d[0]);
    Vec2 b = {-a[1], a[0]}; // across an edge
    if constexpr (!std::is_same_v<typename F::Linear, Line2>)
      b = at(d[1]);
    return {{{a[0], b[0]}, {a[1], b[1]}}};
  };
  Vec2 xi = F::centre;
  const Matrix<2, 2> first = jacobian(xi);
  for (int iteration = 0; iteration < max_iterations; ++iteration)
  {
    const Vec2 there = at(F::phi(xi));
    Matrix<2, 2> J = jacobian(xi);
    if (!(std::abs(det(J)) > degenerate * std::abs(det(first))))
      J = first;
    Vec2 step = inverse(J) * Vec2{y[0] - there[0], y[1] - there[1]};
    const double length = std::max(std::abs(step[0]), std::abs(step[1]));
    // The first step inverts the affine part of the map.
    if (iteration > 0 && length > longest)
      step = {longest / length * step[0], longest / length * step[1]};
    xi = {xi[0] + step[0], xi[1] + step[1]};
    if (length < accurate)
      break;
  }
  return xi;
}
} // namespace nts
