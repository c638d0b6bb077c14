#pragma once

#include "nts/geometry/gap.h"

#include <cstdint>
#include <span>

/// @brief Elimination of the multipliers: a constrained node gives up the
/// displacements that its constraints determine.
///
/// A pair has 0 (no multiplier), 1 (normal) or 3 (normal and stick)
/// constraints, with gradients G_a and forces F_a per multiplier. E holds the
/// directions given up at the node: its normal, or all three. Where no
/// constrained node takes part in another pair, G^T E and E^T F are block
/// diagonal and
///
///     Z = 1 - E (G^T E)^-1 G^T,   Z~^T = 1 - F (E^T F)^-1 E^T
///
/// act on each pair by itself: Z x satisfies the constraints, and Z~^T y is
/// free of multipliers.
namespace nts
{
/// @brief Active pairs of one contact pair, n = 3(1+k).
template <class S>
struct Elimination
{
  std::span<const std::int32_t> dofs; ///< (m, 1 + k) nodes, contact node first
  std::span<const std::int32_t> rank; ///< (m,) number of constraints
  std::span<const double> normal;     ///< (m, 3) unit normal at the node
  std::span<const double> gradients;  ///< (m, 3, n) G_a
  std::span<const double> columns;    ///< (m, 3, n) F_a
  std::span<const double> tangent;    ///< (m, n, n) contact tangent C
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

/// @brief Multipliers that balance forces at nodes along their normals:
/// -n . rest / n . F, 0 where the column has no part along the normal.
/// @param[in] normal Normals n, (m, 3).
/// @param[in] rest What is to be balanced, (m, 3).
/// @param[in] columns Force per multiplier F, (m, stride): the first three.
/// @param[out] lambda Multipliers, (m,).
inline void balance(std::span<const double> normal,
                    std::span<const double> rest,
                    std::span<const double> columns, std::size_t stride,
                    std::span<double> lambda) noexcept
{
  constexpr double least = 1e-3;
  for (std::size_t i = 0; i < lambda.size(); ++i)
  {
    const double* n = normal.data() + 3 * i;
    const double response = inner<3>(n, columns.data() + stride * i);
    const bool responds = std::abs(response) > least;
    lambda[i] = responds ? -inner<3>(n, rest.data() + 3 * i) / response : 0;
  }
}

/// @brief Move contact nodes along their normals, as far as closes their gaps
/// to first order; those that would go farther than `farthest` stay.
/// @param[in] nodes Contact nodes, (m,).
/// @param[in] moves Whether each moves, (m,).
/// @param[in] gap What is to become zero, (m,).
/// @param[in] normal Normals n, (m, 3).
/// @param[in] gradients Of the gaps, (m, stride): the first three.
/// @param[in,out] x Nodal vectors, (n, 3).
inline void close_gaps(std::span<const std::int32_t> nodes,
                       std::span<const bool> moves, std::span<const double> gap,
                       std::span<const double> normal,
                       std::span<const double> gradients, std::size_t stride,
                       double farthest, std::span<double> x) noexcept
{
  for (std::size_t i = 0; i < gap.size(); ++i)
  {
    if (!moves[i])
      continue;
    const double* n = normal.data() + 3 * i;
    const double way = gap[i] / inner<3>(n, gradients.data() + stride * i);
    if (std::islessequal(std::abs(way), farthest)) // quiet where it is NaN
      for (std::size_t c = 0; c < 3; ++c)
        x[3 * nodes[i] + c] -= way * n[c];
  }
}

/// @brief x <- Z x + E (G^T E)^-1 values.
/// @param[in] e Active pairs.
/// @param[in] values Wanted G^T x, (m, 3), or empty for none.
/// @param[in,out] x Nodal vectors, (n, 3).
template <class S>
void constrain(const Elimination<S>& e, std::span<const double> values,
               std::span<double> x) noexcept
{
  constexpr std::size_t k = 1 + S::vertices, n = pair_size<S>;
  for (std::size_t i = 0; i < e.rank.size(); ++i)
  {
    const std::span<const std::int32_t> dofs = e.dofs.subspan(k * i, k);
    const PairVector<S> q = gather<S>(x, dofs);
    const double* G = e.gradients.data() + 3 * n * i;
    Vec3 missing = {};
    for (std::int32_t a = 0; a < e.rank[i]; ++a)
      missing[a] = (values.empty() ? 0 : values[3 * i + a])
                   - inner<n>(G + n * a, q.data());
    Vec3 dx = {};
    if (e.rank[i] == 1)
    {
      const double* E = e.normal.data() + 3 * i;
      for (std::size_t c = 0; c < 3; ++c)
        dx[c] = missing[0] / inner<3>(G, E) * E[c];
    }
    else if (e.rank[i] == 3)
    {
      Matrix<3, 3> A;
      Matrix<3, 1> b;
      for (std::size_t a = 0; a < 3; ++a)
      {
        std::copy_n(G + n * a, 3, A[a].begin());
        b[a][0] = missing[a];
      }
      solve(A, b);
      dx = {b[0][0], b[1][0], b[2][0]};
    }
    for (std::size_t c = 0; c < 3; ++c)
      x[3 * dofs[0] + c] += dx[c];
  }
}

/// @brief y <- Z~^T (y + C x).
template <class S>
void act(const Elimination<S>& e, std::span<const double> x,
         std::span<double> y) noexcept
{
  constexpr std::size_t k = 1 + S::vertices, n = pair_size<S>;
  for (std::size_t i = 0; i < e.rank.size(); ++i)
  {
    const std::span<const std::int32_t> dofs = e.dofs.subspan(k * i, k);
    const PairVector<S> q = gather<S>(x, dofs);
    const double* C = e.tangent.data() + n * n * i;
    const double* F = e.columns.data() + 3 * n * i;
    PairVector<S> f;
    for (std::size_t a = 0; a < n; ++a)
      f[a] = inner<n>(C + n * a, q.data());
    // What remains at the node is balanced by the multipliers.
    Vec3 rest, lambda = {};
    for (std::size_t c = 0; c < 3; ++c)
      rest[c] = y[3 * dofs[0] + c] + f[c];
    if (e.rank[i] == 1)
    {
      const double* E = e.normal.data() + 3 * i;
      lambda[0] = inner<3>(E, rest.data()) / inner<3>(E, F);
    }
    else if (e.rank[i] == 3)
    {
      Matrix<3, 3> A;
      Matrix<3, 1> b;
      for (std::size_t c = 0; c < 3; ++c)
      {
        for (std::size_t a = 0; a < 3; ++a)
          A[c][a] = F[n * a + c];
        b[c][0] = rest[c];
      }
      solve(A, b);
      lambda = {b[0][0], b[1][0], b[2][0]};
    }
    for (std::int32_t a = 0; a < e.rank[i]; ++a)
      for (std::size_t c = 0; c < n; ++c)
        f[c] -= lambda[a] * F[n * a + c];
    for (std::size_t K = 0; K < k; ++K)
      for (std::size_t c = 0; c < 3; ++c)
        y[3 * dofs[K] + c] += f[3 * K + c];
  }
}
} // namespace nts
