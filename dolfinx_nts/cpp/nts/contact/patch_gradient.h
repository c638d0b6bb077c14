#pragma once

#include "nts/contact/discrete_gradient.h"
#include "nts/contact/straining.h"
#include "nts/geometry/patch_projection.h"

/// @brief The energy-momentum scheme for smooth segments.
///
/// As on edges and triangles (`simplex_gradient.h`) the force acts along the
/// mean normal d = (n_n + n_{n+1})/2, and on the segment where the line along d
/// through the mean node meets the mean segment, at beta, so that resultant and
/// moment vanish. With h_i(xi) = n_i . (x_bar_i(xi_i) - x_bar_i(xi)), the depth
/// of the surface at xi below its tangent plane at the projection xi_i of state
/// i, its work is
///
///     sum_A w_A d . dx_A = g_{n+1} - g_n + e,  e = h_{n+1}(beta) - h_n(beta)
///
/// On flat segments e = 0. Otherwise e is removed along the straining part v of
/// the motion (`straining.h`), F_A = w_A d - e v_A / |v|^2, which changes
/// neither momentum. For v = 0, xi_n, xi_{n+1} and beta are equal, so that e is
/// of second order in v there, and F is continuous.
namespace nts
{
/// @brief Intersection of the line through a node along d with a patch.
struct Foot
{
  Vec2 xi = {};               ///< coordinates
  double height = 0;          ///< x_s - x_bar(xi) = height d
  std::array<Vec3, 2> c = {}; ///< c_a . x_bar,b = delta_ab, c_a . d = 0
  bool converged = false;     ///< false: all other members are invalid
};

/// @brief Find the foot of a node by Newton's method.
/// @param[in] pair Node and control points.
/// @param[in] d Direction of the line.
/// @param[in] start First guess of the coordinates.
template <IsPatch S>
Foot foot(const Pair<S>& pair, const Vec3& d, const Vec2& start) noexcept
{
  constexpr int max_iterations = 30;
  constexpr double singular = 1e-12; // least det(a_1, a_2, d)/|a|^2
  constexpr double round_off = 1e-15;
  constexpr double converging = 1e-8; // a step whose square is round-off
  Foot f;
  f.xi = start;
  for (int iteration = 0; iteration < max_iterations; ++iteration)
  {
    const std::array<Vec3, 2> a = S::tangents(pair.segment, f.xi);
    const double volume = dot(d, cross(a[0], a[1]));
    if (!(std::abs(volume) > singular * (dot(a[0], a[0]) + dot(a[1], a[1]))))
      return {};
    f.c = {(1 / volume) * cross(a[1], d), (1 / volume) * cross(d, a[0])};
    const Vec3 r = pair.node - combine(S::phi(f.xi), pair.segment);
    f.height = dot(r, d) / dot(d, d);
    const Vec2 step = {dot(f.c[0], r), dot(f.c[1], r)};
    const double change = std::max(std::abs(step[0]), std::abs(step[1]));
    if (f.converged || change <= round_off)
    {
      f.converged = true;
      return f;
    }
    f.xi = {f.xi[0] + step[0], f.xi[1] + step[1]};
    f.converged = change <= converging;
  }
  return {};
}

/// @brief Depth of a patch at xi below its tangent plane at a projection [m].
///
/// It is the integral of the curvature along the path, which is accurate to
/// round-off for any length of the path: three Gauss points are exact up to
/// degree 5.
template <IsPatch S>
double below_tangent_plane(const std::array<Vec3, S::vertices>& x,
                           const Projection<S>& p, const Vec2& xi) noexcept
{
  const double offset = std::sqrt(0.15);
  const std::array<double, 3> place = {0.5 - offset, 0.5, 0.5 + offset};
  constexpr std::array<double, 3> weight = {5. / 18, 8. / 18, 5. / 18};
  const Vec2 path = {xi[0] - p.xi[0], xi[1] - p.xi[1]};
  double height = 0;
  for (std::size_t g = 0; g < 3; ++g)
  {
    const Vec2 at
        = {p.xi[0] + place[g] * path[0], p.xi[1] + place[g] * path[1]};
    const Vec2 bend = along_second<S>(x, at, p.normal) * path;
    height
        -= weight[g] * (1 - place[g]) * (bend[0] * path[0] + bend[1] * path[1]);
  }
  return height;
}

/// @brief Node and control points in one list.
template <IsPatch S>
std::array<Vec3, 1 + S::vertices> points_of(const Pair<S>& pair) noexcept
{
  std::array<Vec3, 1 + S::vertices> points;
  points[0] = pair.node;
  std::copy(pair.segment.begin(), pair.segment.end(), points.begin() + 1);
  return points;
}

/// @brief Energy-momentum scheme for patches, see `discrete_gradient.h`.
template <IsPatch S>
void contact_conserving(const Pair<S>& pair_n, const Pair<S>& pair,
                        double orientation, Contact<S>& contact) noexcept
{
  constexpr std::size_t points = 1 + S::vertices, dofs = pair_size<S>;
  constexpr double at_rest = 1e-26; // relative |v|^2 that is round-off
  const Projection<S> p_n = project(pair_n, orientation);
  const Projection<S> p = project(pair, orientation);
  Sensitivity<S> s;
  contact.valid = p_n.converged && p.converged && sensitivity(p, s);
  if (!contact.valid)
    return;
  const Pair<S> mean = midpoint(pair_n, pair);
  const Vec3 d = 0.5 * (p_n.normal + p.normal);
  const Foot f = foot(
      mean, d, {0.5 * (p_n.xi[0] + p.xi[0]), 0.5 * (p_n.xi[1] + p.xi[1])});
  contact.valid = f.converged;
  if (!contact.valid)
    return;
  set_ends(p_n, p, contact);

  const std::array<double, S::vertices> phi = S::phi(f.xi);
  const Matrix<2, S::vertices> dphi = S::dphi(f.xi);
  std::array<double, points> w = {1};
  for (std::size_t K = 0; K < S::vertices; ++K)
    w[K + 1] = -phi[K];
  const Straining<points, S::is_plane> motion(points_of(pair_n),
                                              points_of(pair));
  const double excess = below_tangent_plane(pair.segment, p, f.xi)
                        - below_tangent_plane(pair_n.segment, p_n, f.xi);
  const bool strains = motion.square > at_rest * motion.extent;
  const double part = strains ? excess / motion.square : 0;
  for (std::size_t A = 0; A < points; ++A)
    for (std::size_t i = 0; i < 3; ++i)
      contact.force[3 * A + i] = w[A] * d[i] - part * motion.v[A][i];

  // Tangent: derivatives of d and beta w.r.t. q at t_{n+1}.
  Matrix<3, dofs> turn;
  Matrix<2, dofs> dbeta;
  for (std::size_t j = 0; j < dofs; ++j)
  {
    const Vec2 t = s.metric_inverse * Vec2{s.dn[0][j], s.dn[1][j]};
    const Vec3 dd = -0.5 * (t[0] * p.tangents[0] + t[1] * p.tangents[1]);
    for (std::size_t i = 0; i < 3; ++i)
      turn[i][j] = dd[i];
    for (std::size_t a = 0; a < 2; ++a)
      dbeta[a][j] = 0.5 * w[j / 3] * f.c[a][j % 3] - f.height * dot(f.c[a], dd);
  }
  // Derivatives of the excess work e w.r.t. normal and nodes, and w.r.t. beta.
  PairVector<S> slope = {};
  const std::array<double, S::vertices> here = S::phi(p.xi);
  const Vec3 between = combine(here, pair.segment) - combine(phi, pair.segment);
  const std::array<Vec3, 2> a_n = S::tangents(pair_n.segment, f.xi),
                            a = S::tangents(pair.segment, f.xi);
  const Vec2 fall = {dot(p_n.normal, a_n[0]) - dot(p.normal, a[0]),
                     dot(p_n.normal, a_n[1]) - dot(p.normal, a[1])};
  for (std::size_t j = 0; j < dofs; ++j)
  {
    slope[j] = 2
                   * (turn[0][j] * between[0] + turn[1][j] * between[1]
                      + turn[2][j] * between[2])
               + fall[0] * dbeta[0][j] + fall[1] * dbeta[1][j];
    if (j >= 3)
      slope[j] += (here[j / 3 - 1] - phi[j / 3 - 1]) * p.normal[j % 3];
  }
  for (std::size_t j = 0; j < dofs; ++j)
  {
    const std::size_t J = j / 3, b = j % 3;
    double change = 0; // derivative of `part`
    Vec3 spin = {};
    if (strains)
    {
      change = slope[j] / motion.square
               - 2 * part * motion.half_slope(J)[b] / motion.square;
      const Matrix<3, 3> by = motion.turn(J);
      spin = {by[0][b], by[1][b], by[2][b]};
    }
    for (std::size_t A = 0; A < points; ++A)
    {
      const double dw = A == 0 ? 0
                               : -dphi[0][A - 1] * dbeta[0][j]
                                     - dphi[1][A - 1] * dbeta[1][j];
      const Vec3 dv = strains ? motion.slope(A, J, b, spin) : Vec3{};
      for (std::size_t i = 0; i < 3; ++i)
        contact.tangent[3 * A + i][j] = w[A] * turn[i][j] + d[i] * dw
                                        - change * motion.v[A][i]
                                        - part * dv[i];
    }
  }
}
} // namespace nts
