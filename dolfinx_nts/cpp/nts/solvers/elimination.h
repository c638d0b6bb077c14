#pragma once

#include "nts/geometry/small.h"

#include <cstdint>
#include <span>

/// @brief Elimination of the multipliers: a constrained node gives up the
/// displacements that its constraints determine.
///
/// A node has 0 (no multiplier), 1 (normal) or 3 (normal and stick)
/// constraints, with gradients G_a and forces F_a per multiplier, which reach
/// any number of other nodes. E holds the directions that are given up: the
/// normal, or all three. Where no constrained node is reached by constraints
/// of another one, G^T E and E^T F are block diagonal and
///
///     Z = 1 - E (G^T E)^-1 G^T,   Z~^T = 1 - F (E^T F)^-1 E^T
///
/// act on the constraints of each node by themselves: Z x satisfies the
/// constraints, and Z~^T y is free of multipliers.
namespace nts
{
/// @brief Constraints of some nodes, and blocks of the tangent of contact, all
/// with lists of nodes of their own.
struct Elimination
{
  /// (m + 1,) Where the nodes of each list begin, and the end.
  std::span<const std::int64_t> start;
  /// (l,) Nodes that the constraints reach, list by list, in each the
  /// constrained one first.
  std::span<const std::int32_t> nodes;
  /// (m,) Number of constraints.
  std::span<const std::int32_t> rank;
  /// (m, 3) Unit normal at the constrained node.
  std::span<const double> normal;
  /// (9 l,) G_a, list by list, shape (3, 3 k) for k nodes.
  std::span<const double> gradients;
  /// (9 l,) F_a, the same.
  std::span<const double> columns;
  /// (m, 3, 3) How forces F_a follow gap and slip, S_ab: springs and friction.
  std::span<const double> slopes;
  /// Nodes of a block of the tangent.
  std::size_t width;
  /// (p, width) Nodes of the blocks.
  std::span<const std::int32_t> tangent_nodes;
  /// (p, 3 width, 3 width) Blocks, whose sum, with that of F_a S_ab G_b^T, is
  /// the contact tangent C.
  std::span<const double> tangent;

  /// @brief Nodes that the constraints of node i reach.
  std::span<const std::int32_t> list(std::size_t i) const noexcept
  {
    return nodes.subspan(start[i], start[i + 1] - start[i]);
  }

  /// @brief Constraint a of node i: gradient or force, three numbers a node.
  const double* row(std::span<const double> rows, std::size_t i,
                    std::size_t a) const noexcept
  {
    return rows.data() + 9 * start[i] + 3 * a * list(i).size();
  }

