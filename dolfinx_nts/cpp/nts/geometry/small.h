#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <utility>

/// @brief Linear algebra of fixed-size vectors and matrices for the kernels,
/// without allocation.
namespace nts
{
using Vec2 = std::array<double, 2>;
using Vec3 = std::array<double, 3>;

/// @brief Row-major R x C matrix.
template <std::size_t R, std::size_t C>
using Matrix = std::array<std::array<double, C>, R>;

/// @brief Row i of x, shape (n, 3).
constexpr Vec3 vector(std::span<const double> x, std::size_t i) noexcept
{
  return {x[3 * i], x[3 * i + 1], x[3 * i + 2]};
}

/// @brief Row i of x, shape (n, 2).
constexpr Vec2 vector2(std::span<const double> x, std::size_t i) noexcept
{
  return {x[2 * i], x[2 * i + 1]};
}

/// @brief Write values to row i of an array.
template <std::size_t N>
void store(const std::array<double, N>& values, std::span<double> out,
           std::size_t i) noexcept
{
  std::copy(values.begin(), values.end(), out.begin() + N * i);
}

template <std::size_t R, std::size_t C>
void store(const Matrix<R, C>& values, std::span<double> out,
           std::size_t i) noexcept
{
  for (std::size_t r = 0; r < R; ++r)
    store(values[r], out, R * i + r);
}

constexpr Vec2 operator+(const Vec2& a, const Vec2& b) noexcept
{
  return {a[0] + b[0], a[1] + b[1]};
}

constexpr Vec2 operator*(double s, const Vec2& a) noexcept
{
  return {s * a[0], s * a[1]};
}

constexpr Vec3 operator-(const Vec3& a, const Vec3& b) noexcept
{
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

constexpr Vec3 operator+(const Vec3& a, const Vec3& b) noexcept
{
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}

constexpr Vec3 operator*(double s, const Vec3& a) noexcept
{
  return {s * a[0], s * a[1], s * a[2]};
}

constexpr Vec3& operator+=(Vec3& a, const Vec3& b) noexcept
{
  for (std::size_t i = 0; i < 3; ++i)
    a[i] += b[i];
  return a;
}

constexpr double dot(const Vec3& a, const Vec3& b) noexcept
{
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

constexpr Vec3 cross(const Vec3& a, const Vec3& b) noexcept
{
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
          a[0] * b[1] - a[1] * b[0]};
}

/// @brief Inner product of N consecutive numbers.
template <std::size_t N>
double inner(const double* a, const double* b) noexcept
{
  double sum = 0;
  for (std::size_t i = 0; i < N; ++i)
    sum += a[i] * b[i];
  return sum;
}

inline double norm(const Vec3& a) noexcept { return std::sqrt(dot(a, a)); }

/// @brief Vector along z with the length of another vector.
inline Vec3 out_of_plane(const Vec3& a) noexcept { return {0, 0, norm(a)}; }

/// @brief Determinant of a 2 x 2 matrix.
constexpr double det(const Matrix<2, 2>& A) noexcept
{
  return A[0][0] * A[1][1] - A[0][1] * A[1][0];
}

/// @brief Product of a 2 x 2 matrix and a vector.
constexpr Vec2 operator*(const Matrix<2, 2>& A, const Vec2& b) noexcept
{
  return {A[0][0] * b[0] + A[0][1] * b[1], A[1][0] * b[0] + A[1][1] * b[1]};
}

/// @brief Inverse of a 2 x 2 matrix (the caller has checked `det`).
constexpr Matrix<2, 2> inverse(const Matrix<2, 2>& A) noexcept
{
  const double s = 1 / det(A);
  return {{{s * A[1][1], -s * A[0][1]}, {-s * A[1][0], s * A[0][0]}}};
}

/// @brief Solve A X = B in place by LU with partial pivoting.
/// @param[in,out] A Overwritten by its factors.
/// @param[in,out] B Right-hand sides, overwritten by X.
/// @return False if a pivot vanishes relative to the largest entry of its
/// column: unknowns may have different units.
template <std::size_t N, std::size_t M>
bool solve(Matrix<N, N>& A, Matrix<N, M>& B) noexcept
{
  constexpr double singular = 1e-15; // pivot relative to its column
  std::array<double, N> largest = {};
  for (const auto& row : A)
    for (std::size_t j = 0; j < N; ++j)
      largest[j] = std::max(largest[j], std::abs(row[j]));

  for (std::size_t k = 0; k < N; ++k)
  {
    std::size_t pivot = k;
    for (std::size_t i = k + 1; i < N; ++i)
      if (std::abs(A[i][k]) > std::abs(A[pivot][k]))
        pivot = i;
    if (!(std::abs(A[pivot][k]) > singular * largest[k]))
      return false;
    std::swap(A[k], A[pivot]);
    std::swap(B[k], B[pivot]);
    for (std::size_t i = k + 1; i < N; ++i)
    {
      const double factor = A[i][k] / A[k][k];
      for (std::size_t j = k + 1; j < N; ++j)
        A[i][j] -= factor * A[k][j];
      for (std::size_t j = 0; j < M; ++j)
        B[i][j] -= factor * B[k][j];
    }
  }
  for (std::size_t k = N; k-- > 0;)
    for (std::size_t j = 0; j < M; ++j)
    {
      for (std::size_t i = k + 1; i < N; ++i)
        B[k][j] -= A[k][i] * B[i][j];
      B[k][j] /= A[k][k];
    }
  return true;
}
} // namespace nts
