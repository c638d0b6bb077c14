#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

/// @brief Changes of constraints and contact tangent since factors were
/// computed, and the entries that factors need.
///
/// Results do not depend on the numbering of nodes, and so on the partition.
namespace nts
{
/// @brief Constraints with lists of nodes, see `Elimination`.
template <std::size_t B>
struct ConstraintLists
{
  std::span<const std::int64_t> start;
  std::span<const double> gradients, columns, slopes;

  std::size_t size() const noexcept { return start.size() - 1; }

  /// @brief Number of nodes in the list of constraint i.
  std::size_t length(std::size_t i) const noexcept
  {
    return static_cast<std::size_t>(start[i + 1] - start[i]);
  }

  /// @brief Row a of constraint i in gradients or columns, B numbers per node.
  const double* row(std::span<const double> rows, std::size_t i,
                    std::size_t a) const noexcept
  {
    return rows.data() + B * B * start[i] + B * a * length(i);
  }

  /// @brief S of constraint i, row by row.
  std::span<const double> slope(std::size_t i) const noexcept
  {
    return slopes.subspan(B * B * i, B * B);
  }

  bool has_slope(std::size_t i) const noexcept
  {
    return std::ranges::any_of(slope(i), [](double s) { return s != 0; });
  }
};

/// @brief Contribution F^T S G of the slopes to the tangent of each constrained
/// node, (m, B, B).
template <std::size_t B>
void slopes_at_nodes(const ConstraintLists<B>& lists,
                     std::span<double> parts) noexcept
{
  std::ranges::fill(parts, 0.);
  for (std::size_t i = 0; i < lists.size(); ++i)
    if (lists.has_slope(i))
      for (std::size_t c = 0; c < B; ++c)
        for (std::size_t b = 0; b < B; ++b)
        {
          double force = 0;
          for (std::size_t a = 0; a < B; ++a)
            force += lists.row(lists.columns, i, a)[c]
                     * lists.slope(i)[B * a + b];
          for (std::size_t d = 0; d < B; ++d)
            parts[B * (B * i + c) + d]
                += force * lists.row(lists.gradients, i, b)[d];
        }
}

/// @brief Number of m constraints whose nodes have changed, or an entry of
/// whose gradients has changed by more than a limit.
/// @param[in] same Whether the nodes are unchanged, (l,).
/// @param[in] now, before Gradients.
inline std::size_t num_moved(std::size_t m, std::span<const bool> same,
                             std::span<const double> now,
                             std::span<const double> before,
                             double limit) noexcept
{
  std::size_t count = 0;
  const std::size_t k = same.size() / m, n = now.size() / m;
  for (std::size_t i = 0; i < m; ++i)
  {
    bool moved = !std::ranges::all_of(same.subspan(k * i, k), std::identity{});
    for (std::size_t e = n * i; !moved && e < n * (i + 1); ++e)
      moved = std::abs(now[e] - before[e]) > limit;
    count += moved;
  }
  return count;
}

/// @brief Flags of nodes with entries of constraints above a size, or of
/// products F_a S_ab G_b above a stiffness, (l,). Constrained nodes are always
/// flagged.
/// @param[in] rank Number of constraints of each list, (m,).
template <std::size_t B>
void essential_nodes(const ConstraintLists<B>& lists,
                     std::span<const std::int32_t> rank, double size,
                     double stiffness, std::span<bool> keeps)
{
  using Rows = std::array<double, B>; // largest entries of the rows
  std::vector<Rows> forces, gradients;
  for (std::size_t i = 0; i < lists.size(); ++i)
  {
    const std::size_t length = lists.length(i);
    const auto constraints = static_cast<std::size_t>(rank[i]);
    const auto slope = lists.slope(i);
    const auto measure
        = [&](std::span<const double> rows, std::vector<Rows>& parts)
    {
      parts.assign(length, {});
      Rows whole = {};
      for (std::size_t a = 0; a < B; ++a)
        for (std::size_t e = 0; e < B * length; ++e)
        {
          double& part = parts[e / B][a];
          part = std::max(part, std::abs(lists.row(rows, i, a)[e]));
          whole[a] = std::max(whole[a], part);
        }
      return whole;
    };
    const Rows force = measure(lists.columns, forces),
               gradient = measure(lists.gradients, gradients);
    for (std::size_t K = 0; K < length; ++K)
    {
      bool keep = K == 0;
      for (std::size_t a = 0; a < constraints; ++a)
        keep = keep || std::max(forces[K][a], gradients[K][a]) > size;
      for (std::size_t a = 0; a < B; ++a)
        for (std::size_t b = 0; b < B; ++b)
          keep = keep
                 || std::abs(slope[B * a + b])
                            * std::max(forces[K][a] * gradient[b],
                                       force[a] * gradients[K][b])
                        > stiffness;
      keeps[lists.start[i] + K] = keep;
    }
  }
}
} // namespace nts
