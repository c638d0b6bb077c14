#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

/// @brief Volume ratios det F of deformed cells.
namespace nts
{
/// @brief A number of the deformed body, and the same of the reference.
using Both __attribute__((vector_size(2 * sizeof(double)))) = double;

/// @brief Shape functions of a cell at points of the reference cell.
template <std::size_t D>
struct ShapeFunctions
{
  std::span<const double> values;    ///< (q, k)
  std::span<const double> gradients; ///< (q, k, D)
  std::size_t points, nodes;         ///< q, k
  bool makes_rings;                  ///< whether cells stand for rings

  /// @brief Volumes of a cell per volume of the reference cell, of rings times
  /// the radius.
  /// @param[in] point Number of the point.
  /// @param[in] x Positions of the cell's nodes, (k,) [m].
  Both volumes(std::size_t point,
               std::span<const std::array<Both, D>> x) const noexcept
  {
    const double* value = &values[point * nodes];
    const double* gradient = &gradients[point * nodes * D];
    std::array<std::array<Both, D>, D> J = {};
    Both radius = {};
    for (std::size_t a = 0; a < nodes; ++a)
    {
      for (std::size_t i = 0; i < D; ++i)
        for (std::size_t j = 0; j < D; ++j)
          J[i][j] += gradient[D * a + i] * x[a][j];
      radius += value[a] * x[a][0];
    }
    const auto minor = [&](std::size_t i, std::size_t j)
    { return J[0][i] * J[1][j] - J[0][j] * J[1][i]; };
    if constexpr (D == 3)
      return minor(1, 2) * J[2][0] + minor(2, 0) * J[2][1]
             + minor(0, 1) * J[2][2];
    else
      return makes_rings ? radius * minor(0, 1) : minor(0, 1);
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
                               std::span<const std::int32_t> cells)
{
  VolumeRatio least;
  std::vector<std::array<Both, D>> nodes(shapes.nodes);
  for (std::size_t c = 0; c < cells.size() / shapes.nodes; ++c)
  {
    for (std::size_t a = 0; a < shapes.nodes; ++a)
      for (std::size_t i = 0; i < D; ++i)
      {
        const std::size_t place
            = 3 * static_cast<std::size_t>(cells[shapes.nodes * c + a]) + i;
        nodes[a][i] = Both{x[place], X[place]};
      }
    for (std::size_t q = 0; q < shapes.points; ++q)
    {
      const Both volumes = shapes.volumes(q, nodes);
      const double ratio = volumes[0] / volumes[1];
      if (!(ratio >= least.ratio))
        least = {ratio, static_cast<std::int64_t>(c)};
      if (std::isnan(ratio))
        return least;
    }
  }
  return least;
}
} // namespace nts
