#pragma once

#include "nts/geometry/nodal_values.h"
#include "nts/geometry/small.h"

#include <cstdint>
#include <span>

/// @brief Elimination of the multipliers, and of the displacements of
/// constrained nodes that are determined by their constraints.
///
/// With B components a node, a node has 0 (no multiplier), 1 (normal) or B
/// (normal and stick) constraints, with gradients G_a and forces F_a per
/// multiplier, which contain any number of other nodes. E has the eliminated
/// directions: the normal, or all components. If no constraint contains a
/// constrained node of another one, G^T E and E^T F are block diagonal
/// and
///
///     Z = 1 - E (G^T E)^-1 G^T,   Z~^T = 1 - F (E^T F)^-1 E^T
///
/// act on the constraints of each node separately: Z x satisfies the
/// constraints, and Z~^T y is free of multipliers.
namespace nts
{
/// @brief Constraints of some nodes, and blocks of the tangent of contact, all
/// with lists of nodes of their own.
template <std::size_t B>
struct Elimination
{
  /// (m + 1,) Offsets of the nodes of each list.
  std::span<const std::int64_t> start;
  /// (l,) Nodes in the constraints, list by list, the constrained node first.
  std::span<const std::int32_t> nodes;
  /// (m,) Number of constraints.
  std::span<const std::int32_t> rank;
  /// (m, B) Unit normal at the constrained node.
  std::span<const double> normal;
  /// (B B l,) G_a, list by list, shape (B, B k) for k nodes.
  std::span<const double> gradients;
  /// (B B l,) F_a, in the same layout.
  std::span<const double> columns;
  /// (m, B, B) Derivatives S_ab of forces F_a w.r.t. gap and slip: springs and
  /// friction.
  std::span<const double> slopes;
  /// Number of nodes per block of the contact tangent.
  std::size_t width;
  /// (p, width) Nodes of the blocks.
  std::span<const std::int32_t> tangent_nodes;
  /// (p, B width, B width) Blocks; their sum plus the sum of F_a S_ab G_b^T is
  /// the contact tangent C.
  std::span<const double> tangent;

  /// @brief Nodes in the constraints of node i.
  std::span<const std::int32_t> list(std::size_t i) const noexcept
  {
    return nodes.subspan(start[i], start[i + 1] - start[i]);
  }

  /// @brief Constraint a of node i: gradient or force, B numbers a node.
  const double* row(std::span<const double> rows, std::size_t i,
                    std::size_t a) const noexcept
  {
    return rows.data() + B * B * start[i] + B * a * list(i).size();
  }