  /// @brief S of node i.
  Matrix<3, 3> slope(std::size_t i) const noexcept
  {
    const double* S = slopes.data() + 9 * i;
    return {{{S[0], S[1], S[2]}, {S[3], S[4], S[5]}, {S[6], S[7], S[8]}}};
  }
};

/// @brief Multipliers that balance forces at nodes along their normals:
/// -n . force / n . F, 0 where F has no part along the normal.
/// @param[in] normal Normals n, (m, 3).
/// @param[in] force What is to be balanced, (m, 3).
/// @param[in] columns Force per multiplier F, (m, stride): the first three.
/// @param[out] lambda Multipliers, (m,).
inline void balance(std::span<const double> normal,
                    std::span<const double> force,
                    std::span<const double> columns, std::size_t stride,
                    std::span<double> lambda) noexcept
{
  constexpr double least = 1e-3; // of the unit force per multiplier [-]
  for (std::size_t i = 0; i < lambda.size(); ++i)
  {
    const double* n = normal.data() + 3 * i;
    const double response = inner<3>(n, columns.data() + stride * i);
    const bool responds = std::abs(response) > least;
    lambda[i] = responds ? -inner<3>(n, force.data() + 3 * i) / response : 0;
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
/// @param[in] e Constraints.
/// @param[in] values Wanted G^T x, (m, 3), or empty for none.
/// @param[in,out] x Nodal vectors, (n, 3).
inline void constrain(const Elimination& e, std::span<const double> values,
                      std::span<double> x) noexcept
{
  for (std::size_t i = 0; i < e.rank.size(); ++i)
  {
    const std::span<const std::int32_t> list = e.list(i);
    const auto rank = static_cast<std::size_t>(e.rank[i]);
    Vec3 missing = {};
    for (std::size_t a = 0; a < rank; ++a)
    {
      const double* G = e.row(e.gradients, i, a);
      double product = 0;
      for (const std::int32_t node : list)
        for (std::size_t c = 0; c < 3; ++c)
          product += *G++ * x[3 * node + c];
      missing[a] = (values.empty() ? 0 : values[3 * i + a]) - product;
    }
    Vec3 dx = {};
    if (rank == 1)
    {
      const double* E = e.normal.data() + 3 * i;
      for (std::size_t c = 0; c < 3; ++c)
        dx[c] = missing[0] / inner<3>(e.row(e.gradients, i, 0), E) * E[c];
    }
    else if (rank == 3)
    {
      Matrix<3, 3> A;
      Matrix<3, 1> b;
      for (std::size_t a = 0; a < 3; ++a)
      {
        std::copy_n(e.row(e.gradients, i, a), 3, A[a].begin());
        b[a][0] = missing[a];
      }
      solve(A, b);
      dx = {b[0][0], b[1][0], b[2][0]};
    }
    for (std::size_t c = 0; c < 3; ++c)
      x[3 * list[0] + c] += dx[c];
  }
}

/// @brief y <- y + sum of F_a S_ab G_b^T x.
inline void add_slopes(const Elimination& e, std::span<const double> x,
                       std::span<double> y) noexcept
{
  for (std::size_t i = 0; i < e.rank.size(); ++i)
  {
    const Matrix<3, 3> S = e.slope(i);
    if (S == Matrix<3, 3>{})
      continue;
    const std::span<const std::int32_t> list = e.list(i);
    Vec3 change = {};
    for (std::size_t b = 0; b < 3; ++b)
    {
      const double* G = e.row(e.gradients, i, b);
      double product = 0;
      for (std::size_t K = 0; K < list.size(); ++K)
        product += inner<3>(G + 3 * K, x.data() + 3 * list[K]);
      for (std::size_t a = 0; a < 3; ++a)
        change[a] += S[a][b] * product;
    }
    for (std::size_t a = 0; a < 3; ++a)
    {
      const double* F = e.row(e.columns, i, a);
      for (std::size_t K = 0; K < list.size(); ++K)
        for (std::size_t c = 0; c < 3; ++c)
          y[3 * list[K] + c] += change[a] * F[3 * K + c];
    }
  }
}

/// @brief y <- y + C x.
inline void add_tangent(const Elimination& e, std::span<const double> x,
                        std::span<double> y) noexcept
{
  add_slopes(e, x, y);
  const std::size_t n = 3 * e.width;
  for (std::size_t p = 0; n * n * p < e.tangent.size(); ++p)
  {
    const auto nodes = e.tangent_nodes.subspan(e.width * p, e.width);
    const double* C = e.tangent.data() + n * n * p;
    for (const std::int32_t row : nodes)
    {
      Vec3 sum = {};
      for (const std::int32_t column : nodes)
      {
        const double* values = x.data() + 3 * column;
        for (std::size_t r = 0; r < 3; ++r)
          sum[r] += C[n * r] * values[0] + C[n * r + 1] * values[1]
                    + C[n * r + 2] * values[2];
        C += 3;
      }
      C += 2 * n;
      for (std::size_t r = 0; r < 3; ++r)
        y[3 * row + r] += sum[r];
    }
  }
}

/// @brief y <- Z~^T (y + C x).
/// @param[out] multipliers What this removes from y, in forces F, (m, 3).
inline void act(const Elimination& e, std::span<const double> x,
                std::span<double> y, std::span<double> multipliers) noexcept
{
  add_tangent(e, x, y);
  for (std::size_t i = 0; i < e.rank.size(); ++i)
  {
    const std::span<const std::int32_t> list = e.list(i);
    const auto rank = static_cast<std::size_t>(e.rank[i]);
    std::fill_n(multipliers.begin() + 3 * i, 3, 0.0);
    if (rank == 0)
      continue;
    // The multipliers balance the force in the directions that are given up.
    const double* force = y.data() + 3 * list[0];
    Vec3 lambda = {};
    if (rank == 1)
    {
      const double* E = e.normal.data() + 3 * i;
      lambda[0] = inner<3>(E, force) / inner<3>(E, e.row(e.columns, i, 0));
    }
    else if (rank == 3)
    {
      Matrix<3, 3> A;
      Matrix<3, 1> b;
      for (std::size_t c = 0; c < 3; ++c)
      {
        for (std::size_t a = 0; a < 3; ++a)
          A[c][a] = e.row(e.columns, i, a)[c];
        b[c][0] = force[c];
      }
      solve(A, b);
      lambda = {b[0][0], b[1][0], b[2][0]};
    }
    std::ranges::copy(lambda, multipliers.begin() + 3 * i);
    const std::size_t n = 3 * list.size();
    const double* F = e.row(e.columns, i, 0);
    for (std::size_t K = 0; K < list.size(); ++K)
    {
      Vec3 sum = {};
      for (std::size_t a = 0; a < rank; ++a)
        for (std::size_t c = 0; c < 3; ++c)
          sum[c] += lambda[a] * F[n * a + 3 * K + c];
      for (std::size_t c = 0; c < 3; ++c)
        y[3 * list[K] + c] -= sum[c];
    }
  }
}
} // namespace nts
