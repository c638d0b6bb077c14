#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

/// @brief Both halves of a step of velocity Verlet, each in one pass.
namespace nts
{
/// @brief Move all dofs, D of each node, by the velocity in the middle of the
/// step.
/// @param[in] dt Length of the step [s].
/// @param[in] v Velocity at its start, (d,) [m/s].
/// @param[in] a Acceleration at its start, (d,) [m/s^2].
/// @param[out] rate Velocity in the middle, (d,) [m/s].
/// @param[in,out] u Displacement, (d,) [m].
/// @param[out] du Change of the displacement, (d,) [m].
/// @return Largest displacement of a node, NaN if one is NaN [m].
template <std::size_t D>
double drift(double dt, std::span<const double> v, std::span<const double> a,
             std::span<double> rate, std::span<double> u,
             std::span<double> du) noexcept
{
  std::uint64_t most = 0; // as integers, NaN is above all numbers
  for (std::size_t node = 0; node < rate.size(); node += D)
  {
    double square = 0;
    for (std::size_t i = node; i < node + D; ++i)
    {
      const double start = u[i];
      rate[i] = v[i] + dt / 2 * a[i];
      u[i] += dt * rate[i];
      du[i] = u[i] - start;
      square += du[i] * du[i];
    }
    most = std::max(most, std::bit_cast<std::uint64_t>(square));
  }
  return std::sqrt(std::bit_cast<double>(most));
}

/// @brief Accelerate all dofs to the end of the step.
/// @param[in] dt Length of the step [s].
/// @param[in] mobility 1/mass, 0 where the displacement is given, (d,) [1/kg].
/// @param[in] force Force at the end, (d,) [N].
/// @param[out] a Acceleration at the end, (d,) [m/s^2].
/// @param[in,out] rate Velocity in the middle, then at the end, (d,) [m/s].
/// @return Sum of force times a [W/s].
inline double kick(double dt, std::span<const double> mobility,
                   std::span<const double> force, std::span<double> a,
                   std::span<double> rate) noexcept
{
  double power = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
  {
    a[i] = mobility[i] * force[i];
    rate[i] += dt / 2 * a[i];
    power += force[i] * a[i];
  }
  return power;
}
} // namespace nts
