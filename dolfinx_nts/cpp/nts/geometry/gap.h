#pragma once

#include "nts/geometry/projection.h"

/// @brief The gap g = (x_s - x_bar) . n as a function of q = (x_s, x_1..x_k):
/// gradient, Hessian, and the sensitivity of the projection. Equations in
/// parentheses are those of Franke, Hesch, Betsch (2011).
///
/// Derivatives are stored node by node, row-major, 3 (1 + k) entries a row.
namespace nts
{
/// @brief Number of coordinates of a pair.
template <class S>
inline constexpr std::size_t pair_size = 3 * (1 + S::vertices);

/// @brief A number for each coordinate of a pair, such as a gradient.
template <class S>
using PairVector = std::array<double, pair_size<S>>;

/// @brief A number for any two coordinates of a pair, such as a Hessian.
template <class S>
using PairMatrix = std::array<PairVector<S>, pair_size<S>>;

/// @brief Derivatives of the projection with respect to q.
template <class S>
struct Sensitivity
{
  std::array<PairVector<S>, 2> T;  ///< [a_a, -phi_K a_a]
  std::array<PairVector<S>, 2> N;  ///< [0, -phi_K,a n]
  std::array<PairVector<S>, 2> xi; ///< D^a = grad xi^a, eqs. (31), (35)
  std::array<PairVector<S>, 2> dn; ///< n . d(a_a), so dn = -a^a (n . d a_a)
  Matrix<2, 2> metric_inverse;     ///< m^ab [1/m^2]
};

/// @brief grad g = [n, -phi_K n], eq. (30).
template <class S>
PairVector<S> gap_gradient(const Projection<S>& p) noexcept
{
  const std::array<double, S::vertices> phi = S::phi(p.xi);
  PairVector<S> gradient;
  for (std::size_t i = 0; i < 3; ++i)
  {
    gradient[i] = p.normal[i];
    for (std::size_t K = 0; K < S::vertices; ++K)
      gradient[3 * (K + 1) + i] = -phi[K] * p.normal[i];
  }
  return gradient;
}

/// @brief Compute the derivatives of xi and n with respect to q.
///
/// A_ab D^b = T_a - g N_a with A_ab = m_ab - g n . x_bar,ab: the curvature term
/// has the opposite sign of eq. (32) as printed, and xi^b is paired with the
/// inverse of A.
/// @param[in] p A converged projection.
/// @param[out] s The sensitivity.
/// @return False at a centre of curvature (det A = 0).
template <class S>
bool sensitivity(const Projection<S>& p, Sensitivity<S>& s) noexcept
{
  Matrix<2, 2> A = p.metric;
  A[0][1] -= p.gap * p.twist;
  A[1][0] = A[0][1];
  constexpr double singular = 1e-12; // det A over det m that is round-off
  if (!(std::abs(det(A)) > singular * det(p.metric)))
    return false;
  const Matrix<2, 2> A_inverse = inverse(A);
  s.metric_inverse = inverse(p.metric);

  const std::array<double, S::vertices> phi = S::phi(p.xi);
  const Matrix<2, S::vertices> dphi = S::dphi(p.xi);
  for (std::size_t a = 0; a < 2; ++a)
    for (std::size_t i = 0; i < 3; ++i)
    {
      s.T[a][i] = p.tangents[a][i];
      s.N[a][i] = 0;
      for (std::size_t K = 0; K < S::vertices; ++K)
      {
        s.T[a][3 * (K + 1) + i] = -phi[K] * p.tangents[a][i];
        s.N[a][3 * (K + 1) + i] = -dphi[a][K] * p.normal[i];
      }
    }
  for (std::size_t i = 0; i < pair_size<S>; ++i)
  {
    const Vec2 right
        = {s.T[0][i] - p.gap * s.N[0][i], s.T[1][i] - p.gap * s.N[1][i]};
    const Vec2 xi = A_inverse * right;
    for (std::size_t a = 0; a < 2; ++a)
    {
      s.xi[a][i] = xi[a];
      s.dn[a][i] = p.twist * xi[1 - a] - s.N[a][i];
    }
  }
  return true;
}

/// @brief Hessian of the gap,
/// -m^ab T_b (x) (n . d a_a) + N_a (x) D^a (symmetric).
template <class S>
PairMatrix<S> gap_hessian(const Sensitivity<S>& s) noexcept
{
  PairMatrix<S> H;
  for (std::size_t i = 0; i < pair_size<S>; ++i)
  {
    const Vec2 t = s.metric_inverse * Vec2{s.T[0][i], s.T[1][i]};
    for (std::size_t j = 0; j < pair_size<S>; ++j)
      H[i][j] = s.N[0][i] * s.xi[0][j] + s.N[1][i] * s.xi[1][j]
                - t[0] * s.dn[0][j] - t[1] * s.dn[1][j];
  }
  return H;
}
} // namespace nts
