#pragma once

#include "nts/geometry/gap.h"
#include "nts/geometry/nodal_values.h"
#include "nts/search/self_contact.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

/// @brief Penalty springs of nodes that are paired with segments.
namespace nts
{
/// @brief Flat arrays of pairs of nodes and segments, see `Found`.
struct Paired
{
  std::span<const std::int32_t> node;    ///< local nodes, (c,)
  std::span<const std::int32_t> segment; ///< their segments or -1, (c,)
  std::span<const double> xi;            ///< coordinates, (c, 2) [-]
  std::span<const double> gap;           ///< NaN without segment, (c,) [m]
  std::span<const double> normal;        ///< unit normals, (c, 3)
};

/// @brief Positions of the pairs whose gap is negative, ascending.
inline std::vector<std::int32_t> inside(const Paired& pairs)
{
  std::vector<std::int32_t> positions;
  for (std::size_t i = 0; i < pairs.gap.size(); ++i)
    if (std::isless(pairs.gap[i], 0.)) // false without an exception for NaN
      positions.push_back(static_cast<std::int32_t>(i));
  return positions;
}

/// @brief Force and energy of the springs of some pairs.
/// @param[in] pairs The pairs.
/// @param[in] positions Indices of these pairs, (m,).
/// @param[in] segments Vertices of all segments, (s, k).
/// @param[in] stiffness Stiffness of the spring of each pair, (c,) [N/m].
/// @param[out] dofs Node and vertices, (m, 1 + k).
/// @param[out] force Force on each of these, (m, 1 + k, 3) [N].
/// @param[out] energy Energy of the springs, (m,) [J].
template <class S>
void penalty_forces(const Paired& pairs,
                    std::span<const std::int32_t> positions,
                    std::span<const std::int32_t> segments,
                    std::span<const double> stiffness,
                    std::span<std::int32_t> dofs, std::span<double> force,
                    std::span<double> energy) noexcept
{
  constexpr std::size_t k = S::vertices;
  for (std::size_t m = 0; m < positions.size(); ++m)
  {
    const std::size_t i = positions[m];
    Projection<S> p;
    p.xi = {pairs.xi[2 * i], pairs.xi[2 * i + 1]};
    p.normal = vector(pairs.normal, i);
    const double lambda = stiffness[i] * pairs.gap[i];
    const PairVector<S> gradient = gap_gradient(p);
    for (std::size_t d = 0; d < gradient.size(); ++d)
      force[gradient.size() * m + d] = -lambda * gradient[d];
    energy[m] = lambda * pairs.gap[i] / 2;
    dofs[(1 + k) * m] = pairs.node[i];
    for (std::size_t K = 0; K < k; ++K)
      dofs[(1 + k) * m + 1 + K] = segments[k * pairs.segment[i] + K];
  }
}

/// @brief Springs at one state, and a displacement. A node that is equally near
/// to several segments has a spring on each.
struct MovedSprings
{
  std::span<const std::int32_t> node; ///< numbers of nodes, ascending, (m,)
  std::span<const std::int64_t> key;  ///< their segments, (m,)
  std::span<const std::int32_t> dofs; ///< rows of du, (m, 1 + k)
  std::span<const double> force;      ///< on these rows, (m, 1 + k, 3) [N]
  std::span<const double> energy;     ///< stored, (m,) [J]
  std::span<const double> du;         ///< displacement, (l, 3) [m]

  /// @brief Work of the force of a spring [J].
  double work(std::size_t m) const noexcept
  {
    const std::size_t width = dofs.size() / node.size();
    double sum = 0;
    for (std::size_t a = width * m; a < width * (m + 1); ++a)
      sum += dot(vector(force, a), vector(du, dofs[a]));
    return sum;
  }

  /// @brief End of the range of springs that belong to the node of spring i.
  std::size_t end_of(std::int32_t number, std::size_t i) const noexcept
  {
    while (i < node.size() && node[i] == number)
      ++i;
    return i;
  }
};

/// @brief Work of the mean of two forces by cause: first the work that is
/// neither stored in springs nor dissipated.
/// @param[in] before, after Springs at the ends of a step.
/// @param[in] dissipation By friction at each node in the step, (n,) [J]; empty
/// if there is no friction.
/// @return Work of nodes that kept their segments, of new nodes, and of nodes
/// that changed segments; energy released by springs; minus the dissipation
/// [J].
inline std::array<double, 5>
work_by_cause(const MovedSprings& before, const MovedSprings& after,
              std::span<const double> dissipation) noexcept
{
  enum Cause
  {
    stayed,
    came,
    changed,
    springs,
    friction
  };
  std::array<double, 5> work = {};
  std::size_t i = 0, j = 0;
  while (i < before.node.size() || j < after.node.size())
  {
    constexpr std::int32_t none = std::numeric_limits<std::int32_t>::max();
    const std::int32_t number
        = std::min(i < before.node.size() ? before.node[i] : none,
                   j < after.node.size() ? after.node[j] : none);
    const std::size_t old = before.end_of(number, i);
    const std::size_t now = after.end_of(number, j);
    const bool same = old == i || now == j
                      || std::ranges::equal(before.key.subspan(i, old - i),
                                            after.key.subspan(j, now - j));
    double& sum = work[old == i ? came : same ? stayed : changed];
    sum += dissipation.empty() ? 0. : dissipation[number];
    for (; i < old; ++i)
    {
      sum += before.work(i) / 2 - before.energy[i];
      work[springs] += before.energy[i];
    }
    for (; j < now; ++j)
    {
      sum += after.work(j) / 2 + after.energy[j];
      work[springs] -= after.energy[j];
    }
  }
  for (const double energy : dissipation)
    work[friction] -= energy;
  return work;
}

/// @brief Add values, (r, B), to nodes, (r,), which may repeat.
template <std::size_t B>
void add_rows(const ChangedValues& total, std::span<const std::int32_t> nodes,
              std::span<const double> values) noexcept
{
  for (std::size_t i = 0; i < nodes.size(); ++i)
  {
    double* const sum = total[B * nodes[i]];
    for (std::size_t c = 0; c < B; ++c)
      sum[c] += values[B * i + c];
  }
}
} // namespace nts
