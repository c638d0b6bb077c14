#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

/// @brief Both halves of a step of velocity Verlet, each in one pass.
namespace nts
{
/// @brief Largest nodal displacements in a step [m].
struct Motion
{
  double farthest; ///< largest displacement, NaN if one is NaN
  double relative; ///< largest displacement relative to a given velocity
};

/// @brief Move all dofs, D of each node, by the velocity in the middle of the
/// step.
/// @param[in] dt Length of the step [s].
/// @param[in] v Velocity at its start, (d,) [m/s].
/// @param[in] a Acceleration at its start, (d,) [m/s^2].
/// @param[out] rate Velocity in the middle, (d,) [m/s].
/// @param[in,out] u Displacement, (d,) [m].
/// @param[out] du Change of the displacement, (d,) [m].
/// @param[in] about Reference velocity, (D,) [m/s].
/// @return Largest displacements, absolute and relative to this velocity.
template <std::size_t D>
Motion drift(double dt, std::span<const double> v, std::span<const double> a,
             std::span<double> rate, std::span<double> u, std::span<double> du,
             std::span<const double> about) noexcept
{
  std::array<double, D> common;
  for (std::size_t i = 0; i < D; ++i)
    common[i] = dt * about[i];
  // As integers, NaN is above all numbers.
  std::uint64_t most = 0, most_relative = 0;
  for (std::size_t node = 0; node < rate.size(); node += D)
  {
    double square = 0, relative = 0;
    for (std::size_t i = node; i < node + D; ++i)
    {
      const double start = u[i];
      rate[i] = v[i] + dt / 2 * a[i];
      u[i] += dt * rate[i];
      du[i] = u[i] - start;
      square += du[i] * du[i];
      const double other = du[i] - common[i - node];
      relative += other * other;
    }
    most = std::max(most, std::bit_cast<std::uint64_t>(square));
    most_relative
        = std::max(most_relative, std::bit_cast<std::uint64_t>(relative));
  }
  return {std::sqrt(std::bit_cast<double>(most)),
          std::sqrt(std::bit_cast<double>(most_relative))};
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
