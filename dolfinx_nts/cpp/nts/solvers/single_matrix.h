#pragma once

#include "nts/solvers/blocks.h"

namespace nts
{
/// @brief Rows of a sparse matrix with B x B blocks in single precision, for
/// products in preconditioners.
template <std::size_t B>
class SingleMatrix
{
public:
  explicit SingleMatrix(const BlockMatrix<B>& A)
      : _start(A.start.begin(), A.start.end())
  {
    _scale = power_of_two(largest(A.value));
    _rows.resize(A.column.size());
    for (std::size_t e = 0; e < A.column.size(); ++e)
    {
      _rows.put(e, A.column[e], A.block(e, _scale));
      _width = std::max(_width, static_cast<std::size_t>(A.column[e]) + 1);
    }
  }

  /// @brief y = A x.
  /// @param[in] x Values of all columns, (m, B), m at least `width`.
  /// @param[out] y Values of the rows, (n, B).
  void multiply(std::span<const double> x, std::span<double> y)
  {
    const double scale = power_of_two(largest(x));
    _x.resize(x.size());
    for (std::size_t i = 0; i < x.size(); ++i)
      _x[i] = without_dust(static_cast<float>(scale * x[i]));
    const double back = 1 / (_scale * scale);
    std::size_t e = 0;
    for (std::size_t i = 0; i < size(); ++i)
    {
      const Values sum = _rows.product(
          e, static_cast<std::size_t>(_start[i + 1]), _x.data());
      for (std::size_t c = 0; c < B; ++c)
        y[B * i + c] = back * static_cast<double>(sum[c]);
    }
  }

  /// @brief Number of rows.
  std::size_t size() const noexcept { return _start.size() - 1; }

  /// @brief One more than the last column that has a block.
  std::size_t width() const noexcept { return _width; }

private:
  double _scale = 1;
  std::size_t _width = 0;
  std::vector<std::int64_t> _start;
  PackedRows<B> _rows;
  std::vector<float> _x;
};
} // namespace nts
