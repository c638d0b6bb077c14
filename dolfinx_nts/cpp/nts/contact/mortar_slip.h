#pragma once

#include "nts/contact/friction.h"

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

/// @brief Slips of nodes as means of the slips of contact points, in nodal
/// frames.
namespace nts
{
/// @brief Shares of n nodes in points, as matrices between their frames.
struct TurnedShares
{
  /// (n + 1,) Offsets of the shares of each node.
  std::span<const std::int64_t> start;
  /// (i,) Points of the shares.
  std::span<const std::int32_t> point;
  /// (i, 2, 2) Weight of slip component b of the point in component a of the
  /// node.
  std::span<const double> part;

  Matrix<2, 2> matrix(std::int64_t i) const noexcept
  {
    const double* p = part.data() + 4 * i;
    return {{{p[0], p[1]}, {p[2], p[3]}}};
  }
};

/// @brief Orthonormal vectors nearest to two vectors: the polar factor, which
/// is symmetric in both.
inline Matrix<2, 3> orthonormal(const Matrix<2, 3>& frame) noexcept
{
  const double a = dot(frame[0], frame[0]), b = dot(frame[0], frame[1]),
               c = dot(frame[1], frame[1]);
  const double area = std::sqrt(a * c - b * b);
  const double scale = 1 / (area * std::sqrt(a + c + 2 * area));
  // The inverse square root of the products, a matrix of two rows.
  return {scale * (c + area) * frame[0] + -scale * b * frame[1],
          scale * (a + area) * frame[1] + -scale * b * frame[0]};
}

/// @brief Matrices of shares, (i, 2, 2): shares times the rotation of
/// components from frames of points to nodal frames.
/// @param[in] value Values of the shares, (i,).
/// @param[in] of_nodes, of_points Frames, (n, 2, 3) and (p, 2, 3).
inline void turn_shares(std::span<const std::int64_t> start,
                        std::span<const std::int32_t> point,
                        std::span<const double> value,
                        std::span<const double> of_nodes,
                        std::span<const double> of_points,
                        std::span<double> parts) noexcept
{
  for (std::size_t n = 0; n + 1 < start.size(); ++n)
    for (std::int64_t i = start[n]; i < start[n + 1]; ++i)
    {
      const Matrix<2, 2> turn = between_frames(of_nodes.data() + 6 * n,
                                               of_points.data() + 6 * point[i]);
      for (std::size_t a = 0; a < 2; ++a)
        for (std::size_t b = 0; b < 2; ++b)
          parts[4 * i + 2 * a + b] = value[i] * turn[a][b];
    }
}

/// @brief Slip and frame of node n from slips, (p, 2), and frames of points,
/// (p, 2, 3).
inline std::pair<Vec2, Matrix<2, 3>>
sum_slip(const TurnedShares& shares, std::size_t n,
         std::span<const double> slip, std::span<const double> frame) noexcept
{
  Vec2 sum = {};
  Matrix<2, 3> tangents = {};
  for (std::int64_t i = shares.start[n]; i < shares.start[n + 1]; ++i)
  {
    const std::size_t q = shares.point[i];
    const Matrix<2, 2> part = shares.matrix(i);
    for (std::size_t a = 0; a < 2; ++a)
      for (std::size_t b = 0; b < 2; ++b)
      {
        sum[a] += part[a][b] * slip[2 * q + b];
        tangents[a] += part[a][b] * vector(frame, 2 * q + b);
      }
  }
  return {sum, orthonormal(tangents)};
}

/// @brief Add tractions at points, (p, 2), from nodal tractions, (n, 2).
inline void spread_tractions(const TurnedShares& shares,
                             std::span<const double> traction,
                             std::span<double> of_points) noexcept
{
  for (std::size_t n = 0; n + 1 < shares.start.size(); ++n)
    for (std::int64_t i = shares.start[n]; i < shares.start[n + 1]; ++i)
      for (std::size_t a = 0; a < 2; ++a)
        for (std::size_t b = 0; b < 2; ++b)
          of_points[2 * shares.point[i] + b]
              += shares.matrix(i)[a][b] * traction[2 * n + a];
}

/// @brief Second derivatives of t . slip of points by the nodes of facet and
/// segment, see `slip.h` and `sum_to_blocks`.
/// @param[in] phi Weights of the nodes of the facets, (p, k).
/// @param[in] width Nodes of a facet, k.
/// @param[in] vertices Vertices of a segment, s.
/// @param[in] block Block of each point, (p,).
/// @param[in] w, b Weights of the pairs, (p, 1 + s) and (p, 2, 1 + s).
/// @param[in] traction (p, 2).
/// @param[in,out] out (b, 3 (k + s), 3 (k + s)), incremented.
inline void
sum_slip_blocks(std::span<const double> phi, std::size_t width,
                std::size_t vertices, std::span<const std::int32_t> block,
                std::span<const double> w, std::span<const double> b,
                std::span<const double> traction, std::span<double> out)
{
  const std::size_t n = 1 + vertices, m = width + vertices;
  std::vector<double> of_way(m), of_frame(m);
  const auto expand
      = [&](std::size_t p, const auto& weight, std::vector<double>& weights)
  {
    for (std::size_t A = 0; A < width; ++A)
      weights[A] = phi[width * p + A] * weight(0);
    for (std::size_t K = 0; K < vertices; ++K)
      weights[width + K] = weight(1 + K);
  };
  for (std::size_t p = 0; p < block.size(); ++p)
  {
    const double* t = traction.data() + 2 * p;
    expand(p, [&](std::size_t A) { return w[n * p + A]; }, of_way);
    expand(
        p, [&](std::size_t A)
        { return t[0] * b[2 * n * p + A] + t[1] * b[2 * n * p + n + A]; },
        of_frame);
    double* to = out.data() + 9 * m * m * block[p];
    for (std::size_t A = 0; A < m; ++A)
      for (std::size_t B = 0; B < m; ++B)
      {
        const double value = of_way[A] * of_frame[B] + of_frame[A] * of_way[B];
        for (std::size_t c = 0; c < 3; ++c)
          to[3 * m * (3 * A + c) + 3 * B + c] += value;
      }
  }
}
} // namespace nts
