#pragma once

#include "nts/geometry/gap.h"

/// @brief The augmented description of one contact: vectors, invariants, and
/// the six constraints as polynomials of the invariants.
///
/// The contact is described by the vectors E_0 = x_s - x_1, E_i = x_{i+1} -
/// x_1 (i = 1..k-1), E_k = d (the normal) and the scalars f = (xi, eta,
/// slack). The invariants pi are f and scalar products of the E, so rigid
/// motions leave them unchanged. Franke, Hesch, Betsch (2011), eqs. (40)-(42);
/// the products with x_s - x_1 carry the index i + 7.
namespace nts
{
/// @brief State z = (E_0..E_{k-1}, d, f) of a contact.
template <class S>
struct Augmented
{
  std::array<Vec3, S::vertices + 1> E; ///< relative positions, then d
  std::array<double, 3> f;             ///< xi, eta, slack (the gap)
};

/// @brief Positions of the invariants (17 for quadrilaterals, 12 for
/// triangles) in the paper's order.
template <class S>
struct Invariants
{
  static constexpr std::size_t k = S::vertices;
  static constexpr std::size_t count = 2 * k + 3 + k * (k - 1) / 2;
  using Values = std::array<double, count>;

  /// @brief Position of E_a . d.
  static constexpr std::size_t normal(std::size_t a) noexcept { return a; }
  /// @brief Position of xi (i = 0), eta (1) or slack (2).
  static constexpr std::size_t f(std::size_t i) noexcept { return k + i; }
  /// @brief Position of d . d.
  static constexpr std::size_t unit() noexcept { return k + 3; }
  /// @brief Position of E_i . E_0, i = 1..k-1.
  static constexpr std::size_t node(std::size_t i) noexcept
  {
    return k + 3 + i;
  }
  /// @brief Position of E_i . E_j, 1 <= i <= j <= k-1.
  static constexpr std::size_t edge(std::size_t i, std::size_t j) noexcept
  {
    return 2 * k + 3 + (i - 1) * (2 * k - i) / 2 + j - i;
  }

  /// @brief An invariant that is a scalar product E_a . E_b.
  struct Product
  {
    std::size_t index, a, b;
  };

