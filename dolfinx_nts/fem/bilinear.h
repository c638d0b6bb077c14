#pragma once

#include "lanes.h"
#include "line.h"

/// @file
/// Bilinear functions at the 2 x 2 Gauss points by sum factorisation, with a
/// third of the operations of sums over all nodes. Node x + 2 y of the cell,
/// point y + 2 x.

namespace nts
{
/// @brief A bilinear function at the points. A derivative does not depend on
/// the coordinate along which it is taken.
struct Bilinear
{
  /// @brief Function with these values at the nodes, each S-th number.
  template <int S>
  __attribute__((always_inline)) static Bilinear of(const Lanes* f)
  {
    Bilinear t;
    Lanes fy[2][2], dy[2]; // [x][point along y], [x]
    for (int x = 0; x < 2; ++x)
      dy[x] = line(f[S * x], f[S * (x + 2)], fy[x][0], fy[x][1]);
    for (int y = 0; y < 2; ++y)
      t.dx[y] = line(fy[0][y], fy[1][y], t.values[y], t.values[y + 2]);
    line(dy[0], dy[1], t.dy[0], t.dy[1]);
    return t;
  }

  /// @brief Transpose of `of`: this has weights of the values and derivatives.
  /// @param[in,out] f Weights of the nodes, to which is added.
  template <int S>
  __attribute__((always_inline)) void add_to(Lanes* f) const
  {
    Lanes fy[2][2] = {}, fdy[2] = {};
    for (int y = 0; y < 2; ++y)
      add_line(values[y], values[y + 2], dx[y], fy[0][y], fy[1][y]);
    add_line(dy[0], dy[1], Lanes{}, fdy[0], fdy[1]);
    for (int x = 0; x < 2; ++x)
      add_line(fy[x][0], fy[x][1], fdy[x], f[S * x], f[S * (x + 2)]);
  }

  Lanes values[4]; ///< of point y + 2 x
  Lanes dx[2];     ///< of points y
  Lanes dy[2];     ///< of points x

  Lanes& value_at(int q) { return values[q]; }
  Lanes& dx_at(int q) { return dx[q & 1]; }
  Lanes& dy_at(int q) { return dy[q >> 1]; }
};
} // namespace nts
