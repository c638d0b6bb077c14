#pragma once

#include "nts/geometry/gap.h"

/// @brief Objective slip of a node on its segment within one step.
///
/// With xi_n the projection of x_n on the segment, frozen in the step, and
/// the coefficients c_i^a of an orthonormal frame e_i = c_i^a a_a(t_n) (e_1
/// along a_1),
///
///     gamma_i(q) = (x_s - x_bar(xi_n)) . c_i^a a_a(xi_n)
///                = (sum_A w_A q_A) . (sum_B b_iB q_B)
///
/// is quadratic in q, unchanged by rigid motion, and zero at q_n. So
/// grad gamma_i(q_m) . (q_{n+1} - q_n) is exactly the slip gamma_i(q_{n+1}),
/// and a traction t_i conserves momenta as the force t_i grad gamma_i(q_m).
namespace nts
{
/// @brief Slip of one pair.
template <class S>
struct Slip
{
  static constexpr std::size_t nodes = 1 + S::vertices;

  Vec2 value = {};                                 ///< gamma_i(q_{n+1}) [m]
  std::array<PairVector<S>, 2> force = {};         ///< grad gamma_i(q_m)
  std::array<PairVector<S>, 2> gradient = {};      ///< grad gamma_i(q_{n+1})
  std::array<double, nodes> w = {};                ///< weights of x_s - x_bar
  std::array<std::array<double, nodes>, 2> b = {}; ///< weights of e_i
  Matrix<2, 3> frame_n = {};                       ///< e_i at t_n
  Matrix<2, 3> frame = {}; ///< convected to the projection of q_{n+1}
};

/// @brief Orthonormal frame of a projection: e_1 along a_1, e_2 in the
/// tangent plane; coefficients c[i][a] with e_i = c[i][a] a_a.
template <class S>
Matrix<2, 3> tangent_frame(const Projection<S>& p, Matrix<2, 2>& c) noexcept
{
  const double length = std::sqrt(p.metric[0][0]);
  const double area = std::sqrt(det(p.metric));
  c = {{{1 / length, 0}, {-p.metric[0][1] / (length * area), length / area}}};
  Matrix<2, 3> e;
  for (std::size_t i = 0; i < 2; ++i)
    e[i] = c[i][0] * p.tangents[0] + c[i][1] * p.tangents[1];
  return e;
}

/// @brief Orthonormal frame that is nearest to c[i][a] a_a, an orthonormal
/// frame that moved with the segment: m^(-1/2) times its vectors, of scalar
/// products m.
///
/// It is covariant under any change of the coordinates of the segment, so that
/// the order of the vertices has no effect.
template <class S>
Matrix<2, 3> convected_frame(const Projection<S>& p,
                             const Matrix<2, 2>& c) noexcept
{
  Matrix<2, 3> moved, e;
  for (std::size_t i = 0; i < 2; ++i)
    moved[i] = c[i][0] * p.tangents[0] + c[i][1] * p.tangents[1];
  const double m00 = dot(moved[0], moved[0]), m11 = dot(moved[1], moved[1]);
  const double m01 = dot(moved[0], moved[1]);
  // The root is (m + d I)/t, and its determinant d.
  const double d = std::sqrt(m00 * m11 - m01 * m01);
  const double t = std::sqrt(m00 + m11 + 2 * d);
  e[0] = (1 / (d * t)) * ((m11 + d) * moved[0] - m01 * moved[1]);
  e[1] = (1 / (d * t)) * ((m00 + d) * moved[1] - m01 * moved[0]);
  return e;
}

/// @brief Slip between two projected states of a pair.
/// @param[in] pair_n, pair States at t_n and t_{n+1}.
/// @param[in] p_n, p Their projections on the segment.
template <class S>
Slip<S> slip(const Pair<S>& pair_n, const Pair<S>& pair,
             const Projection<S>& p_n, const Projection<S>& p) noexcept
{
  constexpr std::size_t k = S::vertices;
  Slip<S> s;
  Matrix<2, 2> c;
  s.frame_n = tangent_frame(p_n, c);
  s.frame = convected_frame(p, c);
  const auto phi = S::phi(p_n.xi);
  const auto dphi = S::dphi(p_n.xi);
  s.w[0] = 1;
  for (std::size_t K = 0; K < k; ++K)
  {
    s.w[K + 1] = -phi[K];
    for (std::size_t i = 0; i < 2; ++i)
      s.b[i][K + 1] = c[i][0] * dphi[0][K] + c[i][1] * dphi[1][K];
  }
  const auto position = [](const Pair<S>& q, std::size_t A) noexcept
  { return A == 0 ? q.node : q.segment[A - 1]; };
  // Relative position and frame vectors at t_n and t_{n+1}.
  std::array<Vec3, 2> r = {};
  std::array<std::array<Vec3, 2>, 2> e = {};
  for (std::size_t A = 0; A <= k; ++A)
    for (std::size_t time = 0; time < 2; ++time)
    {
      const Vec3 x = position(time == 0 ? pair_n : pair, A);
      r[time] += s.w[A] * x;
      for (std::size_t i = 0; i < 2; ++i)
        e[i][time] += s.b[i][A] * x;
    }
  for (std::size_t i = 0; i < 2; ++i)
  {
    // gamma_i(q_n) is zero up to the round-off of the projection.
    s.value[i] = dot(r[1], e[i][1]) - dot(r[0], e[i][0]);
    const Vec3 r_m = 0.5 * (r[0] + r[1]), e_m = 0.5 * (e[i][0] + e[i][1]);
    for (std::size_t A = 0; A <= k; ++A)
      for (std::size_t d = 0; d < 3; ++d)
      {
        s.force[i][3 * A + d] = s.w[A] * e_m[d] + s.b[i][A] * r_m[d];
        s.gradient[i][3 * A + d] = s.w[A] * e[i][1][d] + s.b[i][A] * r[1][d];
      }
  }
  return s;
}
} // namespace nts
