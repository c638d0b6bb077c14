#pragma once

#include "lanes.h"

/// @file
/// Linear functions at the two Gauss points of a line, for sum factorisation on
/// quadrilaterals and hexahedra.

namespace nts
{
constexpr Real gauss_points[2]
    = {0.21132486540518711775, 0.78867513459481288225};

/// @brief Line between two ends: difference, and values at both points.
__attribute__((always_inline)) inline Lanes line(Lanes begin, Lanes end,
                                                 Lanes& first, Lanes& second)
{
  const Lanes d = end - begin;
  first = begin + gauss_points[0] * d;
  second = begin + gauss_points[1] * d;
  return d;
}

/// @brief Transpose of `line`.
/// @param[in] first,second,d Weights of its results.
/// @param[in,out] begin,end Weights of the ends, to which is added.
__attribute__((always_inline)) inline void
add_line(Lanes first, Lanes second, Lanes d, Lanes& begin, Lanes& end)
{
  d += gauss_points[0] * first + gauss_points[1] * second;
  begin += first + second - d;
  end += d;
}
} // namespace nts
