#pragma once

#include "lanes.h"

/// @file
/// Trilinear functions at the 2 x 2 x 2 Gauss points, one direction after the
/// other, which takes a quarter of the operations of sums over all nodes. Node
/// x + 2 y + 4 z of the cell, point z + 2 y + 4 x.

namespace nts
{
/// @brief A trilinear function at the points. A derivative does not depend on
/// the coordinate along which it is taken.
struct Trilinear
{
  Lanes values[8]; ///< of point z + 2 y + 4 x
  Lanes dx[4];     ///< of points z + 2 y
  Lanes dy[4];     ///< of points z + 2 x
  Lanes dz[4];     ///< of points y + 2 x

  Lanes& value_at(int q) { return values[q]; }
  Lanes& dx_at(int q) { return dx[q & 3]; }
  Lanes& dy_at(int q) { return dy[(q & 1) + 2 * (q >> 2)]; }
  Lanes& dz_at(int q) { return dz[q >> 1]; }
};

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

/// @brief Values at the points and derivatives of a function.
///
/// Kernels call it for each component of each function; copies of it would
/// take a fifth to two fifths of the compilation and make them no faster.
/// @param[in] f Values at the nodes, each third number.
__attribute__((noinline)) static Trilinear at_points(const Lanes* f)
{
  Trilinear t;
  Lanes fz[2][2][2], dz[2][2]; // [x][y][point along z], [x][y]
  for (int x = 0; x < 2; ++x)
    for (int y = 0; y < 2; ++y)
    {
      const int i = 3 * (x + 2 * y);
      dz[x][y] = line(f[i], f[i + 12], fz[x][y][0], fz[x][y][1]);
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

/// @brief Transpose of `at_points`.
/// @param[in] t Weights of the values and derivatives.
/// @param[in,out] f Weights of the nodes, each third number, to which is added.
__attribute__((noinline)) static void add_to_nodes(const Trilinear& t, Lanes* f)
{
  Lanes fy[2][2][2] = {}, dy[2][2] = {}, dzy[2][2] = {};
  for (int i = 0; i < 2; ++i)
  {
    for (int z = 0; z < 2; ++z)
      add_line(t.values[z + 2 * i], t.values[z + 2 * i + 4], t.dx[z + 2 * i],
               fy[0][i][z], fy[1][i][z]);
    add_line(t.dy[i], t.dy[i + 2], Lanes{}, dy[0][i], dy[1][i]);
    add_line(t.dz[i], t.dz[i + 2], Lanes{}, dzy[0][i], dzy[1][i]);
  }
  Lanes fz[2][2][2] = {}, dz[2][2] = {};
  for (int x = 0; x < 2; ++x)
  {
    for (int z = 0; z < 2; ++z)
      add_line(fy[x][0][z], fy[x][1][z], dy[x][z], fz[x][0][z], fz[x][1][z]);
    add_line(dzy[x][0], dzy[x][1], Lanes{}, dz[x][0], dz[x][1]);
  }
  for (int x = 0; x < 2; ++x)
    for (int y = 0; y < 2; ++y)
    {
      const int i = 3 * (x + 2 * y);
      add_line(fz[x][y][0], fz[x][y][1], dz[x][y], f[i], f[i + 12]);
    }
}
} // namespace nts