  /// @brief S of node i.
  Matrix<B, B> slope(std::size_t i) const noexcept
  {
    Matrix<B, B> S;
    for (std::size_t a = 0; a < B; ++a)
      std::copy_n(slopes.data() + B * (B * i + a), B, S[a].begin());
    return S;
  }
};

/// @brief Move contact nodes along their normals to close gaps to first order;
/// nodes with larger displacements than allowed are not moved.
/// @param[in] nodes Contact nodes, (m,).
/// @param[in] moves Whether each moves, (m,).
/// @param[in] gap Gaps to be closed, (m,).
/// @param[in] normal Normals n, (m, B).
/// @param[in] gradients Gradients of the gaps, (m, stride): the first B.
/// @param[in] farthest Largest displacement of each node, (m,).
/// @param[in,out] x Nodal vectors, (n, B).
template <std::size_t B>
void close_gaps(std::span<const std::int32_t> nodes,
                std::span<const bool> moves, std::span<const double> gap,
                std::span<const double> normal,
                std::span<const double> gradients, std::size_t stride,
                std::span<const double> farthest, std::span<double> x) noexcept
{
  for (std::size_t i = 0; i < gap.size(); ++i)
  {
    if (!moves[i])
      continue;
    const double* n = normal.data() + B * i;
    const double distance = gap[i] / inner<B>(n, gradients.data() + stride * i);
    if (std::islessequal(std::abs(distance),
                         farthest[i])) // false without an exception for NaN
      for (std::size_t c = 0; c < B; ++c)
        x[B * nodes[i] + c] -= distance * n[c];
  }
}

/// @brief Residual of the constraints of node i, 0 beyond its rank.
/// @param[in] values Required G^T x, (m, B), or empty for zero.
template <std::size_t B, class T>
std::array<double, B> missing(const Elimination<B>& e, std::size_t i,
                              std::span<const double> values,
                              const NodalValues<T>& x) noexcept
{
  std::array<double, B> result = {};
  for (std::size_t a = 0; a < static_cast<std::size_t>(e.rank[i]); ++a)
  {
    const double* G = e.row(e.gradients, i, a);
    double product = 0;
    for (const std::int32_t node : e.list(i))
    {
      product += inner<B>(G, x[B * node]);
      G += B;
    }
    result[a] = (values.empty() ? 0 : values[B * i + a]) - product;
  }
  return result;
}

/// @brief y <- y - F lambda for the multipliers of node i.
template <std::size_t B>
void remove(const Elimination<B>& e, std::size_t i, const double* lambda,
            const ChangedValues& y) noexcept
{
  const std::span<const std::int32_t> list = e.list(i);
  const std::size_t n = B * list.size();
  const double* F = e.row(e.columns, i, 0);
  for (std::size_t K = 0; K < list.size(); ++K)
  {
    std::array<double, B> sum = {};
    for (std::size_t a = 0; a < static_cast<std::size_t>(e.rank[i]); ++a)
      for (std::size_t c = 0; c < B; ++c)
        sum[c] += lambda[a] * F[n * a + B * K + c];
    double* const values = y[B * list[K]];
    for (std::size_t c = 0; c < B; ++c)
      values[c] -= sum[c];
  }
}

/// @brief x <- Z x + E (G^T E)^-1 values.
/// @param[in] e Constraints.
/// @param[in] values Wanted G^T x, (m, B), or empty for none.
/// @param[in,out] x A nodal vector; lists begin with nodes that are owned.
template <std::size_t B>
void constrain(const Elimination<B>& e, std::span<const double> values,
               const ChangedValues& x) noexcept
{
  for (std::size_t i = 0; i < e.rank.size(); ++i)
  {
    const std::span<const std::int32_t> list = e.list(i);
    const auto rank = static_cast<std::size_t>(e.rank[i]);
    const std::array<double, B> short_of = missing(e, i, values, x);
    std::array<double, B> dx = {};
    if (rank == 1)
    {
      const double* E = e.normal.data() + B * i;
      for (std::size_t c = 0; c < B; ++c)
        dx[c] = short_of[0] / inner<B>(e.row(e.gradients, i, 0), E) * E[c];
    }
    else if (rank == B)
    {
      Matrix<B, B> A;
      Matrix<B, 1> b;
      for (std::size_t a = 0; a < B; ++a)
      {
        std::copy_n(e.row(e.gradients, i, a), B, A[a].begin());
        b[a][0] = short_of[a];
      }
      solve(A, b);
      for (std::size_t c = 0; c < B; ++c)
        dx[c] = b[c][0];
    }
    double* const own = x[B * list[0]];
    for (std::size_t c = 0; c < B; ++c)
      own[c] += dx[c];
  }
}

/// @brief y <- y + sum of F_a S_ab G_b^T x.
template <std::size_t B>
void add_slopes(const Elimination<B>& e, const KnownValues& x,
                const ChangedValues& y) noexcept
{
  for (std::size_t i = 0; i < e.rank.size(); ++i)
  {
    const Matrix<B, B> S = e.slope(i);
    if (S == Matrix<B, B>{})
      continue;
    const std::span<const std::int32_t> list = e.list(i);
    std::array<double, B> change = {};
    for (std::size_t b = 0; b < B; ++b)
    {
      const double* G = e.row(e.gradients, i, b);
      double product = 0;
      for (std::size_t K = 0; K < list.size(); ++K)
        product += inner<B>(G + B * K, x[B * list[K]]);
      for (std::size_t a = 0; a < B; ++a)
        change[a] += S[a][b] * product;
    }
    for (std::size_t a = 0; a < B; ++a)
    {
      const double* F = e.row(e.columns, i, a);
      for (std::size_t K = 0; K < list.size(); ++K)
        for (std::size_t c = 0; c < B; ++c)
          y[B * list[K]][c] += change[a] * F[B * K + c];
    }
  }
}

/// @brief y <- y + C x.
template <std::size_t B>
void add_tangent(const Elimination<B>& e, const KnownValues& x,
                 const ChangedValues& y) noexcept
{
  add_slopes(e, x, y);
  const std::size_t n = B * e.width;
  for (std::size_t p = 0; n * n * p < e.tangent.size(); ++p)
  {
    const auto nodes = e.tangent_nodes.subspan(e.width * p, e.width);
    const double* C = e.tangent.data() + n * n * p;
    for (const std::int32_t row : nodes)
    {
      std::array<double, B> sum = {};
      for (const std::int32_t column : nodes)
      {
        const double* values = x[B * column];
        for (std::size_t r = 0; r < B; ++r)
          sum[r] += inner<B>(C + n * r, values);
        C += B;
      }
      C += (B - 1) * n;
      double* const values = y[B * row];
      for (std::size_t r = 0; r < B; ++r)
        values[r] += sum[r];
    }
  }
}

/// @brief y <- Z~^T (y + C x).
/// @param[out] multipliers Multipliers removed from y, for forces F, (m, B).
template <std::size_t B>
void act(const Elimination<B>& e, const KnownValues& x, const ChangedValues& y,
         std::span<double> multipliers) noexcept
{
  add_tangent(e, x, y);
  for (std::size_t i = 0; i < e.rank.size(); ++i)
  {
    const std::span<const std::int32_t> list = e.list(i);
    const auto rank = static_cast<std::size_t>(e.rank[i]);
    std::fill_n(multipliers.begin() + B * i, B, 0.0);
    if (rank == 0)
      continue;
    // The multipliers balance the force in the eliminated directions.
    const double* force = y[B * list[0]];
    std::array<double, B> lambda = {};
    if (rank == 1)
    {
      const double* E = e.normal.data() + B * i;
      lambda[0] = inner<B>(E, force) / inner<B>(E, e.row(e.columns, i, 0));
    }
    else if (rank == B)
    {
      Matrix<B, B> A;
      Matrix<B, 1> b;
      for (std::size_t c = 0; c < B; ++c)
      {
        for (std::size_t a = 0; a < B; ++a)
          A[c][a] = e.row(e.columns, i, a)[c];
        b[c][0] = force[c];
      }
      solve(A, b);
      for (std::size_t c = 0; c < B; ++c)
        lambda[c] = b[c][0];
    }
    std::ranges::copy(lambda, multipliers.begin() + B * i);
    remove(e, i, lambda.data(), y);
  }
}
} // namespace nts
