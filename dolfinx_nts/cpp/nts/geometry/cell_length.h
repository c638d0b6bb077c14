#pragma once

#include "nts/search/self_contact.h"

#include <algorithm>
#include <limits>
#include <numbers>

/// @brief Length of cells along their thinnest direction.
namespace nts
{
/// @brief Least eigenvalue of a symmetric matrix, by Cardano's formula: to
/// round-off of the greatest one.
inline double least_eigenvalue(Matrix<3, 3> A) noexcept
{
  const double mean = (A[0][0] + A[1][1] + A[2][2]) / 3;
  double squares = 0;
  for (std::size_t i = 0; i < 3; ++i)
  {
    A[i][i] -= mean;
    squares += dot(A[i], A[i]);
  }
  const double scale = std::sqrt(squares / 6);
  const double det = dot(A[0], cross(A[1], A[2]));
  const double cosine = det
                        / std::max(2 * scale * scale * scale,
                                   std::numeric_limits<double>::min());
  const double angle = std::acos(std::clamp(cosine, -1., 1.)) / 3;
  return mean + 2 * scale * std::cos(angle + 2 * std::numbers::pi / 3);
}

/// @brief Twice the least radius of gyration of the nodes of each cell.
/// @param[in] x Positions of the nodes of the mesh, (n, d) [m].
/// @param[in] d Coordinates of a node, 2 or 3.
/// @param[in] cells Nodes of each cell, (c, k).
/// @param[in] k Nodes of a cell.
/// @param[out] length (c,) [m], 0 where round-off would make its square
/// negative.
inline void cell_lengths(std::span<const double> x, std::size_t d,
                         std::span<const std::int32_t> cells, std::size_t k,
                         std::span<double> length) noexcept
{
  for (std::size_t c = 0; c < length.size(); ++c)
  {
    const auto nodes = cells.subspan(k * c, k);
    const auto position = [&](std::size_t node) noexcept
    {
      return Vec3{x[d * node], x[d * node + 1], d == 3 ? x[d * node + 2] : 0};
    };
    Vec3 centre = {};
    for (const std::int32_t node : nodes)
      centre += (1. / k) * position(node);
    Matrix<3, 3> moments = {};
    for (const std::int32_t node : nodes)
    {
      const Vec3 r = position(node) - centre;
      for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j)
          moments[i][j] += r[i] * r[j] / k;
    }
    if (d == 2) // greater than in any direction of the plane
      moments[2][2] = moments[0][0] + moments[1][1];
    length[c] = 2 * std::sqrt(std::max(least_eigenvalue(moments), 0.));
  }
}
} // namespace nts
