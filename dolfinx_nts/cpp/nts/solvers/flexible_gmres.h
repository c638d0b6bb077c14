#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

/// @brief Kernels of flexible GMRES, which stores the preconditioned vectors
/// (Y. Saad, SIAM J. Sci. Comput. 14 (1993)).
namespace nts
{
namespace gmres
{
/// Number of entries processed for all vectors at a time, so that they stay in
/// the cache.
inline constexpr std::size_t block_size = 1024;
/// Number of independent partial sums, to hide the latency of additions.
inline constexpr std::size_t lanes = 8;

inline double inner(std::span<const double> a, const double* b) noexcept
{
  std::array<double, lanes> sum = {};
  std::size_t i = 0;
  for (; i + lanes <= a.size(); i += lanes)
    for (std::size_t lane = 0; lane < lanes; ++lane)
      sum[lane] += a[i + lane] * b[i + lane];
  for (; i < a.size(); ++i)
    sum[0] += a[i] * b[i];
  for (std::size_t half = lanes / 2; half > 0; half /= 2)
    for (std::size_t lane = 0; lane < half; ++lane)
      sum[lane] += sum[lane + half];
  return sum[0];
}
} // namespace gmres

/// @brief Inner products of w with vectors of its size, one after the other.
inline void products(std::span<const double* const> vectors,
                     std::span<const double> w,
                     std::span<double> result) noexcept
{
  std::ranges::fill(result, 0.0);
  for (std::size_t first = 0; first < w.size(); first += gmres::block_size)
  {
    const auto part
        = w.subspan(first, std::min(gmres::block_size, w.size() - first));
    for (std::size_t i = 0; i < vectors.size(); ++i)
      result[i] += gmres::inner(part, vectors[i] + first);
  }
}

/// @brief w <- w + sum of vectors with these factors.
/// @return Square of the norm of w.
inline double add(std::span<const double* const> vectors,
                  std::span<const double> factors, std::span<double> w) noexcept
{
  double square = 0;
  for (std::size_t first = 0; first < w.size(); first += gmres::block_size)
  {
    const auto part
        = w.subspan(first, std::min(gmres::block_size, w.size() - first));
    for (std::size_t i = 0; i < vectors.size(); ++i)
      for (std::size_t j = 0; j < part.size(); ++j)
        part[j] += factors[i] * vectors[i][first + j];
    square += gmres::inner(part, part.data());
  }
  return square;
}

/// @brief Least-squares problem with an upper Hessenberg matrix that grows by
/// columns, and a right-hand side whose first entry alone is not zero.
class HessenbergSystem
{
public:
  explicit HessenbergSystem(double right) : _right{right} {}

  /// @brief Residual of the solution.
  double residual() const noexcept { return std::abs(_right.back()); }

  /// @brief Append the next column, number k, which has k + 2 entries.
  void append(std::vector<double> column)
  {
    const std::size_t k = _columns.size();
    for (std::size_t i = 0; i < k; ++i)
      turn(_turns[i], column[i], column[i + 1]);
    const double length = std::hypot(column[k], column[k + 1]);
    _turns.push_back({column[k] / length, column[k + 1] / length});
    turn(_turns[k], column[k], column[k + 1]);
    _right.push_back(0);
    turn(_turns[k], _right[k], _right[k + 1]);
    _columns.push_back(std::move(column));
  }

  /// @brief The solution, a number for each column.
  std::vector<double> solution() const
  {
    std::vector<double> y(_right.begin(), _right.end() - 1);
    for (std::size_t k = y.size(); k-- > 0;)
    {
      y[k] /= _columns[k][k];
      for (std::size_t i = 0; i < k; ++i)
        y[i] -= _columns[k][i] * y[k];
    }
    return y;
  }

private:
  using Turn = std::array<double, 2>; // cosine and sine

  static void turn(const Turn& by, double& a, double& b) noexcept
  {
    const double first = by[0] * a + by[1] * b;
    b = by[0] * b - by[1] * a;
    a = first;
  }

  std::vector<std::vector<double>> _columns; // triangle columns, then 0
  std::vector<Turn> _turns;
  std::vector<double> _right;
};
} // namespace nts
