#pragma once

#include "nts/geometry/small.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

/// @brief Sums from contact points to the nodes that carry the multipliers.
///
/// The position of a point is a sum of nodal positions of its facet with
/// weights phi, and a node has a share in the forces of some points. Both are
/// constant in a step. Quantities that kernels conserve for each point are
/// therefore conserved for the sums.
namespace nts
{
/// @brief Points, and the shares of nodes in them.
struct Aggregation
{
  /// (p, k) Weights of the nodes of the facet.
  std::span<const double> phi;
  std::size_t width;
  /// (n + 1,) Offsets of the shares of each node.
  std::span<const std::int64_t> start;
  /// (i,) Points of the shares.
  std::span<const std::int32_t> point;
  /// (i,) Shares; or (i, c, c) matrices that map c vectors at the point to the
  /// node.
  std::span<const double> share;
  /// (i, k + s) Places of the nodes of facet and segment in the row of the
  /// node.
  std::span<const std::int32_t> place;
};

/// @brief Sum vectors over the pairs of points to rows over the nodes.
/// @param[in] a Points and shares.
/// @param[in] vertices Vertices s of a segment.
/// @param[in] values Vectors of pairs, (p, c, 3 (1 + s)).
/// @param[in] count Number of vectors of a pair, c.
/// @param[in] length Nodes of a row, L.
/// @param[in,out] rows (n, c, 3 L), incremented.
inline void sum_to_rows(const Aggregation& a, std::size_t vertices,
                        std::span<const double> values, std::size_t count,
                        std::size_t length, std::span<double> rows)
{
  const std::size_t k = a.width, size = 3 * (1 + vertices);
  std::vector<double> part(size); // component of the vector of a point
  for (std::size_t n = 0; n + 1 < a.start.size(); ++n)
    for (std::int64_t i = a.start[n]; i < a.start[n + 1]; ++i)
    {
      const std::size_t q = a.point[i];
      const std::int32_t* place = a.place.data() + (k + vertices) * i;
      for (std::size_t c = 0; c < count; ++c)
      {
        std::ranges::fill(part, 0.0);
        for (std::size_t b = 0; b < count; ++b)
        {
          const double share = a.share[count * (count * i + c) + b];
          const double* value = values.data() + size * (count * q + b);
          for (std::size_t e = 0; e < size; ++e)
            part[e] += share * value[e];
        }
        double* row = rows.data() + 3 * length * (count * n + c);
        for (std::size_t d = 0; d < 3; ++d)
        {
          for (std::size_t b = 0; b < k; ++b)
            row[3 * place[b] + d] += a.phi[k * q + b] * part[d];
          for (std::size_t K = 0; K < vertices; ++K)
            row[3 * place[k + K] + d] += part[3 * (1 + K) + d];
        }
      }
    }
}

/// @brief Means of the values of points for each node, NaN without points,
/// (n,).
inline void means(const Aggregation& a, std::span<const double> values,
                  std::span<double> mean) noexcept
{
  for (std::size_t n = 0; n < mean.size(); ++n)
  {
    mean[n] = a.start[n] < a.start[n + 1] ? 0 : NAN;
    for (std::int64_t i = a.start[n]; i < a.start[n + 1]; ++i)
      mean[n] += a.share[i] * values[a.point[i]];
  }
}

/// @brief Least of the values of points for each node, NaN where one is,
/// infinity without points, (n,).
inline void least(const Aggregation& a, std::span<const double> values,
                  std::span<double> least) noexcept
{
  for (std::size_t n = 0; n < least.size(); ++n)
  {
    least[n] = INFINITY;
    for (std::int64_t i = a.start[n]; i < a.start[n + 1]; ++i)
      if (const double value = values[a.point[i]];
          std::isnan(value) || std::isless(value, least[n]))
        least[n] = value;
  }
}

/// @brief Sum matrices of pairs to matrices of facet and segment.
/// @param[in] phi Weights of the nodes of the facets, (p, k).
/// @param[in] width Nodes of a facet, k.
/// @param[in] vertices Vertices of a segment, s.
/// @param[in] block Block of each pair, (p,).
/// @param[in] factor Factor of each matrix, (p,).
/// @param[in] matrix (p, 3 (1 + s), 3 (1 + s)).
/// @param[in,out] out (b, 3 (k + s), 3 (k + s)), incremented.
inline void sum_to_blocks(std::span<const double> phi, std::size_t width,
                          std::size_t vertices,
                          std::span<const std::int32_t> block,
                          std::span<const double> factor,
                          std::span<const double> matrix, std::span<double> out)
{
  const std::size_t n = 3 * (1 + vertices), m = 3 * (width + vertices);
  std::vector<double> row(
      m); // row of the matrix of a pair, with the facet's nodes as columns
  const auto add = [&](double scale, double* to)
  {
    for (std::size_t c = 0; c < m; ++c)
      to[c] += scale * row[c];
  };
  for (std::size_t p = 0; p < factor.size(); ++p)
  {
    if (factor[p] == 0)
      continue;
    const double* weight = phi.data() + width * p;
    double* to = out.data() + m * m * block[p];
    for (std::size_t r = 0; r < n; ++r)
    {
      const double* values = matrix.data() + n * (n * p + r);
      for (std::size_t b = 0; b < width; ++b)
        for (std::size_t c = 0; c < 3; ++c)
          row[3 * b + c] = weight[b] * values[c];
      std::copy(values + 3, values + n, row.begin() + 3 * width);
      if (r >= 3)
        add(factor[p], to + m * (3 * (width - 1) + r));
      else
        for (std::size_t a = 0; a < width; ++a)
          add(factor[p] * weight[a], to + m * (3 * a + r));
    }
  }
}

/// @brief Positions of points of facets.
/// @param[in] phi Weights of the nodes of the facets, (p, k).
/// @param[in] width Nodes of a facet, k.
/// @param[in] nodes Rows of x, nodes of the facet first, (p, stride).
/// @param[in] x Nodal vectors, (n, 3).
/// @param[out] out (p, 3).
inline void at_points(std::span<const double> phi, std::size_t width,
                      std::span<const std::int32_t> nodes, std::size_t stride,
                      std::span<const double> x, std::span<double> out) noexcept
{
  for (std::size_t p = 0; 3 * p < out.size(); ++p)
    for (std::size_t c = 0; c < 3; ++c)
    {
      double sum = 0;
      for (std::size_t k = 0; k < width; ++k)
        sum += phi[width * p + k] * x[3 * nodes[stride * p + k] + c];
      out[3 * p + c] = sum;
    }
}
} // namespace nts