  /// @brief All invariants that are scalar products.
  static constexpr std::array<Product, count - 3> products = []
  {
    std::array<Product, count - 3> list = {};
    std::size_t n = 0;
    for (std::size_t a = 0; a < k; ++a)
      list[n++] = {normal(a), a, k};
    list[n++] = {unit(), k, k};
    for (std::size_t i = 1; i < k; ++i)
      list[n++] = {node(i), i, 0};
    for (std::size_t i = 1; i < k; ++i)
      for (std::size_t j = i; j < k; ++j)
        list[n++] = {edge(i, j), i, j};
    return list;
  }();
};

/// @brief The augmented state of a projected pair.
template <class S>
Augmented<S> augment(const Pair<S>& pair, const Vec3& normal, const Vec2& xi,
                     double slack) noexcept
{
  Augmented<S> z;
  z.E[0] = pair.node - pair.segment[0];
  for (std::size_t i = 1; i < S::vertices; ++i)
    z.E[i] = pair.segment[i] - pair.segment[0];
  z.E[S::vertices] = normal;
  z.f = {xi[0], xi[1], slack};
  return z;
}

/// @brief Mean of two augmented states.
template <class S>
Augmented<S> mean(const Augmented<S>& z0, const Augmented<S>& z1) noexcept
{
  Augmented<S> z;
  for (std::size_t a = 0; a < z.E.size(); ++a)
    z.E[a] = 0.5 * (z0.E[a] + z1.E[a]);
  for (std::size_t i = 0; i < 3; ++i)
    z.f[i] = 0.5 * (z0.f[i] + z1.f[i]);
  return z;
}

/// @brief The invariants pi(z), eq. (41).
template <class S>
typename Invariants<S>::Values invariants(const Augmented<S>& z) noexcept
{
  using I = Invariants<S>;
  typename I::Values pi;
  for (const auto& [index, a, b] : I::products)
    pi[index] = dot(z.E[a], z.E[b]);
  for (std::size_t i = 0; i < 3; ++i)
    pi[I::f(i)] = z.f[i];
  return pi;
}

/// @brief The six constraints, eq. (42): gap minus slack, d normal to both
/// tangents, d of unit length, projection conditions.
template <class S>
std::array<double, 6>
constraints(const typename Invariants<S>::Values& pi) noexcept
{
  using I = Invariants<S>;
  const Vec2 xi = {pi[I::f(0)], pi[I::f(1)]};
  const auto phi = S::phi(xi);
  const auto dphi = S::dphi(xi);
  std::array<double, 6> g
      = {pi[I::normal(0)] - pi[I::f(2)], 0, 0, (pi[I::unit()] - 1) / 2, 0, 0};
  for (std::size_t i = 1; i < S::vertices; ++i)
  {
    g[0] -= phi[i] * pi[I::normal(i)];
    for (std::size_t a = 0; a < 2; ++a)
    {
      g[1 + a] += dphi[a][i] * pi[I::normal(i)];
      g[4 + a] += dphi[a][i] * pi[I::node(i)];
      for (std::size_t j = 1; j < S::vertices; ++j)
        g[4 + a] -= dphi[a][i] * phi[j]
                    * pi[I::edge(std::min(i, j), std::max(i, j))];
    }
  }
  return g;
}

/// @brief Gradients of the six constraints by the invariants.
template <class S>
using ConstraintGradient = std::array<typename Invariants<S>::Values, 6>;

/// @brief Compute the gradients D g(pi) of the constraints, six rows.
template <class S>
ConstraintGradient<S>
constraints_gradient(const typename Invariants<S>::Values& pi) noexcept
{
  using I = Invariants<S>;
  const Vec2 xi = {pi[I::f(0)], pi[I::f(1)]};
  const auto phi = S::phi(xi);
  const auto dphi = S::dphi(xi);
  const auto d2phi = S::d2phi();

  ConstraintGradient<S> D = {};
  D[0][I::normal(0)] = 1;
  D[0][I::f(2)] = -1;
  D[3][I::unit()] = 0.5;
  for (std::size_t i = 1; i < S::vertices; ++i)
  {
    D[0][I::normal(i)] = -phi[i];
    for (std::size_t a = 0; a < 2; ++a)
    {
      D[0][I::f(a)] -= dphi[a][i] * pi[I::normal(i)];
      D[1 + a][I::normal(i)] = dphi[a][i];
      D[1 + a][I::f(1 - a)] += d2phi[i] * pi[I::normal(i)];
      D[4 + a][I::node(i)] = dphi[a][i];
      D[4 + a][I::f(1 - a)] += d2phi[i] * pi[I::node(i)];
      for (std::size_t j = 1; j < S::vertices; ++j)
      {
        const std::size_t ij = I::edge(std::min(i, j), std::max(i, j));
        D[4 + a][ij] -= dphi[a][i] * phi[j];
        D[4 + a][I::f(1 - a)] -= d2phi[i] * phi[j] * pi[ij];
        for (std::size_t b = 0; b < 2; ++b)
          D[4 + a][I::f(b)] -= dphi[a][i] * dphi[b][j] * pi[ij];
      }
    }
  }
  return D;
}

/// @brief Compute the rows xi, eta of sum_m weights_m D^2 g_m(pi).
///
/// Every second derivative involves xi or eta, so by symmetry these two rows
/// hold the whole matrix.
template <class S>
std::array<typename Invariants<S>::Values, 2>
constraints_hessian(const typename Invariants<S>::Values& pi,
                    const std::array<double, 6>& weights) noexcept
{
  using I = Invariants<S>;
  const Vec2 xi = {pi[I::f(0)], pi[I::f(1)]};
  const auto phi = S::phi(xi);
  const auto dphi = S::dphi(xi);
  const auto d2phi = S::d2phi();

  std::array<typename I::Values, 2> H = {};
  for (std::size_t i = 1; i < S::vertices; ++i)
    for (std::size_t a = 0; a < 2; ++a)
    {
      H[a][I::normal(i)] = -weights[0] * dphi[a][i] + weights[2 - a] * d2phi[i];
      H[a][I::node(i)] = weights[5 - a] * d2phi[i];
      H[a][I::f(1 - a)] -= weights[0] * d2phi[i] * pi[I::normal(i)];
      for (std::size_t j = 1; j < S::vertices; ++j)
      {
        const std::size_t ij = I::edge(std::min(i, j), std::max(i, j));
        H[a][ij] -= weights[5 - a] * d2phi[i] * phi[j];
        for (std::size_t c = 0; c < 2; ++c)
        {
          H[a][ij] -= weights[4 + c] * dphi[c][i] * dphi[a][j];
          // d/dxi^b of d2phi_i phi_j (row 1 - c only) and dphi_i d2phi_j.
          H[a][I::f(1 - a)] -= weights[4 + c] * dphi[c][i] * d2phi[j] * pi[ij];
          H[a][I::f(c)] -= weights[5 - a] * d2phi[i] * dphi[c][j] * pi[ij];
          H[a][I::f(1 - c)] -= weights[4 + c] * d2phi[i] * dphi[a][j] * pi[ij];
        }
      }
    }
  return H;
}
} // namespace nts
