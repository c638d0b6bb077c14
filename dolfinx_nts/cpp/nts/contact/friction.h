#pragma once

#include "nts/geometry/small.h"

#include <limits>
#include <span>

/// @brief Friction of a node by multipliers, without springs.
namespace nts
{
/// @brief Linear model of a traction, t = fixed + p direction + stiffness dg.
struct TractionModel
{
  Vec2 fixed = {};             ///< part independent of p [N]
  Vec2 direction = {};         ///< factor of the normal force p [-]
  Matrix<2, 2> stiffness = {}; ///< derivative w.r.t. the slip [N/m]
};

/// @brief Largest traction of a node, and its derivatives.
struct FrictionLimit
{
  double force;   ///< linear in p where p < 0 [N]
  double by_p;    ///< derivative w.r.t. the normal force [-]
  double by_slip; ///< derivative w.r.t. the length of the slip [N/m]
};

/// @brief Rotation of components from one frame to another: the orthogonal
/// matrix nearest to the products of both.
/// @param[in] to, from Two orthonormal tangents of either handedness, rows.
inline Matrix<2, 2> between_frames(const double* to,
                                   const double* from) noexcept
{
  Matrix<2, 2> turn;
  for (std::size_t a = 0; a < 2; ++a)
    for (std::size_t b = 0; b < 2; ++b)
      turn[a][b] = inner<3>(to + 3 * a, from + 3 * b);
  const double sign = det(turn) < 0 ? -1 : 1;
  const double c = turn[0][0] + sign * turn[1][1],
               s = turn[0][1] - sign * turn[1][0];
  const double size = std::hypot(c, s);
  return {{{c / size, s / size}, {-sign * s / size, sign * c / size}}};
}

/// @brief Whether a node slides in this iteration.
/// @param[in] limit Largest traction [N].
/// @param[in] trial Trial traction of a sticking node [N].
/// @param[in] motion Direction of slip, as a traction or a slip increment.
/// @param[in] heading Direction of the traction, of any length.
/// @param[in] slid Whether the node slid in the last iteration; it then sticks
/// before its slip reverses.
inline bool slides(double limit, const Vec2& trial, const Vec2& motion,
                   const Vec2& heading, bool slid) noexcept
{
  const double size = std::sqrt(trial[0] * trial[0] + trial[1] * trial[1]);
  const bool reverses
      = slid && heading[0] * motion[0] + heading[1] * motion[1] < 0;
  return size > std::max(limit, 0.) && !reverses;
}

/// @brief The first of two vectors that is not zero.
inline const Vec2& first_direction(const Vec2& a, const Vec2& b) noexcept
{
  return a[0] != 0 || a[1] != 0 ? a : b;
}

/// @brief Whether a trial traction equals its limit up to round-off.
/// @param[in] limit Largest traction [N].
/// @param[in] trial Trial traction of a sticking node [N].
/// @param[in] rounding Force that counts as round-off [N].
inline bool is_at_limit(double limit, const Vec2& trial,
                        double rounding) noexcept
{
  const double size = std::sqrt(trial[0] * trial[0] + trial[1] * trial[1]);
  return std::abs(size - limit) <= rounding;
}

/// @brief Linearise stick and slip for one semismooth Newton iteration.
///
/// The condition t - min(1, L/|t + c g|) (t + c g) = 0 is linearised and
/// solved for t where the node slides along the traction.
/// @param[in] limit Limit L of the traction at this slip.
/// @param[in] t Traction of the last iteration [N].
/// @param[in] slip Slip g of the step [m].
/// @param[in] p Normal force [N].
/// @param[in] c Weight of the slip [N/m].
/// @param[in] heading Direction of the traction, of any length.
/// @param[in] slides Whether the node slides now.
inline TractionModel exact_friction(const FrictionLimit& limit, const Vec2& t,
                                    const Vec2& slip, double p, double c,
                                    const Vec2& heading, bool slides) noexcept
{
  // Bound on the stiffness against a change of the direction of slip, relative
  // to the weight [-]. Smaller: slower convergence of Newton's method at small
  // slips.
  constexpr double stiffest = 1e4;
  const double largest = std::max(limit.force, 0.);
  const bool turns = slides && largest > 0
                     && heading[0] * slip[0] + heading[1] * slip[1] >= 0;
  const Vec2 trial
      = turns ? Vec2{t[0] + c * slip[0], t[1] + c * slip[1]} : heading;
  double size = std::sqrt(trial[0] * trial[0] + trial[1] * trial[1]);
  if (size == 0)
    size = 1;
  const Vec2 s = {trial[0] / size, trial[1] / size};
  const Matrix<2, 2> across
      = {{{1 - s[0] * s[0], -s[0] * s[1]}, {-s[1] * s[0], 1 - s[1] * s[1]}}};
  double turn = 0;
  if (turns)
  {
    const double ratio = std::min(largest / size, 1.);
    turn = ratio == 1 ? stiffest : std::min(ratio / (1 - ratio), stiffest);
  }
  TractionModel model;
  const Vec2 turned = across * t;
  const double rest = slides ? limit.force - limit.by_p * p : 0;
  const double slope = turns ? limit.by_slip : 0;
  for (std::size_t i = 0; i < 2; ++i)
  {
    model.fixed[i] = rest * s[i] - turn * turned[i];
    model.direction[i] = slides ? limit.by_p * s[i] : 0;
    for (std::size_t j = 0; j < 2; ++j)
      model.stiffness[i][j] = turn * c * across[i][j] + slope * s[i] * s[j];
  }
  return model;
}

/// @brief Longest step along an increment from an interior point of a
/// second-order cone, relative to the increment; infinity if it never leaves
/// the cone.
/// @param[in] v, increment Vectors, component along the axis first.
inline double longest_in_cone(std::span<const double> v,
                              std::span<const double> increment) noexcept
{
  double across = 0, squares = 0, both = 0;
  for (std::size_t c = 1; c < v.size(); ++c)
  {
    across += v[c] * v[c];
    squares += increment[c] * increment[c];
    both += v[c] * increment[c];
  }
  const double tangential = std::sqrt(across);
  const double a = increment[0] * increment[0] - squares,
               b = v[0] * increment[0] - both,
               c = (v[0] - tangential) * (v[0] + tangential);
  const double under = b * b - a * c;
  const double divisor = std::sqrt(std::max(under, 0.)) - b;
  double longest = std::numeric_limits<double>::infinity();
  if (under >= 0 && divisor > 0)
    longest = c / divisor;
  if (increment[0] < 0)
    longest = std::min(longest, -v[0] / increment[0]);
  return longest;
}

/// @brief Multipliers of a node that balance the force on it: one along its
/// normal, 0 where the force per multiplier has no part along it, or one for
/// each component of the space.
/// @param[in] normal Normal of the node.
/// @param[in] force Force to be balanced [N].
/// @param[in] columns Forces on the node per multiplier, rows.
/// @param[in] rank Number of multipliers, 0, 1, 2 or 3; 0 as 1.
/// @param[in] known Tractions that are also balanced [N].
/// @param[in] direction Direction of the traction per normal force, -multiplier
/// [-].
/// @return NaN where a system is singular [N].
inline Vec3 balance(const Vec3& normal, Vec3 force, Matrix<3, 3> columns,
                    std::size_t rank, const Vec2& known,
                    const Vec2& direction) noexcept
{
  constexpr double least
      = 1e-3; // least component of the unit force per multiplier [-]
  for (std::size_t i = 0; i < 2; ++i)
    for (std::size_t j = 0; j < 3; ++j)
    {
      force[j] += known[i] * columns[i + 1][j];
      columns[0][j] -= direction[i] * columns[i + 1][j];
    }
  const auto all = [&]<std::size_t B>() -> Vec3
  {
    Matrix<B, B> A;
    Matrix<B, 1> x;
    for (std::size_t i = 0; i < B; ++i)
    {
      x[i][0] = -force[i];
      for (std::size_t j = 0; j < B; ++j)
        A[i][j] = columns[j][i];
    }
    if (!solve(A, x))
      return {NAN, NAN, NAN};
    Vec3 multipliers = {};
    for (std::size_t i = 0; i < B; ++i)
      multipliers[i] = x[i][0];
    return multipliers;
  };
  if (rank == 2)
    return all.template operator()<2>();
  if (rank == 3)
    return all.template operator()<3>();
  const double response = dot(normal, columns[0]);
  const bool responds = std::abs(response) > least;
  return {responds ? -dot(normal, force) / response : 0, 0, 0};
}
} // namespace nts
