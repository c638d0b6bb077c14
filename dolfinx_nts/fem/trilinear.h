#pragma once

#include "lanes.h"
#include "line.h"

/// @file
/// Trilinear functions at the 2 x 2 x 2 Gauss points by sum factorisation, with
/// a quarter of the operations of sums over all nodes. Node x + 2 y + 4 z of
/// the cell, point z + 2 y + 4 x.

namespace nts
{
/// @brief A trilinear function at the points. A derivative does not depend on
/// the coordinate along which it is taken.
struct Trilinear
{
  /// @brief Function with these values at the nodes, each S-th number.
  template <int S>
  static Trilinear of(const Lanes* f);

  /// @brief Transpose of `of`: this has weights of the values and derivatives.
  /// @param[in,out] f Weights of the nodes, to which is added.
  template <int S>
  void add_to(Lanes* f) const;

  Lanes values[8]; ///< of point z + 2 y + 4 x
  Lanes dx[4];     ///< of points z + 2 y
  Lanes dy[4];     ///< of points z + 2 x
  Lanes dz[4];     ///< of points y + 2 x

  Lanes& value_at(int q) { return values[q]; }
  Lanes& dx_at(int q) { return dx[q & 3]; }
  Lanes& dy_at(int q) { return dy[(q & 1) + 2 * (q >> 2)]; }
  Lanes& dz_at(int q) { return dz[q >> 1]; }
};

// Not inlined: kernels call it for each component of each function, and copies
// would take 20 to 40 % of the compile time without being faster.
template <int S>
__attribute__((noinline)) Trilinear Trilinear::of(const Lanes* f)
{
  Trilinear t;
  Lanes fz[2][2][2], dz[2][2]; // [x][y][point along z], [x][y]
  for (int x = 0; x < 2; ++x)
    for (int y = 0; y < 2; ++y)
    {
      const int i = S * (x + 2 * y);
      dz[x][y] = line(f[i], f[i + 4 * S], fz[x][y][0], fz[x][y][1]);
    }
  Lanes fy[2][2][2], dy[2][2], dzy[2][2]; // [x][point along y][along z], ...
  for (int x = 0; x < 2; ++x)
  {
    for (int z = 0; z < 2; ++z)
      dy[x][z] = line(fz[x][0][z], fz[x][1][z], fy[x][0][z], fy[x][1][z]);
    line(dz[x][0], dz[x][1], dzy[x][0], dzy[x][1]);
  }
  for (int i = 0; i < 2; ++i)
  {
    for (int z = 0; z < 2; ++z)
      t.dx[z + 2 * i] = line(fy[0][i][z], fy[1][i][z], t.values[z + 2 * i],
                             t.values[z + 2 * i + 4]);
    line(dy[0][i], dy[1][i], t.dy[i], t.dy[i + 2]);
    line(dzy[0][i], dzy[1][i], t.dz[i], t.dz[i + 2]);
  }
  return t;
}

template <int S>
__attribute__((noinline)) void Trilinear::add_to(Lanes* f) const
{
  Lanes fy[2][2][2] = {}, fdy[2][2] = {}, dzy[2][2] = {};
  for (int i = 0; i < 2; ++i)
  {
    for (int z = 0; z < 2; ++z)
      add_line(values[z + 2 * i], values[z + 2 * i + 4], dx[z + 2 * i],
               fy[0][i][z], fy[1][i][z]);
    add_line(dy[i], dy[i + 2], Lanes{}, fdy[0][i], fdy[1][i]);
    add_line(dz[i], dz[i + 2], Lanes{}, dzy[0][i], dzy[1][i]);
  }
  Lanes fz[2][2][2] = {}, fdz[2][2] = {};
  for (int x = 0; x < 2; ++x)
  {
    for (int z = 0; z < 2; ++z)
      add_line(fy[x][0][z], fy[x][1][z], fdy[x][z], fz[x][0][z], fz[x][1][z]);
    add_line(dzy[x][0], dzy[x][1], Lanes{}, fdz[x][0], fdz[x][1]);
  }
  for (int x = 0; x < 2; ++x)
    for (int y = 0; y < 2; ++y)
    {
      const int i = S * (x + 2 * y);
      add_line(fz[x][y][0], fz[x][y][1], fdz[x][y], f[i], f[i + 4 * S]);
    }
}
} // namespace nts
