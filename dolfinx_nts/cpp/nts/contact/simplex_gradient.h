#pragma once

#include "nts/contact/discrete_gradient.h"

/// @brief Closed form of the energy-momentum scheme for edges and triangles.
///
/// Let d_m be the mean normal, E_i the mean edges from the first vertex to the
/// others, E_0 the mean position of the node relative to the first vertex, and
/// c^i the vectors with c^i . E_j = delta_ij, c^i . d_m = 0. As the constraints
/// are of degree two in the invariants, the multipliers of the projection
/// conditions are zero. The rows of d in `discrete_gradient.h` then give the
/// force
///
///     beta_i = c^i . E_0,  F = d_m (x) w,  w = (1, -(1 - sum beta), -beta_i)
///
/// The line from the node along d_m intersects the mean segment at beta. The
/// second direction of an edge in the plane is along z.
namespace nts
{
/// @brief Energy-momentum scheme for edges and triangles, eight times as fast
/// as the general template.
template <class S>
  requires S::is_simplex
void contact_conserving(const Pair<S>& pair_n, const Pair<S>& pair,
                        double orientation, Contact<S>& contact) noexcept
{
  constexpr std::size_t nodes = 1 + S::vertices, edges = S::vertices - 1;
  constexpr double singular
      = 1e-12; // volume of edges and normal that is round-off
  const Projection<S> p_n = project(pair_n, orientation);
  const Projection<S> p = project(pair, orientation);
  const Pair<S> mean = midpoint(pair_n, pair);
  const Vec3 d = 0.5 * (p_n.normal + p.normal);
  const Vec3 E0 = mean.node - mean.segment[0];
  const std::array<Vec3, 2> E = S::directions(mean.segment);
  const double volume = dot(d, cross(E[0], E[1]));
  contact.valid
      = p_n.converged && p.converged
        && std::abs(volume) > singular * (dot(E[0], E[0]) + dot(E[1], E[1]));
  if (!contact.valid)
    return;
  set_ends(p_n, p, contact);

  const std::array<Vec3, 2> c
      = {(1 / volume) * cross(E[1], d), (1 / volume) * cross(d, E[0])};
  const Vec2 beta = {dot(c[0], E0), dot(c[1], E0)};
  std::array<double, nodes> w = {1, -1};
  for (std::size_t i = 0; i < edges; ++i)
  {
    w[1] += beta[i];
    w[2 + i] = -beta[i];
  }
  for (std::size_t A = 0; A < nodes; ++A)
    for (std::size_t i = 0; i < 3; ++i)
      contact.force[3 * A + i] = w[A] * d[i];

  // Tangent: d changes by sum_B turn_B (n . dx_B), with the contravariant
  // vectors at t_{n+1}, and beta_i by sum_B dbeta_iB . dx_B.
  const double height
      = dot(E0 - beta[0] * E[0] - beta[1] * E[1], d) / dot(d, d);
  const Matrix<2, 2> m = inverse(p.metric);
  std::array<Vec3, nodes> turn = {};
  std::array<std::array<Vec3, nodes>, edges> dbeta;
  for (std::size_t i = 0; i < edges; ++i)
  {
    turn[2 + i] = -0.5 * (m[i][0] * p.tangents[0] + m[i][1] * p.tangents[1]);
    turn[1] += -1 * turn[2 + i];
  }
  for (std::size_t i = 0; i < edges; ++i)
    for (std::size_t B = 0; B < nodes; ++B)
      dbeta[i][B] = 0.5 * w[B] * c[i] - height * dot(c[i], turn[B]) * p.normal;
  for (std::size_t A = 0; A < nodes; ++A)
    for (std::size_t B = 0; B < nodes; ++B)
    {
      Vec3 dw = {};
      if (A == 1)
        for (std::size_t i = 0; i < edges; ++i)
          dw += dbeta[i][B];
      else if (A > 1)
        dw = -1 * dbeta[A - 2][B];
      for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j)
          contact.tangent[3 * A + i][3 * B + j]
              = w[A] * turn[B][i] * p.normal[j] + d[i] * dw[j];
    }
}
} // namespace nts
