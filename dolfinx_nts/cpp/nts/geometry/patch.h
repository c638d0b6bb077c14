#pragma once

#include "nts/geometry/segment.h"

/// @brief Smooth segments: cubic patches, by their control points.
///
/// A patch is a segment type like those of `segment.h` whose "vertices" are the
/// Bezier control points. These are linear in nodes of the surface with weights
/// of sum one, so that kernels conserve the same quantities for nodes as for
/// control points. A patch has `phi`, `dphi` and all second derivatives,
/// `d2phi` with the rows 11, 12 and 22; `tangents` at a point; and `is_plane`,
/// which is true if the third component of all positions is zero.
namespace nts
{
/// @brief Concept of the segment types in this file.
template <class S>
concept IsPatch = requires { requires S::is_patch; };

/// @brief Bernstein's polynomials of degree 3 on [0, 1] and their derivatives.
struct Bernstein
{
  std::array<double, 4> value, first, second;

  explicit constexpr Bernstein(double t) noexcept
      : value{(1 - t) * (1 - t) * (1 - t), 3 * t * (1 - t) * (1 - t),
              3 * t * t * (1 - t), t * t * t},
        first{-3 * (1 - t) * (1 - t), 3 * (1 - t) * (1 - 3 * t),
              3 * t * (2 - 3 * t), 3 * t * t},
        second{6 * (1 - t), 18 * t - 12, 6 - 18 * t, 6 * t}
  {
  }
};

/// @brief Cubic curve on [0, 1] in the plane z = 0: the surface that it sweeps
/// along z, see `Line2`.
struct CubicEdge
{
  static constexpr std::size_t vertices = 4;
  static constexpr bool is_patch = true, is_plane = true;
  static constexpr Vec2 centre = {0.5, 0};

  static constexpr std::array<double, 4> phi(const Vec2& xi) noexcept
  {
    return Bernstein(xi[0]).value;
  }

  static constexpr Matrix<2, 4> dphi(const Vec2& xi) noexcept
  {
    return {Bernstein(xi[0]).first, {}};
  }

  static constexpr Matrix<3, 4> d2phi(const Vec2& xi) noexcept
  {
    return {Bernstein(xi[0]).second, {}, {}};
  }

  static std::array<Vec3, 2> tangents(const std::array<Vec3, 4>& x,
                                      const Vec2& xi) noexcept
  {
    return {combine(Bernstein(xi[0]).first, x), out_of_plane(x[3] - x[0])};
  }
};

/// @brief Both tangents of a patch in space.
template <class S>
std::array<Vec3, 2> tangents_in_space(const std::array<Vec3, S::vertices>& x,
                                      const Vec2& xi) noexcept
{
  const Matrix<2, S::vertices> dphi = S::dphi(xi);
  return {combine(dphi[0], x), combine(dphi[1], x)};
}

/// @brief Bicubic patch on [0, 1]^2; control point (i, j) has the number
/// i + 4 j.
struct BicubicQuad
{
  static constexpr std::size_t vertices = 16;
  static constexpr bool is_patch = true, is_plane = false;
  static constexpr Vec2 centre = {0.5, 0.5};

  static constexpr std::array<double, 16> phi(const Vec2& xi) noexcept
  {
    return product(Bernstein(xi[0]).value, Bernstein(xi[1]).value);
  }

  static constexpr Matrix<2, 16> dphi(const Vec2& xi) noexcept
  {
    const Bernstein a(xi[0]), b(xi[1]);
    return {product(a.first, b.value), product(a.value, b.first)};
  }

  static constexpr Matrix<3, 16> d2phi(const Vec2& xi) noexcept
  {
    const Bernstein a(xi[0]), b(xi[1]);
    return {product(a.second, b.value), product(a.first, b.first),
            product(a.value, b.second)};
  }

