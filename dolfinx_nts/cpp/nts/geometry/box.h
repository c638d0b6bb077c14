#pragma once

#include "nts/geometry/small.h"

#include <algorithm>
#include <cstdint>
#include <span>

/// @brief Axis-aligned boxes around points.
namespace nts
{
/// @brief Axis-aligned box.
struct Box
{
  Vec3 lower = {INFINITY, INFINITY, INFINITY};
  Vec3 upper = {-INFINITY, -INFINITY, -INFINITY};

  void include(const Vec3& point) noexcept
  {
    for (std::size_t i = 0; i < 3; ++i)
    {
      lower[i] = std::min(lower[i], point[i]);
      upper[i] = std::max(upper[i], point[i]);
    }
  }

  void include(const Box& box) noexcept
  {
    include(box.lower);
    include(box.upper);
  }

  void widen(double margin) noexcept
  {
    for (std::size_t i = 0; i < 3; ++i)
    {
      lower[i] -= margin;
      upper[i] += margin;
    }
  }

  /// @brief Whether it intersects another box.
  bool meets(const Box& other) const noexcept
  {
    for (std::size_t i = 0; i < 3; ++i)
      if (lower[i] > other.upper[i] || upper[i] < other.lower[i])
        return false;
    return true;
  }

  /// @brief Sides beyond which a point lies, a bit for each of the six.
  std::uint8_t sides_beyond(const Vec3& point) const noexcept
  {
    int sides = 0;
    for (std::size_t i = 0; i < 3; ++i)
      sides |= (point[i] < lower[i]) << i | (point[i] > upper[i]) << (i + 3);
    return static_cast<std::uint8_t>(sides);
  }

  /// @brief Whether a line segment between two points intersects the box.
  bool meets(const Vec3& begin, const Vec3& end) const noexcept
  {
    // Separating axes: coordinate axes, and their products with the line.
    const Vec3 half = 0.5 * (end - begin);
    const Vec3 apart = 0.5 * ((begin + end) - (lower + upper));
    const Vec3 extent = 0.5 * (upper - lower);
    const Vec3 turned = cross(half, apart);
    for (std::size_t i = 0; i < 3; ++i)
    {
      const std::size_t j = (i + 1) % 3, k = (i + 2) % 3;
      if (std::abs(apart[i]) > extent[i] + std::abs(half[i])
          || std::abs(turned[i]) > extent[j] * std::abs(half[k])
                                       + extent[k] * std::abs(half[j]))
        return false;
    }
    return true;
  }

  /// @brief Squared distance of a point to the box (0 inside).
  double squared_distance(const Vec3& point) const noexcept
  {
    double sum = 0;
    for (std::size_t i = 0; i < 3; ++i)
    {
      const double d = std::max({lower[i] - point[i], 0., point[i] - upper[i]});
      sum += d * d;
    }
    return sum;
  }
};

/// @brief Box of some rows of x, (n, 3).
inline Box bounds(std::span<const double> x,
                  std::span<const std::int32_t> rows) noexcept
{
  Box box;
  for (const std::int32_t row : rows)
    box.include(vector(x, row));
  return box;
}

/// @brief Distance of two boxes along the axis on which they are farthest apart
/// [m]; if they overlap, minus the least displacement that separates them.
inline double distance(const Box& a, const Box& b) noexcept
{
  double apart = -INFINITY;
  for (std::size_t i = 0; i < 3; ++i)
    apart = std::max({apart, a.lower[i] - b.upper[i], b.lower[i] - a.upper[i]});
  return apart;
}

/// @brief Part of a box that is inside another one by more than a depth [m].
inline Box part_inside(const Box& box, const Box& other, double depth) noexcept
{
  Box part;
  for (std::size_t i = 0; i < 3; ++i)
  {
    part.lower[i] = std::max(box.lower[i], other.lower[i] + depth);
    part.upper[i] = std::min(box.upper[i], other.upper[i] - depth);
  }
  return part;
}
} // namespace nts
