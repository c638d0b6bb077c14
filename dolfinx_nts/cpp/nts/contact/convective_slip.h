#pragma once

#include "nts/contact/discrete_gradient.h"
#include "nts/contact/slip.h"

/// @brief Slip measured by the convective coordinates of the projection, by
/// Franke, Hesch and Betsch (2011), eqs. (60)-(64).
///
/// With e_i an orthonormal frame of the segment at t_n and h_ia = e_i . a_a,
///
///     g_i = h_ia (xi^a(q_{n+1}) - xi^a(q_n)),   F_i = h_ia D^a(q_m),
///
/// so that covariant components t_a = t_i h_ia give the force t_a D^a and
/// have the norm sqrt(t_a m^ab t_b) = |t_i|, the metric being that at t_n.
/// F_i . (q_{n+1} - q_n) is the slip only up to terms of third order: momenta
/// are conserved (D^a is the gradient of an invariant function), energy is not.
namespace nts
{
/// @brief Convective slip of one pair.
template <class S>
struct ConvectiveSlip
{
  bool valid = false;
  Vec2 value = {};                            ///< g_i [m]
  std::array<PairVector<S>, 2> force = {};    ///< h_ia D^a(q_m)
  std::array<PairVector<S>, 2> gradient = {}; ///< h_ia D^a(q_{n+1})
  std::array<PairMatrix<S>, 2> hessian = {};  ///< h_ia (grad D^a)(q_m)
  Matrix<2, 3> frame_n = {};                  ///< e_i at t_n
  Matrix<2, 3> frame = {};                    ///< h_ia a^a at q_{n+1}
};

/// @brief Hessians of xi^1 and xi^2, the second derivative of
/// (x_s - x_bar) . a_a = 0 solved for them.
/// @param[in] pair, p Node, segment and their projection.
/// @param[in] s Sensitivity of the projection.
template <class S>
std::array<PairMatrix<S>, 2>
projection_hessian(const Pair<S>& pair, const Projection<S>& p,
                   const Sensitivity<S>& s) noexcept
{
  constexpr std::size_t nodes = 1 + S::vertices, size = pair_size<S>;
  const auto phi = S::phi(p.xi);
  const auto dphi = S::dphi(p.xi);
  const auto d2phi = S::d2phi();
  const Vec3 mixed = combine(d2phi, pair.segment);
  const Vec3 r = p.gap * p.normal;
  // Weights of x_s - x_bar, of a_a and of x_bar,12.
  std::array<double, nodes> w = {1}, twist = {};
  std::array<std::array<double, nodes>, 2> b = {};
  for (std::size_t K = 0; K < S::vertices; ++K)
  {
    w[K + 1] = -phi[K];
    twist[K + 1] = d2phi[K];
    b[0][K + 1] = dphi[0][K];
    b[1][K + 1] = dphi[1][K];
  }
  // x_bar,ab is `mixed` for a != b, otherwise 0.
  std::array<PairMatrix<S>, 2> H;
  for (std::size_t a = 0; a < 2; ++a)
  {
    // C_b: derivative w.r.t. xi^b of the explicit gradient w a_a + b_a r.
    std::array<PairVector<S>, 2> C;
    for (std::size_t c = 0; c < 2; ++c)
      for (std::size_t A = 0; A < nodes; ++A)
        for (std::size_t i = 0; i < 3; ++i)
          C[c][3 * A + i] = -b[c][A] * p.tangents[a][i]
                            - b[a][A] * p.tangents[c][i]
                            + (a != c ? w[A] * mixed[i] + twist[A] * r[i] : 0);
    // Second derivatives w.r.t. xi: -(x_bc . a_a + x_ac . a_b + x_ab . a_c).
    const double own = -2 * dot(mixed, p.tangents[a]);
    const double other = -2 * dot(mixed, p.tangents[1 - a]);
    for (std::size_t I = 0; I < size; ++I)
      for (std::size_t J = 0; J < size; ++J)
      {
        const std::size_t A = I / 3, B = J / 3;
        double sum = I % 3 == J % 3 ? w[A] * b[a][B] + b[a][A] * w[B] : 0;
        for (std::size_t c = 0; c < 2; ++c)
          sum += C[c][I] * s.xi[c][J] + s.xi[c][I] * C[c][J];
        sum += own * (s.xi[0][I] * s.xi[1][J] + s.xi[1][I] * s.xi[0][J])
               + other * s.xi[1 - a][I] * s.xi[1 - a][J];
        H[a][I][J] = sum;
      }
  }
  Matrix<2, 2> A = p.metric;
  A[0][1] -= p.gap * p.twist;
  A[1][0] = A[0][1];
  const Matrix<2, 2> A_inverse = inverse(A);
  for (std::size_t I = 0; I < size; ++I)
    for (std::size_t J = 0; J < size; ++J)
    {
      const Vec2 solved = A_inverse * Vec2{H[0][I][J], H[1][I][J]};
      for (std::size_t a = 0; a < 2; ++a)
        H[a][I][J] = solved[a];
    }
  return H;
}

/// @brief Convective slip between two states of a pair.
/// @param[in] pair_n, pair States at t_n and t_{n+1}.
/// @param[in] orientation +1 where a_1 x a_2 points outward, otherwise -1.
template <class S>
ConvectiveSlip<S> convective_slip(const Pair<S>& pair_n, const Pair<S>& pair,
                                  double orientation) noexcept
{
  const Pair<S> pair_m = midpoint(pair_n, pair);
  const Projection<S> p_n = project(pair_n, orientation);
  const Projection<S> p_m = project(pair_m, orientation);
  const Projection<S> p = project(pair, orientation);
  Sensitivity<S> s_m, s;
  ConvectiveSlip<S> slip;
  if (!(p_n.converged && p_m.converged && p.converged && sensitivity(p_m, s_m)
        && sensitivity(p, s)))
    return slip;

  slip.valid = true;
  Matrix<2, 2> c;
  slip.frame_n = tangent_frame(p_n, c);
  const std::array<PairMatrix<S>, 2> H = projection_hessian(pair_m, p_m, s_m);
  for (std::size_t i = 0; i < 2; ++i)
    for (std::size_t a = 0; a < 2; ++a)
    {
      const double h = dot(slip.frame_n[i], p_n.tangents[a]);
      slip.value[i] += h * (p.xi[a] - p_n.xi[a]);
      for (std::size_t b = 0; b < 2; ++b)
        for (std::size_t d = 0; d < 3; ++d)
          slip.frame[i][d] += h * s.metric_inverse[a][b] * p.tangents[b][d];
      for (std::size_t I = 0; I < pair_size<S>; ++I)
      {
        slip.force[i][I] += h * s_m.xi[a][I];
        slip.gradient[i][I] += h * s.xi[a][I];
        for (std::size_t J = 0; J < pair_size<S>; ++J)
          slip.hessian[i][I][J] += h * H[a][I][J];
      }
    }
  return slip;
}
} // namespace nts
