#pragma once

#include "nts/geometry/segment.h"

/// @brief Intervals in the reference cell of an edge, the counterpart of the
/// polygons of facets in space, see `polygons.h`.
namespace nts
{
/// @brief Both ends of a part of [0, 1], or of the line on which it lies.
struct Interval : std::array<Vec2, 2>
{
};

/// @brief Signed length of an interval, the counterpart of the area of a
/// polygon.
inline double area(const Interval& interval) noexcept
{
  return interval[1][0] - interval[0][0];
}

/// @brief Part of an interval inside the reference cell; its length is 0 if
/// there is none.
inline Interval clipped(Interval interval) noexcept
{
  for (Vec2& end : interval)
    end[0] = std::clamp(end[0], 0., 1.);
  return interval;
}

/// @brief Whether an interval contains a point.
inline bool holds(const Interval& interval, const Vec2& xi) noexcept
{
  const auto [least, greatest] = std::minmax(interval[0][0], interval[1][0]);
  return least <= xi[0] && xi[0] <= greatest;
}

/// @brief Call add(xi, weight) for the points of a rule on an interval that is
/// exact for polynomials of degree 3.
template <class, class Add>
void integrate(const Interval& interval, Add&& add)
{
  static const double offset = std::sqrt(1. / 12);
  const double length = area(interval);
  for (const double a : {0.5 - offset, 0.5 + offset})
    add(Vec2{interval[0][0] + a * length, 0}, std::abs(length) / 2);
}
} // namespace nts
