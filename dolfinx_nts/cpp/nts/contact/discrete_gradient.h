#pragma once

#include "nts/contact/invariants.h"

/// @brief Contact force of one step, its tangent and the gap at both ends,
/// for the midpoint rule, the energy-momentum scheme and statics.
///
/// All three functions have the same arguments and the same result: the force
/// is lambda_N times `force`, the constraint acts on `gap`.
namespace nts
{
/// @brief Contribution of a pair to one step.
template <class S>
struct Contact
{
  double gap_n;           ///< gap of q_n to this segment [m]
  double gap;             ///< gap of q_{n+1} to this segment [m]
  PairVector<S> force;    ///< contact force per multiplier
  PairVector<S> gradient; ///< gradient of `gap` at q_{n+1}
  PairMatrix<S> tangent;  ///< d force / d q_{n+1}
  double turn;            ///< n_n . n_{n+1}, cosine of the angle
  bool valid;             ///< false: all other members are invalid
};

/// @brief Mean of two states of a pair.
template <class S>
Pair<S> midpoint(const Pair<S>& a, const Pair<S>& b) noexcept
{
  Pair<S> m;
  m.node = 0.5 * (a.node + b.node);
  for (std::size_t i = 0; i < S::vertices; ++i)
    m.segment[i] = 0.5 * (a.segment[i] + b.segment[i]);
  return m;
}

/// @brief Set the results common to all schemes: gaps, gradient, turn.
template <class S>
void set_ends(const Projection<S>& p_n, const Projection<S>& p,
              Contact<S>& contact) noexcept
{
  contact.gap_n = p_n.gap;
  contact.gap = p.gap;
  contact.turn = dot(p_n.normal, p.normal);
  contact.gradient = gap_gradient(p);
}

/// @brief Midpoint rule: force grad g(q_m), q_m = (q_n + q_{n+1})/2, tangent
/// half the Hessian there; eqs. (47)-(52).
template <class S>
void contact_midpoint(const Pair<S>& pair_n, const Pair<S>& pair,
                      double orientation, Contact<S>& contact) noexcept
{
  const Projection<S> p_n = project(pair_n, orientation);
  const Projection<S> p = project(pair, orientation);
  const Projection<S> p_m = project(midpoint(pair_n, pair), orientation);
  Sensitivity<S> s;
  contact.valid
      = p_n.converged && p.converged && p_m.converged && sensitivity(p_m, s);
  if (!contact.valid)
    return;
  set_ends(p_n, p, contact);
  contact.force = gap_gradient(p_m);
  contact.tangent = gap_hessian<S>(s);
  for (PairVector<S>& row : contact.tangent)
    for (double& entry : row)
      entry *= 0.5;
}

/// @brief Static contact: force grad g(q_{n+1}), tangent its Hessian.
template <class S>
void contact_static(const Pair<S>& pair_n, const Pair<S>& pair,
                    double orientation, Contact<S>& contact) noexcept
{
  const Projection<S> p_n = project(pair_n, orientation);
  const Projection<S> p = project(pair, orientation);
  Sensitivity<S> s;
  contact.valid = p_n.converged && p.converged && sensitivity(p, s);
  if (!contact.valid)
    return;
  set_ends(p_n, p, contact);
  contact.force = contact.gradient;
  contact.tangent = gap_hessian<S>(s);
}

/// @brief Average of the constraint gradients on the straight path from pi_n
/// to pi: a discrete gradient, W (pi - pi_n) = g(pi) - g(pi_n) exactly.
///
/// Two Gauss points are exact for quadrilaterals (constraints of degree
/// four), one for triangles (degree two). Unlike the formula of eq. (59), the
/// average does not mix units and needs no division by |pi - pi_n|^2.
/// @param[in] pi_n, pi Invariants at both ends.
/// @param[in] visit Called with (weight, position, invariants) of each point.
template <class S, class Visit>
void for_each_gauss_point(const typename Invariants<S>::Values& pi_n,
                          const typename Invariants<S>::Values& pi,
                          Visit&& visit) noexcept
{
  constexpr std::size_t n = S::vertices == 3 ? 1 : 2;
  const double offset = n == 1 ? 0 : 0.5 / std::sqrt(3.);
  for (std::size_t g = 0; g < n; ++g)
  {
    const double position = 0.5 + (g == 0 ? -offset : offset);
    typename Invariants<S>::Values pi_g;
    for (std::size_t i = 0; i < pi.size(); ++i)
      pi_g[i] = pi_n[i] + position * (pi[i] - pi_n[i]);
    visit(1. / n, position, pi_g);
  }
}

/// @brief Compute the averaged constraint gradient W.
template <class S>
ConstraintGradient<S>
average_gradient(const typename Invariants<S>::Values& pi_n,
                 const typename Invariants<S>::Values& pi) noexcept
{
  ConstraintGradient<S> W = {};
  for_each_gauss_point<S>(pi_n, pi,
                          [&W](double weight, double, const auto& pi_g)
                          {
                            const ConstraintGradient<S> D
                                = constraints_gradient<S>(pi_g);
                            for (std::size_t l = 0; l < 6; ++l)
                              for (std::size_t i = 0; i < pi_g.size(); ++i)
                                W[l][i] += weight * D[l][i];
                          });
  return W;
}

/// @brief Compute D pi(z)^T theta for the vectors: row a is
/// sum_b (theta_ab + theta_ba) E_b.
template <class S>
std::array<Vec3, S::vertices + 1>
vector_forces(const Augmented<S>& z,
              const typename Invariants<S>::Values& theta) noexcept
{
  std::array<Vec3, S::vertices + 1> forces = {};
  // With positions known at compile time, a pair takes 15 % less time.
#pragma GCC unroll 16
  for (const auto& [index, a, b] : Invariants<S>::products)
  {
    forces[a] += theta[index] * z.E[b];
    forces[b] += theta[index] * z.E[a];
  }
  return forces;
}

/// @brief Transform forces on the vectors E_0..E_{k-1} to forces on x_s,
/// x_1..x_k.
template <class S>
PairVector<S>
nodal_forces(const std::array<Vec3, S::vertices + 1>& forces) noexcept
{
  PairVector<S> F;
  for (std::size_t i = 0; i < 3; ++i)
  {
    F[i] = forces[0][i];
    F[3 + i] = -forces[0][i];
    for (std::size_t a = 1; a < S::vertices; ++a)
    {
      F[3 * (a + 1) + i] = forces[a][i];
      F[3 + i] -= forces[a][i];
    }
  }
  return F;
}

/// @brief Add sum_b weights_b dE_b as a covector on q: what `nodal_forces` does
/// for component i alone, b < k.
template <class S, std::size_t N>
void add_relative(std::size_t i, const std::array<double, N>& weights,
                  PairVector<S>& row) noexcept
{
  for (std::size_t b = 0; b < S::vertices; ++b)
  {
    row[3 * (b == 0 ? 0 : b + 1) + i] += weights[b];
    row[3 + i] -= weights[b];
  }
}

/// @brief Energy-momentum scheme: the condensed form of eqs. (53)-(58).
///
/// The multipliers of the auxiliary constraints for lambda_N = 1 follow from
/// the rows of d, xi, eta:  Dpi_y(z_m)^T W^T (1, Lambda) = 0, so the force is
/// F = Dpi_q(z_m)^T W^T (1, Lambda). Its work in the step is the change of
/// the gap, F . (q_{n+1} - q_n) = gap - gap_n, for any size of the step.
template <class S>
void contact_conserving(const Pair<S>& pair_n, const Pair<S>& pair,
                        double orientation, Contact<S>& contact) noexcept
{
  using I = Invariants<S>;
  constexpr std::size_t k = S::vertices, dofs = pair_size<S>;
  const Projection<S> p_n = project(pair_n, orientation);
  const Projection<S> p = project(pair, orientation);
  Sensitivity<S> s;
  contact.valid = p_n.converged && p.converged && sensitivity(p, s);
  if (!contact.valid)
    return;
  set_ends(p_n, p, contact);

  const Augmented<S> z_n = augment(pair_n, p_n.normal, p_n.xi, p_n.gap);
  const Augmented<S> z = augment(pair, p.normal, p.xi, p.gap);
  const Augmented<S> z_m = mean(z_n, z);
  const typename I::Values pi_n = invariants(z_n), pi = invariants(z);
  const ConstraintGradient<S> W = average_gradient<S>(pi_n, pi);

  // B Lambda = -b: rows d_1..d_3, xi, eta; columns the constraints 2..6.
  std::array<std::array<Vec3, k + 1>, 6> forces;
  for (std::size_t l = 0; l < 6; ++l)
    forces[l] = vector_forces(z_m, W[l]);
  const auto row = [&](std::size_t l, std::size_t r) noexcept
  { return r < 3 ? forces[l][k][r] : W[l][I::f(r - 3)]; };
  Matrix<5, 5> B;
  for (std::size_t r = 0; r < 5; ++r)
    for (std::size_t l = 1; l < 6; ++l)
      B[r][l - 1] = row(l, r);
  Matrix<5, 1> Lambda;
  for (std::size_t r = 0; r < 5; ++r)
    Lambda[r][0] = -row(0, r);
  {
    Matrix<5, 5> factors = B;
    contact.valid = solve(factors, Lambda);
    if (!contact.valid)
      return;
  }
  std::array<double, 6> lambda = {1};
  for (std::size_t l = 1; l < 6; ++l)
    lambda[l] = Lambda[l - 1][0];
  typename I::Values Theta = {};
  for (std::size_t l = 0; l < 6; ++l)
    for (std::size_t i = 0; i < I::count; ++i)
      Theta[i] += lambda[l] * W[l][i];
  contact.force = nodal_forces<S>(vector_forces(z_m, Theta));

  // Tangent: derivatives of d, xi and eta w.r.t. q at t_{n+1}.
  Matrix<5, dofs> y;
  for (std::size_t j = 0; j < dofs; ++j)
  {
    const Vec2 t = s.metric_inverse * Vec2{s.dn[0][j], s.dn[1][j]};
    for (std::size_t i = 0; i < 3; ++i)
      y[i][j] = -t[0] * p.tangents[0][i] - t[1] * p.tangents[1][i];
    y[3][j] = s.xi[0][j];
    y[4][j] = s.xi[1][j];
  }
  std::array<typename I::Values, 2> Q = {};
  for_each_gauss_point<S>(pi_n, pi,
                          [&](double weight, double position, const auto& pi_g)
                          {
                            const auto H = constraints_hessian<S>(pi_g, lambda);
                            for (std::size_t a = 0; a < 2; ++a)
                              for (std::size_t i = 0; i < I::count; ++i)
                                Q[a][i] += weight * position * H[a][i];
                          });

  // T dz = 1/2 sum Theta_k H_k dz + Dpi(z_m)^T Q Dpi(z_{n+1}) dz, with rows
  // for E_0..E_k (a = 3 b + i) and xi, eta. Q has rows xi, eta and, by
  // symmetry, columns only: two outer products.
  const std::array<std::array<Vec3, k + 1>, 2> left
      = {vector_forces(z_m, Q[0]), vector_forces(z_m, Q[1])};
  const std::array<std::array<Vec3, k + 1>, 2> right
      = {vector_forces(z, Q[0]), vector_forces(z, Q[1])};
  Matrix<k + 1, k + 1> half = {}; // entries of sum Theta_k H_k
  for (const auto& [index, a, b] : I::products)
  {
    half[a][b] += 0.5 * Theta[index];
    half[b][a] += 0.5 * Theta[index];
  }
  Matrix<3 * (k + 1), dofs> vectors;
  for (std::size_t b = 0; b <= k; ++b)
    for (std::size_t i = 0; i < 3; ++i)
    {
      PairVector<S>& out = vectors[3 * b + i];
      for (std::size_t j = 0; j < dofs; ++j)
        out[j] = half[b][k] * y[i][j] + left[0][b][i] * y[3][j]
                 + left[1][b][i] * y[4][j];
      add_relative<S>(i, half[b], out);
    }
  Matrix<5, dofs> dLambda;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < dofs; ++j)
      dLambda[i][j] = -vectors[3 * k + i][j];
  for (std::size_t a = 0; a < 2; ++a)
  {
    PairVector<S> out;
    for (std::size_t j = 0; j < dofs; ++j)
      out[j] = right[a][k][0] * y[0][j] + right[a][k][1] * y[1][j]
               + right[a][k][2] * y[2][j] + Q[a][I::f(0)] * y[3][j]
               + Q[a][I::f(1)] * y[4][j];
    for (std::size_t i = 0; i < 3; ++i)
    {
      std::array<double, k> weights;
      for (std::size_t b = 0; b < k; ++b)
        weights[b] = right[a][b][i];
      add_relative<S>(i, weights, out);
    }
    for (std::size_t j = 0; j < dofs; ++j)
      dLambda[3 + a][j] = -out[j];
  }
  contact.valid = solve(B, dLambda);
  if (!contact.valid)
    return;
  contact.tangent = {};
  for (std::size_t b = 0; b < k; ++b)
    for (std::size_t i = 0; i < 3; ++i)
    {
      PairVector<S>& row = vectors[3 * b + i];
      for (std::size_t l = 1; l < 6; ++l)
        for (std::size_t j = 0; j < dofs; ++j)
          row[j] += forces[l][b][i] * dLambda[l - 1][j];
      // Rows of forces go to the nodes as in `nodal_forces`.
      contact.tangent[3 * (b == 0 ? 0 : b + 1) + i] = row;
      for (std::size_t j = 0; j < dofs; ++j)
        contact.tangent[3 + i][j] -= row[j];
    }
}
} // namespace nts
