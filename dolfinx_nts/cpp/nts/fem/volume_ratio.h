#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

/// @brief Volume ratios det F of deformed cells.
namespace nts
{
/// @brief Numbers at two points of a cell.
using AtTwo __attribute__((vector_size(2 * sizeof(double)))) = double;

/// @brief Volumes of cells at points of the reference cell, by shape functions.
template <std::size_t D>
class CellVolumes
{
public:
  /// @param[in] values, gradients Shape functions, (q, k), (q, k, D).
  /// @param[in] points, nodes Numbers of points q and nodes k.
  /// @param[in] makes_rings Whether the mesh is axisymmetric.
  CellVolumes(std::span<const double> values, std::span<const double> gradients,
              std::size_t points, std::size_t nodes, bool makes_rings)
      : _points(points), _nodes(nodes), _makes_rings(makes_rings)
  {
    for (std::size_t q = 0; q < points; q += 2)
    {
      // With an odd number of points, the last one is repeated.
      const std::size_t r = std::min(q + 1, points - 1);
      const auto both
          = [&](std::span<const double> of, std::size_t width, std::size_t i)
      { return AtTwo{of[width * q + i], of[width * r + i]}; };
      for (std::size_t a = 0; a < nodes; ++a)
      {
        Shape shape{both(values, nodes, a), {}};
        for (std::size_t i = 0; i < D; ++i)
          shape.gradient[i] = both(gradients, nodes * D, D * a + i);
        _shapes.push_back(shape);
      }
    }
  }

  /// @brief Number of points.
  std::size_t points() const noexcept { return _points; }

  /// @brief Number of nodes of a cell.
  std::size_t nodes() const noexcept { return _nodes; }

  /// @brief Volumes per volume of the reference cell, times the radius in
  /// axisymmetric meshes.
  /// @param[in] x Positions of nodes, (n, 3) [m].
  /// @param[in] cell Rows of the nodes of a cell, (k,).
  /// @param[out] volumes At the points, (q,), plus one unused value if q is
  /// odd.
  void at(std::span<const double> x, std::span<const std::int32_t> cell,
          std::span<double> volumes) const noexcept
  {
    for (std::size_t q = 0; q < _points; q += 2)
    {
      std::array<std::array<AtTwo, D>, D> J = {};
      AtTwo radius = {};
      const Shape* shape = &_shapes[q / 2 * _nodes];
      for (std::size_t a = 0; a < _nodes; ++a, ++shape)
      {
        const double* position = &x[3 * static_cast<std::size_t>(cell[a])];
        for (std::size_t i = 0; i < D; ++i)
          for (std::size_t j = 0; j < D; ++j)
            J[i][j] += shape->gradient[i] * position[j];
        radius += shape->value * position[0];
      }
      const AtTwo both
          = _makes_rings ? radius * determinant(J) : determinant(J);
      volumes[q] = both[0];
      volumes[q + 1] = both[1];
    }
  }

private:
  /// @brief Value and gradient of the shape function of a node.
  struct Shape
  {
    AtTwo value;
    std::array<AtTwo, D> gradient;
  };

  static AtTwo
  determinant(const std::array<std::array<AtTwo, D>, D>& J) noexcept
  {
    const auto minor = [&](std::size_t i, std::size_t j)
    { return J[0][i] * J[1][j] - J[0][j] * J[1][i]; };
    if constexpr (D == 3)
      return minor(1, 2) * J[2][0] + minor(2, 0) * J[2][1]
             + minor(0, 1) * J[2][2];
    else
      return minor(0, 1);
  }

  std::size_t _points, _nodes;
  bool _makes_rings;
  std::vector<Shape> _shapes; // shape functions of the nodes at two points, at
                              // the next two, ...
};

/// @brief Compute the volumes of cells at their points.
/// @param[in] of Volumes at the quadrature points.
/// @param[in] x Positions of nodes, (n, 3) [m].
/// @param[in] cells Rows of the nodes of each cell, (c, k).
/// @param[in] visit Called with each cell and its volumes, (q,), until it
/// returns false.
template <std::size_t D, class Visit>
void each_cell(const CellVolumes<D>& of, std::span<const double> x,
               std::span<const std::int32_t> cells, Visit&& visit)
{
  std::vector<double> volumes(of.points() + 1);
  for (std::size_t c = 0; c < cells.size() / of.nodes(); ++c)
  {
    of.at(x, cells.subspan(of.nodes() * c, of.nodes()), volumes);
    if (!visit(c, std::span<const double>(volumes).first(of.points())))
      return;
  }
}

/// @brief Least volume ratio and its cell.
struct VolumeRatio
{
  double ratio = INFINITY; ///< det F [-]
  std::int64_t cell = -1;  ///< -1 without cells
};

/// @brief Find the least det F of all cells, or one that is NaN.
/// @param[in] of Volumes at the quadrature points.
/// @param[in] x Positions of nodes, (n, 3) [m].
/// @param[in] reference Volumes of the cells without deformation, (c, q).
/// @param[in] cells Rows of the nodes of each cell, (c, k).
template <std::size_t D>
VolumeRatio least_volume_ratio(const CellVolumes<D>& of,
                               std::span<const double> x,
                               std::span<const double> reference,
                               std::span<const std::int32_t> cells)
{
  VolumeRatio least;
  each_cell(of, x, cells,
            [&](std::size_t c, std::span<const double> volumes)
            {
              const double* before = &reference[of.points() * c];
              for (std::size_t q = 0; q < of.points(); ++q)
              {
                const double ratio = volumes[q] / before[q];
                if (!(ratio >= least.ratio))
                  least = {ratio, static_cast<std::int64_t>(c)};
                if (std::isnan(ratio))
                  return false;
              }
              return true;
            });
  return least;
}
} // namespace nts
