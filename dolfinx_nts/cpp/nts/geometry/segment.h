#pragma once

#include "nts/geometry/small.h"

#include <algorithm>

/// @brief Shape functions of the segments, in the vertex order and on the
/// reference cells of Basix.
///
/// A segment type offers `phi` (values), `dphi[alpha][i]` (first
/// derivatives), `d2phi[i]` (the mixed second derivative: the only one that
/// does not vanish), `directions` (its tangents at the first vertex, where this
/// derivative has no effect), and the reference cell as `outside`, `edges`,
/// `centre`.
namespace nts
{
/// @brief Vertices at both ends of each of N edges, which are straight.
template <std::size_t N>
using Edges = std::array<std::array<std::size_t, 2>, N>;

/// @brief Linear edge on [0, 1] in the plane z = 0: the surface that it sweeps
/// along z, so that its second tangent is along z and as long as the edge.
struct Line2
{
  using Linear = Line2;
  static constexpr std::size_t vertices = 2;
  static constexpr bool is_simplex = true;
  static constexpr Vec2 centre = {0.5, 0};
  static constexpr Edges<2> edges = {{{0, 0}, {1, 1}}}; ///< its two ends

  static constexpr std::array<double, 2> phi(const Vec2& xi) noexcept
  {
    return {1 - xi[0], xi[0]};
  }

  static constexpr Matrix<2, 2> dphi(const Vec2&) noexcept
  {
    return {{{-1, 1}, {0, 0}}};
  }

  static constexpr std::array<double, 2> d2phi() noexcept { return {0, 0}; }

  static std::array<Vec3, 2> directions(const std::array<Vec3, 2>& x) noexcept
  {
    const Vec3 edge = x[1] - x[0];
    return {edge, out_of_plane(edge)};
  }

  /// @brief How far xi lies outside the reference cell (<= 0 inside).
  static constexpr double outside(const Vec2& xi) noexcept
  {
    return std::max(-xi[0], xi[0] - 1);
  }
};

/// @brief Linear triangle on (0,0), (1,0), (0,1).
struct Tri3
{
  using Linear = Tri3;
  static constexpr std::size_t vertices = 3;
  static constexpr bool is_simplex = true;
  static constexpr Vec2 centre = {1. / 3, 1. / 3};
  static constexpr Edges<3> edges = {{{0, 1}, {1, 2}, {0, 2}}};

  static constexpr std::array<double, 3> phi(const Vec2& xi) noexcept
  {
    return {1 - xi[0] - xi[1], xi[0], xi[1]};
  }

  static constexpr Matrix<2, 3> dphi(const Vec2&) noexcept
  {
    return {{{-1, 1, 0}, {-1, 0, 1}}};
  }

  static constexpr std::array<double, 3> d2phi() noexcept { return {0, 0, 0}; }

  static constexpr std::array<Vec3, 2>
  directions(const std::array<Vec3, 3>& x) noexcept
  {
    return {x[1] - x[0], x[2] - x[0]};
  }

  /// @brief How far xi lies outside the reference cell (<= 0 inside).
  static constexpr double outside(const Vec2& xi) noexcept
  {
    return std::max({-xi[0], -xi[1], xi[0] + xi[1] - 1});
  }
};

/// @brief Bilinear quadrilateral on [0,1]^2, vertices (0,0), (1,0), (0,1),
/// (1,1).
struct Quad4
{
  using Linear = Quad4;
  static constexpr std::size_t vertices = 4;
  static constexpr bool is_simplex = false;
  static constexpr Vec2 centre = {0.5, 0.5};
  static constexpr Edges<4> edges = {{{0, 1}, {1, 3}, {2, 3}, {0, 2}}};

  static constexpr std::array<double, 4> phi(const Vec2& xi) noexcept
  {
    const double a = xi[0], b = xi[1];
    return {(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b};
  }

  static constexpr Matrix<2, 4> dphi(const Vec2& xi) noexcept
  {
    const double a = xi[0], b = xi[1];
    return {{{b - 1, 1 - b, -b, b}, {a - 1, -a, 1 - a, a}}};
  }

  static constexpr std::array<double, 4> d2phi() noexcept
  {
    return {1, -1, -1, 1};
  }

  static constexpr std::array<Vec3, 2>
  directions(const std::array<Vec3, 4>& x) noexcept
  {
    return {x[1] - x[0], x[2] - x[0]};
  }

  /// @brief How far xi lies outside the reference cell (<= 0 inside).
  static constexpr double outside(const Vec2& xi) noexcept
  {
    return std::max({-xi[0], -xi[1], xi[0] - 1, xi[1] - 1});
  }
};

/// @brief Weighted sum of the vertices of a segment.
template <std::size_t K>
constexpr Vec3 combine(const std::array<double, K>& weights,
                       const std::array<Vec3, K>& vertices) noexcept
{
  Vec3 sum = {};
  for (std::size_t i = 0; i < K; ++i)
    sum += weights[i] * vertices[i];
  return sum;
}

/// @brief Placeholder for the segment of a pair with a rigid obstacle.
struct NoSegment
{
  static constexpr std::size_t vertices = 0;
};
} // namespace nts
