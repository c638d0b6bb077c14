#pragma once

#include "nts/geometry/small.h"

#include <cstdint>
#include <span>

/// @brief Volume ratios det F of deformed cells.
namespace nts
{
/// @brief Shape functions of a cell at points of the reference cell.
template <std::size_t D>
struct ShapeFunctions
{
  std::span<const double> values;    ///< (q, k)
  std::span<const double> gradients; ///< (q, k, D)
  std::size_t points, nodes;         ///< q, k
  bool makes_rings;                  ///< whether cells stand for rings

  /// @brief Volume of a cell per volume of the reference cell, of rings times
  /// the radius.
  /// @param[in] point Number of the point.
  /// @param[in] x Positions, (n, 3) [m].
  /// @param[in] rows Those of the cell's nodes, (k,).
  double volume(std::size_t point, std::span<const double> x,
                std::span<const std::int32_t> rows) const noexcept
  {
    const double* value = &values[point * nodes];
    const double* gradient = &gradients[point * nodes * D];
    std::array<Vec3, 3> tangents = {};
    tangents[2][2] = D == 2;
    double radius = 0;
    for (std::size_t a = 0; a < nodes; ++a)
    {
      const Vec3 node = vector(x, rows[a]);
      for (std::size_t i = 0; i < D; ++i)
        tangents[i] += gradient[D * a + i] * node;
      radius += value[a] * node[0];
    }
    return (makes_rings ? radius : 1)
           * dot(cross(tangents[0], tangents[1]), tangents[2]);
  }
};

/// @brief A volume ratio, and the cell that has it.
struct VolumeRatio
{
  double ratio = INFINITY; ///< det F [-]
  std::int64_t cell = -1;  ///< -1 of no cell
};

/// @brief Find the least det F of all cells, or one that is NaN.
/// @param[in] shapes Shape functions at the points that count.
/// @param[in] x, X Deformed and reference positions of nodes, (n, 3) [m].
/// @param[in] cells Rows of the nodes of each cell, (c, k).
template <std::size_t D>
VolumeRatio least_volume_ratio(const ShapeFunctions<D>& shapes,
                               std::span<const double> x,
                               std::span<const double> X,
                               std::span<const std::int32_t> cells) noexcept
{
  VolumeRatio least;
  for (std::size_t c = 0; c < cells.size() / shapes.nodes; ++c)
  {
    const auto rows = cells.subspan(c * shapes.nodes, shapes.nodes);
    for (std::size_t q = 0; q < shapes.points; ++q)
    {
      const double ratio
          = shapes.volume(q, x, rows) / shapes.volume(q, X, rows);
      if (!(ratio >= least.ratio))
        least = {ratio, static_cast<std::int64_t>(c)};
      if (std::isnan(ratio))
        return least;
    }
  }
  return least;
}
} // namespace nts
