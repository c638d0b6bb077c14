#pragma once

#include "nts/geometry/small.h"

#include <cstdint>
#include <span>

/// @brief From contact points to the nodes that carry the multipliers.
///
/// A point is a sum of the nodes of its facet with weights phi, and a node
/// has a share in the forces of some points. Both are constants of a step, so
/// that what kernels conserve for each point is conserved for each node.
namespace nts
{
/// @brief Points, and the shares of nodes in them.
struct Aggregation
{
  /// (p, k) Weights of the nodes of the facet.
  std::span<const double> phi;
  std::size_t width;
  /// (n + 1,) Where the shares of each node begin, and the end.
  std::span<const std::int64_t> start;
  /// (i,) Points of the shares.
  std::span<const std::int32_t> point;
  /// (i,) Shares.
  std::span<const double> share;
  /// (i, k + s) Places of the nodes of facet and segment in the row of the
  /// node.
  std::span<const std::int32_t> place;
};

/// @brief Sum vectors over the pairs of points to rows over the nodes.
/// @param[in] a Points and shares.
/// @param[in] vertices Vertices s of a segment.
/// @param[in] values Vectors of pairs, (p, c, 3 (1 + s)).
/// @param[in] count How many of them, c.
/// @param[in] length Nodes of a row, L.
/// @param[in,out] rows (n, c, 3 L), to which is added.
inline void sum_to_rows(const Aggregation& a, std::size_t vertices,
                        std::span<const double> values, std::size_t count,
                        std::size_t length, std::span<double> rows) noexcept
{
  const std::size_t k = a.width, size = 3 * (1 + vertices);
  for (std::size_t n = 0; n + 1 < a.start.size(); ++n)
    for (std::int64_t i = a.start[n]; i < a.start[n + 1]; ++i)
    {
      const std::size_t q = a.point[i];
      const std::int32_t* place = a.place.data() + (k + vertices) * i;
      for (std::size_t c = 0; c < count; ++c)
      {
        const double* value = values.data() + size * (count * q + c);
        double* row = rows.data() + 3 * length * (count * n + c);
        for (std::size_t d = 0; d < 3; ++d)
        {
          for (std::size_t b = 0; b < k; ++b)
            row[3 * place[b] + d] += a.share[i] * a.phi[k * q + b] * value[d];
          for (std::size_t K = 0; K < vertices; ++K)
            row[3 * place[k + K] + d] += a.share[i] * value[3 * (1 + K) + d];
        }
      }
    }
}

/// @brief Sum matrices of pairs to those of facet and segment.
/// @param[in] phi Weights of the nodes of the facets, (p, k).
/// @param[in] width Nodes of a facet, k.
/// @param[in] vertices Vertices of a segment, s.
/// @param[in] block To which block each pair belongs, (p,).
/// @param[in] factor Of each matrix, (p,).
/// @param[in] matrix (p, 3 (1 + s), 3 (1 + s)).
/// @param[in,out] out (b, 3 (k + s), 3 (k + s)), to which is added.
inline void sum_to_blocks(std::span<const double> phi, std::size_t width,
                          std::size_t vertices,
                          std::span<const std::int32_t> block,
                          std::span<const double> factor,
                          std::span<const double> matrix,
                          std::span<double> out) noexcept
{
  const std::size_t n = 3 * (1 + vertices), m = 3 * (width + vertices);
  // Node of a pair, and weight, of each node of facet and segment.
  const auto node
      = [&](std::size_t a) { return a < width ? 0 : a - width + 1; };
  for (std::size_t p = 0; p < factor.size(); ++p)
  {
    if (factor[p] == 0)
      continue;
    const auto weight
        = [&](std::size_t a) { return a < width ? phi[width * p + a] : 1; };
    for (std::size_t a = 0; a < width + vertices; ++a)
      for (std::size_t r = 0; r < 3; ++r)
      {
        const double* row = matrix.data() + n * (n * p + 3 * node(a) + r);
        double* to = out.data() + m * (m * block[p] + 3 * a + r);
        for (std::size_t b = 0; b < width + vertices; ++b)
        {
          const double scale = factor[p] * weight(a) * weight(b);
          for (std::size_t c = 0; c < 3; ++c)
            to[3 * b + c] += scale * row[3 * node(b) + c];
        }
      }
  }
}
} // namespace nts
