#pragma once

#include "small.h"

#include <algorithm>

/// @brief Shape functions of the segments, in the vertex order and on the
/// reference cells of Basix.
///
/// A segment type offers `phi` (values), `dphi[alpha][i]` (first
/// derivatives), `d2phi[i]` (the mixed second derivative: the only one that
/// does not vanish), and the reference cell as `outside`, `clamp`, `centre`.
namespace nts
{
/// @brief Linear triangle on (0,0), (1,0), (0,1).
struct Tri3
{
  static constexpr std::size_t vertices = 3;
  static constexpr Vec2 centre = {1. / 3, 1. / 3};

  static constexpr std::array<double, 3> phi(const Vec2& xi) noexcept
  {
    return {1 - xi[0] - xi[1], xi[0], xi[1]};
  }

  static constexpr Matrix<2, 3> dphi(const Vec2&) noexcept
  {
    return {{{-1, 1, 0}, {-1, 0, 1}}};
  }

  static constexpr std::array<double, 3> d2phi() noexcept { return {0, 0, 0}; }

  /// @brief How far xi lies outside the reference cell (<= 0 inside).
  static constexpr double outside(const Vec2& xi) noexcept
  {
    return std::max({-xi[0], -xi[1], xi[0] + xi[1] - 1});
  }

  /// @brief A point of the reference cell near xi (xi itself if inside).
  static constexpr Vec2 clamp(Vec2 xi) noexcept
  {
    const double excess = (xi[0] + xi[1] - 1) / 2;
    if (excess > 0)
      xi = {xi[0] - excess, xi[1] - excess};
    if (xi[0] < 0)
      return {0, std::clamp(xi[1], 0., 1.)};
    if (xi[1] < 0)
      return {std::clamp(xi[0], 0., 1.), 0};
    return xi;
  }
};

/// @brief Bilinear quadrilateral on [0,1]^2, vertices (0,0), (1,0), (0,1),
/// (1,1).
struct Quad4
{
  static constexpr std::size_t vertices = 4;
  static constexpr Vec2 centre = {0.5, 0.5};

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

  /// @brief How far xi lies outside the reference cell (<= 0 inside).
  static constexpr double outside(const Vec2& xi) noexcept
  {
    return std::max({-xi[0], -xi[1], xi[0] - 1, xi[1] - 1});
  }

  /// @brief The point of the reference cell nearest to xi.
  static constexpr Vec2 clamp(const Vec2& xi) noexcept
  {
    return {std::clamp(xi[0], 0., 1.), std::clamp(xi[1], 0., 1.)};
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

/// @brief Stands for the segment of a pair with a rigid obstacle.
struct NoSegment
{
  static constexpr std::size_t vertices = 0;
};
} // namespace nts
