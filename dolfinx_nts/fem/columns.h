#pragma once

#include "lanes.h"

/// @file
/// Element matrices from kernels of linear forms, one SIMD lane per column.

namespace nts
{
/// @brief Add the matrix of a bilinear form on a cell.
///
/// @tparam rows Scalar dofs of the test function.
/// @tparam columns Scalar dofs of the trial function, which is a coefficient of
/// the kernel.
/// @tparam first Offset of this coefficient among the values of all
/// coefficients.
/// @tparam width Values of all functions.
/// @tparam coordinates Coordinates of all nodes of the geometry.
/// @param[in] kernel Kernel of the linear form.
/// @param[in,out] A Matrix, by rows.
/// @param[in] w Values of the other functions.
/// @param[in] c Constants.
/// @param[in] x Coordinates of the nodes.
template <int rows, int columns, int first, int width, int coordinates>
void add_columns(void (*kernel)(Lanes*, const Lanes*, const Real*,
                                const Lanes*),
                 double* A, const double* w, const double* c, const double* x)
{
  Lanes values[width] = {}, places[coordinates];
  for (int i = 0; i < first; ++i)
    values[i] = Lanes{} + w[i];
  for (int i = first + columns; i < width; ++i)
    values[i] = Lanes{} + w[i - columns];
  for (int i = 0; i < coordinates; ++i)
    places[i] = Lanes{} + x[i];
  for (int begin = 0; begin < columns; begin += num_lanes)
  {
    const int end = begin + num_lanes < columns ? begin + num_lanes : columns;
    for (int j = begin; j < end; ++j)
      values[first + j][j - begin] = 1;
    Lanes b[rows] = {};
    kernel(b, values, c, places);
    for (int i = 0; i < rows; ++i)
      for (int j = begin; j < end; ++j)
        A[i * columns + j] += b[i][j - begin];
    for (int j = begin; j < end; ++j)
      values[first + j] = Lanes{};
  }
}
} // namespace nts
