#pragma once

#include "nts/geometry/small.h"

#include <algorithm>
#include <cstdint>
#include <span>
#include <type_traits>

/// @brief Rows of numbers: copies, and sums, each in one pass.
namespace nts
{
/// @brief Row i of x, (n, D), with zeros up to three numbers.
template <std::size_t D>
Vec3 in_space(std::span<const double> x, std::size_t i) noexcept
{
  Vec3 row = {};
  std::copy_n(x.data() + D * i, D, row.begin());
  return row;
}

/// @brief Copy rows of three numbers to rows of two, or rows of two to rows of
/// three, padded with zeros.
/// @param[in] x (n, 5 - D)
/// @param[out] out (n, D)
template <std::size_t D>
void change_components(std::span<const double> x,
                       std::span<double> out) noexcept
{
  constexpr std::size_t before = 5 - D;
  for (std::size_t i = 0; i < out.size() / D; ++i)
  {
    out[D * i] = x[before * i];
    out[D * i + 1] = x[before * i + 1];
    if constexpr (D == 3)
      out[D * i + 2] = 0;
  }
}

/// @brief Copy selected rows of x in a given order.
/// @param[in] x Rows of w numbers, (n, w).
/// @param[in] rows Their numbers, (r,).
/// @param[out] out These rows, (r, w).
inline void take_rows(std::span<const double> x,
                      std::span<const std::int64_t> rows,
                      std::span<double> out) noexcept
{
  // Rows are prefetched while others are copied.
  constexpr std::size_t ahead = 24;
  const std::size_t width = rows.empty() ? 0 : out.size() / rows.size();
  const auto copy = [&](auto w)
  {
    for (std::size_t i = 0; i < rows.size(); ++i)
    {
      if (i + ahead < rows.size())
        __builtin_prefetch(x.data() + w * rows[i + ahead]);
      std::copy_n(x.data() + w * rows[i], w, out.data() + w * i);
    }
  };
  // A loop of known length is vectorised.
  if (width == 3)
    copy(std::integral_constant<std::size_t, 3>());
  else
    copy(width);
}

/// @brief Sum of vectors and of their moments about the origin.
struct Resultant
{
  Vec3 sum = {}, moment = {};

  void add(const Vec3& x, const Vec3& vector) noexcept
  {
    sum += vector;
    moment += cross(x, vector);
  }
};

/// @brief Resultant of vectors (r, 3) at rows (r,) of x, (n, 3).
inline Resultant resultant(std::span<const double> x,
                           std::span<const std::int32_t> rows,
                           std::span<const double> vectors) noexcept
{
  Resultant total;
  for (std::size_t i = 0; i < rows.size(); ++i)
    total.add(vector(x, rows[i]), vector(vectors, i));
  return total;
}

/// @brief Kinetic energy and resultant of momenta.
struct MotionSums
{
  double energy = 0;
  Resultant momentum = {};
};

/// @brief Sums of n nodes at the first rows of x, (l, 3), by their momenta and
/// velocities, (n, D).
template <std::size_t D>
MotionSums motion_sums(std::span<const double> x, std::span<const double> p,
                       std::span<const double> v) noexcept
{
  MotionSums sums;
  for (std::size_t i = 0; i < p.size() / D; ++i)
  {
    const Vec3 momentum = in_space<D>(p, i);
    sums.energy += dot(in_space<D>(v, i), momentum) / 2;
    sums.momentum.add(vector(x, i), momentum);
  }
  return sums;
}
} // namespace nts
