#pragma once

#include "nts/contact/friction.h"

#include <cstdint>
#include <optional>

/// @brief Friction of the nodes of a pair in one attempt at a step:
/// which of them slide, and a linear model of their tractions.
namespace nts
{
/// @brief sum += t[0] times the second of three rows + t[1] times the third.
/// @param[in] rows Along the normal and both tangents, (3, d).
inline void add_tangential(const Vec2& t, std::span<const double> rows,
                           std::span<double> sum) noexcept
{
  const std::size_t d = sum.size();
  for (std::size_t e = 0; e < d; ++e)
    sum[e] += t[0] * rows[d + e] + t[1] * rows[2 * d + e];
}

/// @brief Friction state of n nodes in arrays of the caller.
struct NodalFriction
{
  bool has_springs;
  std::span<const bool> on_axis;    ///< (n,) nodes without friction
  std::span<const double> rounding; ///< (n,) forces that count as round-off [N]
  std::span<bool> sliding;          ///< (n,)
  std::span<std::int32_t> flips;    ///< (n,) changes between stick and slip
  std::span<double> traction;       ///< (n, 2) [N]
  /// Models of tractions, (n, 2), (n, 2) and (n, 2, 2), see `TractionModel`.
  std::span<double> fixed, direction, stiffness;
  /// (n, 2) Directions of the models, including nodes with a lagged limit.
  std::span<double> heading;
  std::span<const double> present; ///< (n, 2) current slips [m]
  std::span<double> modelled; ///< (n, 2) slips at the last linearisation [m]
  /// (n, 2, 3) Tangents for the components of tractions and slips, 0 without a
  /// frame.
  std::span<double> frame;

  /// @brief Whether an active node sticks by tangential multipliers.
  bool is_held(std::size_t j, bool active) const noexcept
  {
    return active && !sliding[j] && !has_springs;
  }

  /// @brief Transform the state of a node to another frame.
  /// @param[in] to Two orthonormal tangents, rows (2, 3).
  void turn(std::size_t j, const double* to) noexcept
  {
    double* from = frame.data() + 6 * j;
    if (std::equal(to, to + 6, from))
      return;
    if (std::any_of(from, from + 6, [](double x) { return x != 0; }))
      turn_components(between_frames(to, from), j);
    std::copy_n(to, 6, from);
  }

  /// @brief Whether a node should slide, and in which direction its traction
  /// then acts.
  struct Judgement
  {
    bool slides;
    Vec2 heading;
  };

  /// @param[in] is_new Whether contact has just begun, so that the normal force
  /// is unknown.
  /// @param[in] limit Largest traction [N].
  /// @param[in] trial Trial traction of a sticking node [N].
  /// @param[in] motion Direction of slip, as a traction or a slip increment.
  Judgement judge(std::size_t j, bool is_new, double limit, const Vec2& trial,
                  const Vec2& motion) const noexcept
  {
    const bool slid = sliding[j];
    // With p < 0, which is possible in iterates, a traction points backwards.
    const Vec2 along
        = first_direction(vector2(slid ? heading : traction, j), motion);
    // At the limit, as under constant loads after sliding, round-off must not
    // determine the state. A node that a support holds along the normal has no
    // normal force, and slides.
    const bool is_open = is_new || is_at_limit(limit, trial, rounding[j]);
    const bool leaves
        = is_open ? slid : nts::slides(limit, trial, motion, along, slid);
    return {leaves || on_axis[j], along};
  }

  /// @brief Accept the state and the model of a node, and its traction if it
  /// slides or has springs.
  /// @param[in] p Normal force [N].
  /// @param[in] slip Slip at which the model was linearised [m].
  /// @param[in] lagging Normal force of a lagged limit [N], if any.
  void accept(std::size_t j, bool active, bool slides, double p,
              const Vec2& slip, TractionModel model,
              std::optional<double> lagging) noexcept
  {
    if (on_axis[j])
      model = {};
    store(model.direction, heading, j);
    if (lagging)
    {
      model.fixed = model.fixed + *lagging * model.direction;
      model.direction = {};
    }
    flips[j] += slides != sliding[j];
    sliding[j] = slides;
    store(slip, modelled, j);
    store(model.fixed, fixed, j);
    store(model.direction, direction, j);
    store(model.stiffness, stiffness, j);
    if (!active)
      store(Vec2{}, traction, j);
    else if (slides || has_springs)
      store(model.fixed + p * model.direction, traction, j);
  }

  /// @brief Part of the traction of a node that does not depend on the normal
  /// force, from its model at the current slip; 0 if it sticks.
  Vec2 known(std::size_t j, bool is_held) const noexcept
  {
    if (is_held)
      return {};
    const Vec2 t = vector2(fixed, j);
    if (has_springs)
      return t;
    const Vec2 change = vector2(present, j) + -1. * vector2(modelled, j);
    return t + stiffness_of(j) * change;
  }

  /// @brief Set the traction of a node from its multipliers.
  /// @param[in] rank Number of multipliers of the node.
  /// @param[in] multipliers Along the normal and both tangents [N].
  /// @param[in] known Traction that does not depend on the normal force [N].
  void balance(std::size_t j, bool active, std::int32_t rank,
               const Vec3& multipliers, const Vec2& known) noexcept
  {
    const auto& [normal, first, second] = multipliers;
    Vec2 t = {};
    if (active)
      t = rank > 1 ? Vec2{first, second}
                   : known + -normal * vector2(direction, j);
    store(t, traction, j);
  }

  /// @brief Derivative of the traction of a node with respect to its slip
  /// [N/m].
  Matrix<2, 2> stiffness_of(std::size_t j) const noexcept
  {
    return {vector2(stiffness, 2 * j), vector2(stiffness, 2 * j + 1)};
  }

private:
  void turn_components(const Matrix<2, 2>& turn, std::size_t j) noexcept
  {
    for (const std::span<double> part :
         {traction, fixed, direction, heading, modelled})
      store(turn * vector2(part, j), part, j);
    const Matrix<2, 2> K = stiffness_of(j);
    Matrix<2, 2> turned;
    // K is rotated in rows and columns.
    for (std::size_t a = 0; a < 2; ++a)
      turned[a] = turn
                  * Vec2{turn[a][0] * K[0][0] + turn[a][1] * K[1][0],
                         turn[a][0] * K[0][1] + turn[a][1] * K[1][1]};
    store(turned, stiffness, j);
  }
};
} // namespace nts
