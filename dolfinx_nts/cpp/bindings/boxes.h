#pragma once

#include "array.h"
#include "nts/geometry/box.h"

namespace nts::bindings
{
/// @brief Smallest and negated largest coordinates of n boxes, (2, n, 3). Their
/// minimum over all ranks gives the boxes around all of them.
inline Out<double> extremes(const std::vector<Box>& boxes)
{
  const std::size_t n = boxes.size();
  auto least = create<double>({2, n, 3});
  for (std::size_t i = 0; i < n; ++i)
  {
    store(boxes[i].lower, view(least), i);
    store(-1. * boxes[i].upper, view(least), n + i);
  }
  return least;
}

/// @brief Boxes from their extremes, see `extremes`.
inline std::vector<Box> boxes_by_extremes(const Doubles& least)
{
  check("displacements", least, {2, any, 3});
  const std::size_t n = least.shape(1);
  std::vector<Box> boxes(n);
  for (std::size_t i = 0; i < n; ++i)
    boxes[i] = {vector(view(least), i), -1. * vector(view(least), n + i)};
  return boxes;
}

/// @brief Box number i from the corners of all boxes, (2, n, 3).
inline Box box_by_corners(const Doubles& corners, std::size_t i)
{
  return {vector(view(corners), i),
          vector(view(corners), corners.shape(1) + i)};
}
} // namespace nts::bindings
