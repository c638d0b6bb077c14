#pragma once

#include "nts/geometry/box.h"

#include <vector>

/// @brief Boundaries that may overlap, by their bounding boxes.
namespace nts
{
/// @brief A boundary with points that may be inside another one.
struct OverlappingBoxes
{
  std::int32_t inner, outer; ///< numbers of the boundaries
  double depth;              ///< least relevant depth [m]
  Box region; ///< box around all points of the inner one with this depth
};

/// @brief Boundaries whose boxes overlap by more than a tolerance, in both
/// orders.
/// @param[in] boxes Box around the whole of each boundary (g).
/// @param[in] touch Tolerance of each boundary; of two, the smaller one applies
/// [m] (g).
/// @param[out] apart Distances of any two boxes, 0 where they overlap and
/// infinite on the diagonal (g, g) [m].
inline std::vector<OverlappingBoxes>
overlapping_boxes(std::span<const Box> boxes, std::span<const double> touch,
                  std::span<double> apart)
{
  const std::size_t n = boxes.size();
  std::vector<OverlappingBoxes> found;
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
    {
      const double depth = std::min(touch[i], touch[j]);
      const double between = i == j ? INFINITY : distance(boxes[i], boxes[j]);
      apart[n * i + j] = std::max(between, 0.);
      // A point deep in the outer boundary is as deep in its box.
      if (between < -depth)
        found.push_back({static_cast<std::int32_t>(i),
                         static_cast<std::int32_t>(j), depth,
                         part_inside(boxes[i], boxes[j], depth)});
    }
  return found;
}

/// @brief Bounds on the approach of boundaries to each other.
/// @param[in] displacements Box around the displacements of the nodes of each
/// boundary (g).
/// @param[out] nearer The bounds, 0 on the diagonal (g, g) [m].
inline void approach(std::span<const Box> displacements,
                     std::span<double> nearer) noexcept
{
  const std::size_t n = displacements.size();
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
    {
      const Box &a = displacements[i], &b = displacements[j];
      Vec3 apart;
      for (std::size_t c = 0; c < 3; ++c)
        apart[c] = std::min(b.lower[c] - a.upper[c], a.lower[c] - b.upper[c]);
      nearer[n * i + j] = i == j ? 0 : norm(apart);
    }
}
} // namespace nts
