#pragma once

#include "gap.h"

#include <cstdint>
#include <span>

/// @brief Elimination of the multipliers: every active node gives up its
/// normal displacement, which the constraint determines.
///
/// Column E_i of an active pair holds the node's normal at the node alone,
/// G_i the gradient of its gap, F_i its force. Where no active node is
/// a vertex of another active pair, G^T E and E^T F are diagonal and
///
///     Z = 1 - E (G^T E)^-1 G^T,   Z~^T = 1 - F (E^T F)^-1 E^T
///
/// act on each pair by itself: Z x satisfies the constraints, and Z~^T y is
/// free of multipliers.
namespace nts
{
/// @brief Active pairs of one contact pair, in blocks of 3(1+k).
template <class S>
struct Elimination
{
  std::span<const std::int32_t> dofs; ///< (m, 1 + k) nodes, contact node first
  std::span<const double> normal;     ///< (m, 3) E
  std::span<const double> gradient;   ///< (m, 3(1+k)) G
  std::span<const double> force;      ///< (m, 3(1+k)) F
  std::span<const double> tangent;    ///< (m, 3(1+k), 3(1+k)) lambda dF/dq
};

template <class S>
PairVector<S> gather(std::span<const double> x,
                     std::span<const std::int32_t> dofs) noexcept
{
  PairVector<S> values;
  for (std::size_t K = 0; K < dofs.size(); ++K)
    std::copy_n(x.begin() + 3 * dofs[K], 3, values.begin() + 3 * K);
  return values;
}

template <class S>
void scatter_add(const PairVector<S>& values,
                 std::span<const std::int32_t> dofs,
                 std::span<double> y) noexcept
{
  for (std::size_t K = 0; K < dofs.size(); ++K)
    for (std::size_t c = 0; c < 3; ++c)
      y[3 * dofs[K] + c] += values[3 * K + c];
}

/// @brief Component of a row of blocks along E, and along a pair's row.
template <std::size_t N>
double inner(const double* a, const double* b) noexcept
{
  double sum = 0;
  for (std::size_t i = 0; i < N; ++i)
    sum += a[i] * b[i];
  return sum;
}

/// @brief x <- Z x + E (G^T E)^-1 values.
/// @param[in] e Active pairs.
/// @param[in] values Gap increments to be reached, or empty for none.
/// @param[in,out] x Nodal vectors, (n, 3).
template <class S>
void constrain(const Elimination<S>& e, std::span<const double> values,
               std::span<double> x) noexcept
{
  constexpr std::size_t k = 1 + S::vertices, n = pair_size<S>;
  for (std::size_t i = 0; i < e.dofs.size() / k; ++i)
  {
    const std::span<const std::int32_t> dofs = e.dofs.subspan(k * i, k);
    const PairVector<S> q = gather<S>(x, dofs);
    const double* G = e.gradient.data() + n * i;
    const double* E = e.normal.data() + 3 * i;
    const double wanted = values.empty() ? 0 : values[i];
    const double s = (wanted - inner<n>(G, q.data())) / inner<3>(G, E);
    for (std::size_t c = 0; c < 3; ++c)
      x[3 * dofs[0] + c] += s * E[c];
  }
}

/// @brief y <- Z~^T (y + sum lambda dF/dq x).
template <class S>
void act(const Elimination<S>& e, std::span<const double> x,
         std::span<double> y) noexcept
{
  constexpr std::size_t k = 1 + S::vertices, n = pair_size<S>;
  for (std::size_t i = 0; i < e.dofs.size() / k; ++i)
  {
    const std::span<const std::int32_t> dofs = e.dofs.subspan(k * i, k);
    const PairVector<S> q = gather<S>(x, dofs);
    const double* C = e.tangent.data() + n * n * i;
    const double* F = e.force.data() + n * i;
    const double* E = e.normal.data() + 3 * i;
    PairVector<S> f;
    for (std::size_t a = 0; a < n; ++a)
      f[a] = inner<n>(C + n * a, q.data());
    const double s
        = (inner<3>(E, y.data() + 3 * dofs[0]) + inner<3>(E, f.data()))
          / inner<3>(E, F);
    for (std::size_t a = 0; a < n; ++a)
      f[a] -= s * F[a];
    scatter_add<S>(f, dofs, y);
  }
}
} // namespace nts