  static std::array<Vec3, 2> tangents(const std::array<Vec3, 16>& x,
                                      const Vec2& xi) noexcept
  {
    return tangents_in_space<BicubicQuad>(x, xi);
  }

private:
  static constexpr std::array<double, 16>
  product(const std::array<double, 4>& a,
          const std::array<double, 4>& b) noexcept
  {
    std::array<double, 16> values = {};
    for (std::size_t j = 0; j < 4; ++j)
      for (std::size_t i = 0; i < 4; ++i)
        values[i + 4 * j] = a[i] * b[j];
    return values;
  }
};

/// @brief Cubic patch on the triangle (0,0), (1,0), (0,1); control points (i,
/// j) with i + j <= 3 are numbered with i first: (0,0), (1,0), .. (3,0), (0,1).
struct CubicTriangle
{
  static constexpr std::size_t vertices = 10;
  static constexpr bool is_patch = true, is_plane = false;
  static constexpr Vec2 centre = {1. / 3, 1. / 3};

  static constexpr std::array<double, 10> phi(const Vec2& xi) noexcept
  {
    return values<3>(xi);
  }

  /// Derivatives: three times the differences of Bernstein's polynomials of
  /// degree 2.
  static constexpr Matrix<2, 10> dphi(const Vec2& xi) noexcept
  {
    const auto lower = values<2>(xi);
    Matrix<2, 10> d = {};
    for (std::size_t j = 0, n = 0; j <= 2; ++j)
      for (std::size_t i = 0; i <= 2 - j; ++i, ++n)
        for (std::size_t a = 0; a < 2; ++a)
        {
          d[a][next(i, j, a)] += 3 * lower[n];
          d[a][number(i, j)] -= 3 * lower[n];
        }
    return d;
  }

  static constexpr Matrix<3, 10> d2phi(const Vec2& xi) noexcept
  {
    const auto linear = values<1>(xi);
    Matrix<3, 10> d = {};
    for (std::size_t j = 0, n = 0; j <= 1; ++j)
      for (std::size_t i = 0; i <= 1 - j; ++i, ++n)
        for (std::size_t c = 0; c < 3; ++c)
        {
          const std::size_t a = c / 2, b = (c + 1) / 2;
          const std::size_t ia = i + (a == 0), ja = j + (a == 1);
          d[c][next(ia, ja, b)] += 6 * linear[n];
          d[c][number(ia, ja)] -= 6 * linear[n];
          d[c][next(i, j, b)] -= 6 * linear[n];
          d[c][number(i, j)] += 6 * linear[n];
        }
    return d;
  }

  static std::array<Vec3, 2> tangents(const std::array<Vec3, 10>& x,
                                      const Vec2& xi) noexcept
  {
    return tangents_in_space<CubicTriangle>(x, xi);
  }

private:
  static constexpr std::size_t number(std::size_t i, std::size_t j) noexcept
  {
    return i + j * (9 - j) / 2;
  }

  /// @brief Number of the control point after (i, j) in direction a.
  static constexpr std::size_t next(std::size_t i, std::size_t j,
                                    std::size_t a) noexcept
  {
    return number(i + (a == 0), j + (a == 1));
  }

  /// @brief Bernstein's polynomials of degree D, numbered as the control points
  /// of that degree.
  template <std::size_t D>
  static constexpr std::array<double, (D + 1) * (D + 2) / 2>
  values(const Vec2& xi) noexcept
  {
    constexpr std::array<double, 4> factorial = {1, 1, 2, 6};
    const auto power = [](double x, std::size_t n) noexcept
    {
      double p = 1;
      for (; n > 0; --n)
        p *= x;
      return p;
    };
    const double rest = 1 - xi[0] - xi[1];
    std::array<double, (D + 1) * (D + 2) / 2> b = {};
    for (std::size_t j = 0, n = 0; j <= D; ++j)
      for (std::size_t i = 0; i <= D - j; ++i, ++n)
        b[n] = factorial[D]
               / (factorial[i] * factorial[j] * factorial[D - i - j])
               * power(xi[0], i) * power(xi[1], j) * power(rest, D - i - j);
    return b;
  }
};
} // namespace nts
