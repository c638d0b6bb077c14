#pragma once

#include "nts/geometry/gap.h"
#include "nts/geometry/patch.h"

/// @brief Closest-point projection of a node onto a smooth segment;
/// see `projection.h` and `gap.h` for flat segments.
namespace nts
{
/// @brief Geometry of the patch at the projection point, see the template for
/// all segments.
template <IsPatch S>
struct Projection<S>
{
  Vec2 xi = S::centre;               ///< convective coordinates
  double gap = 0;                    ///< (x_s - x_bar) . normal, > 0 open
  Vec3 normal = {};                  ///< unit normal, outward
  std::array<Vec3, 2> tangents = {}; ///< a_alpha = x_bar,alpha
  Matrix<2, 2> metric = {};          ///< a_alpha . a_beta
  Matrix<2, 2> curvature = {};       ///< n . x_bar,alpha beta
  bool converged = false;            ///< false: all other members are invalid
};

/// @brief Inner products of a vector with the second derivatives of a patch.
template <IsPatch S>
Matrix<2, 2> along_second(const std::array<Vec3, S::vertices>& x,
                          const Vec2& xi, const Vec3& vector) noexcept
{
  const Matrix<3, S::vertices> d2phi = S::d2phi(xi);
  std::array<double, 3> along;
  for (std::size_t c = 0; c < 3; ++c)
    along[c] = dot(vector, combine(d2phi[c], x));
  return {{{along[0], along[1]}, {along[1], along[2]}}};
}

/// @brief Solve (x_s - x_bar(xi)) . a_alpha(xi) = 0 by Newton's method from
/// the patch's centre; steps are no longer than half a patch.
///
/// Beyond its edges the patch is extrapolated as a polynomial.
/// @param[in] pair Node and control points.
/// @param[in] orientation +1 where a_1 x a_2 points outward, otherwise -1.
template <IsPatch S>
Projection<S> project(const Pair<S>& pair, double orientation) noexcept
{
  constexpr int max_iterations = 50;
  constexpr double degenerate
      = 1e-20; // least |n|^2 of a patch relative to (tr m)^2
  constexpr double convex
      = 0.1; // least det A of Newton's matrix relative to det m
  constexpr double round_off = 1e-12; // step of xi; the next step is its square
  constexpr double longest = 0.5;
  const auto& x = pair.segment;
  Projection<S> p;
  for (int iteration = 0; iteration < max_iterations; ++iteration)
  {
    const Vec3 r = pair.node - combine(S::phi(p.xi), x);
    p.tangents = S::tangents(x, p.xi);
    for (std::size_t a = 0; a < 2; ++a)
      for (std::size_t b = 0; b < 2; ++b)
        p.metric[a][b] = dot(p.tangents[a], p.tangents[b]);
    const double trace = p.metric[0][0] + p.metric[1][1];
    const double area = det(p.metric);
    // det m = |n|^2 up to round-off, also on a degenerate patch.
    const Vec3 n = cross(p.tangents[0], p.tangents[1]);
    if (!(std::min(area, dot(n, n)) > degenerate * trace * trace))
      return {};
    // The last pass only evaluates the geometry at the converged xi.
    if (p.converged)
    {
      p.normal = (orientation / norm(n)) * n;
      p.gap = dot(r, p.normal);
      p.curvature = along_second<S>(x, p.xi, p.normal);
      return p;
    }
    Matrix<2, 2> A = along_second<S>(x, p.xi, r);
    for (std::size_t a = 0; a < 2; ++a)
      for (std::size_t b = 0; b < 2; ++b)
        A[a][b] = p.metric[a][b] - A[a][b];
    if (!(det(A) > convex * area && A[0][0] > 0))
      A = p.metric;
    Vec2 dxi = inverse(A) * Vec2{dot(r, p.tangents[0]), dot(r, p.tangents[1])};
    const double change = std::max(std::abs(dxi[0]), std::abs(dxi[1]));
    const double part = change > longest ? longest / change : 1;
    p.xi = {p.xi[0] + part * dxi[0], p.xi[1] + part * dxi[1]};
    // Round-off in xi grows with the distance of the node.
    const double excess = change - round_off;
    p.converged
        = excess <= 0
          || excess * excess * trace <= round_off * round_off * dot(r, r);
  }
  return {};
}

/// @brief Compute the derivatives of xi and n with respect to q, see the
/// template for all segments.
template <IsPatch S>
bool sensitivity(const Projection<S>& p, Sensitivity<S>& s) noexcept
{
  constexpr double singular
      = 1e-12; // det A relative to det m that is round-off
  Matrix<2, 2> A = p.metric;
  for (std::size_t a = 0; a < 2; ++a)
    for (std::size_t b = 0; b < 2; ++b)
      A[a][b] -= p.gap * p.curvature[a][b];
  if (!(std::abs(det(A)) > singular * det(p.metric)))
    return false;
  const Matrix<2, 2> A_inverse = inverse(A);
  s.metric_inverse = inverse(p.metric);
  const std::array<double, S::vertices> phi = S::phi(p.xi);
  const Matrix<2, S::vertices> dphi = S::dphi(p.xi);
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t B = 0; B <= S::vertices; ++B)
    {
      const std::size_t j = 3 * B + i;
      for (std::size_t a = 0; a < 2; ++a)
      {
        s.T[a][j] = (B == 0 ? 1 : -phi[B - 1]) * p.tangents[a][i];
        s.N[a][j] = B == 0 ? 0 : -dphi[a][B - 1] * p.normal[i];
      }
      const Vec2 xi = A_inverse
                      * Vec2{s.T[0][j] - p.gap * s.N[0][j],
                             s.T[1][j] - p.gap * s.N[1][j]};
      const Vec2 turn = p.curvature * xi;
      for (std::size_t a = 0; a < 2; ++a)
      {
        s.xi[a][j] = xi[a];
        s.dn[a][j] = turn[a] - s.N[a][j];
      }
    }
  return true;
}
} // namespace nts
