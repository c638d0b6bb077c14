#pragma once

#include "nts/contact/convective_slip.h"
#include "nts/contact/simplex_gradient.h"
#include "nts/search/cached_tree.h"
#include "nts/search/self_contact.h"

/// @brief Loops over pairs and nodes. Arrays are flat, row-major and allocated
/// by the caller; every pair is independent of all others.
namespace nts
{
/// @brief Position of the node of pair number i of x, shape (m, 1 + k, 3).
template <class S>
Vec3 node_of(std::span<const double> x, std::size_t i) noexcept
{
  return vector(x, (1 + S::vertices) * i);
}

/// @brief Pair number i of x, shape (m, 1 + k, 3), about an origin near it.
///
/// Results do not depend on the origin, but differences of positions would lose
/// digits if it were far away.
template <class S>
Pair<S> load(std::span<const double> x, std::size_t i,
             const Vec3& origin) noexcept
{
  Pair<S> pair;
  pair.node = node_of<S>(x, i) - origin;
  for (std::size_t K = 0; K < S::vertices; ++K)
    pair.segment[K] = vector(x, (1 + S::vertices) * i + 1 + K) - origin;
  return pair;
}

/// @brief Output of the contact batch, sizes as in `Contact` times m.
struct ContactArrays
{
  std::span<double> gap_n, gap, force, gradient, tangent, turn;
};

/// @brief Schemes, which differ in the contact force of a step.
enum class Scheme
{
  midpoint,
  conserving,
  statics
};

/// @brief Contact of m pairs in one step; invalid pairs are filled with NaN.
template <class S, Scheme scheme>
void contact(std::span<const double> x_pair_n, std::span<const double> x_pair,
             std::span<const double> orientation,
             const ContactArrays& out) noexcept
{
  for (std::size_t i = 0; i < orientation.size(); ++i)
  {
    Contact<S> c;
    const Vec3 origin = node_of<S>(x_pair_n, i);
    const Pair<S> pair_n = load<S>(x_pair_n, i, origin),
                  pair = load<S>(x_pair, i, origin);
    if constexpr (scheme == Scheme::conserving)
      contact_conserving(pair_n, pair, orientation[i], c);
    else if constexpr (scheme == Scheme::midpoint)
      contact_midpoint(pair_n, pair, orientation[i], c);
    else
      contact_static(pair_n, pair, orientation[i], c);
    if (!c.valid)
    {
      c.gap_n = c.gap = c.turn = NAN;
      c.force.fill(NAN);
      c.gradient.fill(NAN);
      for (PairVector<S>& row : c.tangent)
        row.fill(NAN);
    }
    out.gap_n[i] = c.gap_n;
    out.gap[i] = c.gap;
    out.turn[i] = c.turn;
    store(c.force, out.force, i);
    store(c.gradient, out.gradient, i);
    store(c.tangent, out.tangent, i);
  }
}

/// @brief Output of the slip batch, sizes as in `Slip` times m.
struct SlipArrays
{
  std::span<double> value, force, gradient, w, b, frame_n, frame;
};

/// @brief Slip of m pairs in one step; NaN where a projection fails.
template <class S>
void slips(std::span<const double> x_pair_n, std::span<const double> x_pair,
           std::span<const double> orientation, const SlipArrays& out) noexcept
{
  for (std::size_t i = 0; i < orientation.size(); ++i)
  {
    const Vec3 origin = node_of<S>(x_pair_n, i);
    const Pair<S> pair_n = load<S>(x_pair_n, i, origin),
                  pair = load<S>(x_pair, i, origin);
    const Projection<S> p_n = project(pair_n, orientation[i]);
    const Projection<S> p = project(pair, orientation[i]);
    Slip<S> s;
    if (p_n.converged && p.converged)
      s = slip(pair_n, pair, p_n, p);
    else
      s.value = {NAN, NAN};
    store(s.value, out.value, i);
    store(s.force, out.force, i);
    store(s.gradient, out.gradient, i);
    store(s.w, out.w, i);
    store(s.b, out.b, i);
    store(s.frame_n, out.frame_n, i);
    store(s.frame, out.frame, i);
  }
}

/// @brief Output of the convective slip batch, sizes as in
/// `ConvectiveSlip` times m.
struct ConvectiveSlipArrays
{
  std::span<double> value, force, gradient, hessian, frame_n, frame;
};

/// @brief Convective slip of m pairs in one step; NaN where it fails.
template <class S>
void convective_slips(std::span<const double> x_pair_n,
                      std::span<const double> x_pair,
                      std::span<const double> orientation,
                      const ConvectiveSlipArrays& out) noexcept
{
  for (std::size_t i = 0; i < orientation.size(); ++i)
  {
    const Vec3 origin = node_of<S>(x_pair_n, i);
    ConvectiveSlip<S> s
        = convective_slip(load<S>(x_pair_n, i, origin),
                          load<S>(x_pair, i, origin), orientation[i]);
    if (!s.valid)
      s.value = {NAN, NAN};
    store(s.value, out.value, i);
    store(s.force, out.force, i);
    store(s.gradient, out.gradient, i);
    for (std::size_t c = 0; c < 2; ++c)
      store(s.hessian[c], out.hessian, 2 * i + c);
    store(s.frame_n, out.frame_n, i);
    store(s.frame, out.frame, i);
  }
}

/// @brief Find the segment of every node.
/// @param[in] x_node Positions, (n, 3) [m].
/// @param[in] current Segment of the previous choice or -1, (n,).
/// @param[in] slack See `find_segment`.
/// @param[in] reach Search radius [m].
/// @param[in] surface The segments.
/// @param[in] tree Returns the tree over the segments; called only if needed.
/// @param[in] may_touch Returns admissible directions, see `find_segment`.
/// @param[in] first Returns the first segment of the search of a node, see
/// `find_segment`.
/// @param[out] segment, xi, gap, normal See `Found`.
template <class S, class GetTree, class MayTouch, class First>
void pair_nodes(std::span<const double> x_node,
                std::span<const std::int32_t> current, double slack,
                double reach, const SegmentSurface<S>& surface,
                const GetTree& tree, const MayTouch& may_touch,
                const First& first, std::span<std::int32_t> segment,
                std::span<double> xi, std::span<double> gap,
                std::span<double> normal)
{
  const Tree* present = nullptr;
  const auto get_tree = [&]() -> const Tree&
  { return present ? *present : *(present = &tree()); };
  for (std::size_t i = 0; i < current.size(); ++i)
  {
    const Found found
        = find_segment(vector(x_node, i), current[i], slack, reach, surface,
                       get_tree, may_touch(i), first(i));
    segment[i] = found.segment;
    gap[i] = found.gap;
    store(found.xi, xi, i);
    store(found.normal, normal, i);
  }
}
} // namespace nts
