#pragma once

#include "nts/solvers/constraint_products.h"

#include <cmath>
#include <numeric>

/// @brief Small sparse systems that are nearly diagonal, such as systems of
/// multipliers with dual shape functions.
namespace nts
{
/// @brief Rows of a sparse matrix, (n, n).
struct SparseRows
{
  std::span<const std::int64_t> start;  ///< (n + 1,)
  std::span<const std::int32_t> column; ///< columns, row by row
  std::span<const double> value;        ///< entries

  std::size_t size() const noexcept { return start.size() - 1; }

  /// @brief y = D^-1 A x with the diagonal D.
  void multiply(std::span<const double> diagonal, const std::vector<double>& x,
                std::vector<double>& y) const noexcept
  {
    for (std::size_t i = 0; i < size(); ++i)
    {
      double sum = 0;
      for (std::int64_t e = start[i]; e < start[i + 1]; ++e)
        sum += value[e] * x[column[e]];
      y[i] = sum / diagonal[i];
    }
  }
};

/// @brief Solve A x = b by BiCGStab with the diagonal as preconditioner, to
/// round-off.
/// @return False if it fails, as with a zero on the diagonal.
inline bool solve(const SparseRows& A, std::span<const double> b,
                  std::span<double> x)
{
  constexpr int max_iterations = 200;
  constexpr double accurate = 1e-15;
  const std::size_t n = A.size();
  std::vector<double> diagonal(n, 0.), r(n), p(n), s(n), v(n), t(n), y(n);
  for (std::size_t i = 0; i < n; ++i)
    for (std::int64_t e = A.start[i]; e < A.start[i + 1]; ++e)
      if (static_cast<std::size_t>(A.column[e]) == i)
        diagonal[i] += A.value[e];
  const auto inner
      = [n](const std::vector<double>& a, const std::vector<double>& c) noexcept
  {
    double sum = 0;
    for (std::size_t i = 0; i < n; ++i)
      sum += a[i] * c[i];
    return sum;
  };
  if (std::ranges::find(diagonal, 0.) != diagonal.end())
    return false;
  // Start from the solution of the diagonal system.
  for (std::size_t i = 0; i < n; ++i)
    y[i] = r[i] = b[i] / diagonal[i];
  const double scale = std::sqrt(inner(r, r));
  if (!std::isfinite(scale))
    return false;
  A.multiply(diagonal, y, v);
  for (std::size_t i = 0; i < n; ++i)
    r[i] -= v[i];
  const std::vector<double> shadow = r;
  p = r;
  double rho = inner(shadow, r);
  for (int iteration = 0;; ++iteration)
  {
    // Without an exception for NaN.
    if (std::islessequal(std::sqrt(inner(r, r)), accurate * scale))
      break;
    if (iteration == max_iterations)
      return false;
    A.multiply(diagonal, p, v);
    const double product = inner(shadow, v);
    if (product == 0 || rho == 0)
      return false;
    const double alpha = rho / product;
    for (std::size_t i = 0; i < n; ++i)
      s[i] = r[i] - alpha * v[i];
    A.multiply(diagonal, s, t);
    const double square = inner(t, t);
    const double omega = square > 0 ? inner(t, s) / square : 0;
    for (std::size_t i = 0; i < n; ++i)
    {
      y[i] += alpha * p[i] + omega * s[i];
      r[i] = s[i] - omega * t[i];
    }
    if (std::islessequal(std::sqrt(inner(r, r)), accurate * scale))
      break;
    if (omega == 0)
      return false;
    const double next = inner(shadow, r), beta = next / rho * (alpha / omega);
    rho = next;
    for (std::size_t i = 0; i < n; ++i)
      p[i] = r[i] + beta * (p[i] - omega * v[i]);
  }
  std::ranges::copy(y, x.begin());
  return std::ranges::all_of(y,
                             [](double value) { return std::isfinite(value); });
}

/// @brief Sparse system whose entries are given in any order. Its rows are
/// sorted, so that sums do not depend on the partition.
class SmallSystem
{
public:
  /// @param[in] number Numbers of rows and columns, in the order of right-hand
  /// sides and solutions.
  explicit SmallSystem(std::span<const std::int64_t> number)
      : _order(number.size()), _number(number.size()), _start(number.size() + 1)
  {
    std::iota(_order.begin(), _order.end(), 0);
    std::ranges::sort(_order, {}, [&](std::size_t i) { return number[i]; });
    std::ranges::transform(_order, _number.begin(),
                           [&](std::size_t i) { return number[i]; });
  }

  /// @brief Sort entries into rows, by counting.
  /// @param[in] row, column, value Entries, by the numbers.
  /// @return Whether all rows and columns are among the numbers.
  bool fill(std::span<const std::int64_t> row,
            std::span<const std::int64_t> column, std::span<const double> value)
  {
    std::vector<std::size_t> rows(row.size());
    for (std::size_t e = 0; e < row.size(); ++e)
    {
      // Entries come row by row.
      rows[e] = e > 0 && row[e] == row[e - 1] ? rows[e - 1] : find(row[e]);
      if (rows[e] == _number.size())
        return false;
      ++_start[rows[e] + 1];
    }
    std::partial_sum(_start.begin(), _start.end(), _start.begin());
    std::vector<std::int64_t> next(_start.begin(), _start.end());
    _column.resize(row.size());
    _value.resize(row.size());
    for (std::size_t e = 0; e < row.size(); ++e)
    {
      const std::size_t there = find(column[e]);
      if (there == _number.size())
        return false;
      _column[next[rows[e]]] = static_cast<std::int32_t>(there);
      _value[next[rows[e]]++] = value[e];
    }
    return true;
  }

  std::size_t size() const noexcept { return _number.size(); }

  /// @brief Solve for a right-hand side; x is NaN if it fails.
  void solve(std::span<const double> b, std::span<double> x) const
  {
    std::vector<double> sorted(size()), solution(size());
    for (std::size_t i = 0; i < size(); ++i)
      sorted[i] = b[_order[i]];
    if (!nts::solve({_start, _column, _value}, sorted, solution))
      std::ranges::fill(solution, NAN);
    for (std::size_t i = 0; i < size(); ++i)
      x[_order[i]] = solution[i];
  }

private:
  /// @brief Index of a number in the sorted list, or its size if the number is
  /// unknown.
  std::size_t find(std::int64_t wanted) const noexcept
  {
    const auto there = std::ranges::lower_bound(_number, wanted);
    return there != _number.end() && *there == wanted ? there - _number.begin()
                                                      : _number.size();
  }

  std::vector<std::size_t> _order;   // sorts the numbers
  std::vector<std::int64_t> _number; // ascending
  std::vector<std::int64_t> _start;  // rows, see `SparseRows`
  std::vector<std::int32_t> _column;
  std::vector<double> _value;
};
} // namespace nts
