#pragma once

#include "nts/geometry/small.h"

/// @brief Straining part of a motion of points: displacements without their
/// best-fitting rigid motion.
///
/// With displacements dx_i from q_n to q_{n+1} and positions y_i in the mean
/// state relative to the mean point,
///
///     v_i = dx_i - dx_bar - omega x y_i,  I omega = sum y_i x dx_i,
///     I = sum |y_i|^2 1 - y_i y_i^T
///
/// Therefore v has no resultant and no moment about the mean state, sum v_i .
/// dx_i = sum |v_i|^2, and v = 0 if a rotation and a translation map q_n to
/// q_{n+1}. It is used by `patch_gradient.h`.
namespace nts
{
/// @brief The straining part v of the motion of P points and its derivative.
/// @tparam plane Whether all positions are in the plane z = 0.
template <std::size_t P, bool plane>
class Straining
{
public:
  /// @param[in] x_n, x Positions at both ends [m].
  Straining(const std::array<Vec3, P>& x_n,
            const std::array<Vec3, P>& x) noexcept
  {
    Vec3 mean_n = {}, mean = {};
    for (std::size_t i = 0; i < P; ++i)
    {
      mean_n += (1. / P) * x_n[i];
      mean += (1. / P) * x[i];
    }
    Matrix<3, 3> I = {};
    Vec3 L = {};
    for (std::size_t i = 0; i < P; ++i)
    {
      _y_n[i] = x_n[i] - mean_n;
      const Vec3 end = x[i] - mean;
      _y[i] = 0.5 * (_y_n[i] + end);
      v[i] = end - _y_n[i];
      L += cross(_y[i], v[i]);
      const double square = dot(_y[i], _y[i]);
      extent += square;
      for (std::size_t a = 0; a < 3; ++a)
        for (std::size_t b = 0; b < 3; ++b)
          I[a][b] += (a == b ? square : 0) - _y[i][a] * _y[i][b];
    }
    if constexpr (plane)
      _inverse[2][2] = 1 / I[2][2];
    else
    {
      const Vec3 &a = I[0], &b = I[1], &c = I[2];
      const double volume = dot(a, cross(b, c));
      _inverse = {(1 / volume) * cross(b, c), (1 / volume) * cross(c, a),
                  (1 / volume) * cross(a, b)};
    }
    for (std::size_t a = 0; a < 3; ++a)
      _omega[a] = dot(_inverse[a], L);
    for (std::size_t i = 0; i < P; ++i)
    {
      v[i] = v[i] - cross(_omega, _y[i]);
      square += dot(v[i], v[i]);
    }
  }

  std::array<Vec3, P> v = {}; ///< the straining part [m]
  double square = 0;          ///< sum |v_i|^2 [m^2]
  double extent = 0;          ///< sum |y_i|^2 [m^2]

  /// @brief Half of the derivative of `square` w.r.t. x_i.
  Vec3 half_slope(std::size_t i) const noexcept
  {
    return v[i] - 0.5 * cross(v[i], _omega);
  }

  /// @brief Derivative of omega w.r.t. x_j.
  Matrix<3, 3> turn(std::size_t j) const noexcept
  {
    const Vec3 &y = _y[j], &y_n = _y_n[j], &w = _omega;
    Matrix<3, 3> right
        = {{{0, -y_n[2], y_n[1]}, {y_n[2], 0, -y_n[0]}, {-y_n[1], y_n[0], 0}}};
    for (std::size_t a = 0; a < 3; ++a)
    {
      right[a][a] += 0.5 * dot(y, w);
      for (std::size_t b = 0; b < 3; ++b)
        right[a][b] += 0.5 * y[a] * w[b] - w[a] * y[b];
    }
    Matrix<3, 3> D = {};
    for (std::size_t a = 0; a < 3; ++a)
      for (std::size_t b = 0; b < 3; ++b)
        for (std::size_t c = 0; c < 3; ++c)
          D[a][b] += _inverse[a][c] * right[c][b];
    return D;
  }

  /// @brief Derivative of v_i w.r.t. component b of x_j.
  /// @param[in] turn Derivative of omega w.r.t. this component.
  Vec3 slope(std::size_t i, std::size_t j, std::size_t b,
             const Vec3& turn) const noexcept
  {
    Vec3 moved = {};
    moved[b] = (i == j ? 1 : 0) - 1. / P;
    return moved - 0.5 * cross(_omega, moved) - cross(turn, _y[i]);
  }

private:
  std::array<Vec3, P> _y = {}, _y_n = {};
  Vec3 _omega = {};
  Matrix<3, 3> _inverse = {}; ///< of I; in the plane about z only
};
} // namespace nts
