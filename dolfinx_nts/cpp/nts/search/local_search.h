#pragma once

#include "nts/geometry/projection.h"
#include "nts/search/tree.h"

#include <limits>

/// @brief Local search: the segment that a node may touch.
namespace nts
{
/// @brief Tolerances of the local search, relative to the segment size [-].
struct LocalSearchRule
{
  /// Usual `slack`: a node keeps its segment while xi is at most this far
  /// outside. Smaller: nodes on an edge alternate between segments from step to
  /// step.
  static constexpr double hysteresis = 0.01;
  /// A node farther outside the nearest segment has no segment: it is beyond
  /// the rim of the surface.
  static constexpr double overhang = 0.15;
  /// Difference of distances that count as equal: far larger than round-off,
  /// and far smaller than relevant distances.
  static constexpr double tie = 1e-9;
  /// Depth below a segment from which on a node belongs to another side of the
  /// body, unless it penetrated initially, see `SegmentSurface::sunk`.
  static constexpr double depth = 0.5;
  /// Cosine of the angle between normals below which an edge is sharp [-].
  static constexpr double sharp = 0.86602540378443865; // 30 degrees
  /// Cosine below which a segment may overhang its neighbour [-]. It excludes
  /// right angles, which are frequent, with a margin for round-off.
  static constexpr double hanging = -0.1;
};

/// @brief Candidate segment of a node, and the projection on it.
struct Found
{
  std::int32_t segment = -1;     ///< -1 if none is near
  Vec2 xi = {NAN, NAN};          ///< convective coordinates [-]
  double gap = NAN;              ///< [m], > 0 open
  Vec3 normal = {NAN, NAN, NAN}; ///< unit normal, outward
};

/// @brief Segments of a surface, as input of the local search.
template <class S>
struct SegmentSurface
{
  std::span<const double> x;              ///< positions, (l, 3) [m]
  std::span<const std::int32_t> vertices; ///< rows of x, (s, k)
  std::span<const double> orientation;    ///< +1 or -1, (s,)
  std::span<const std::int64_t> key;      ///< the lowest wins a tie, (s,)
  double sunk = 0;       ///< depth of initially penetrating nodes [m], or 0
  bool in_dents = false; ///< whether nodes below concave edges keep a segment

  /// @brief Positions of the vertices of a segment.
  std::array<Vec3, S::vertices> segment(std::size_t i) const noexcept
  {
    std::array<Vec3, S::vertices> positions;
    for (std::size_t K = 0; K < S::vertices; ++K)
      positions[K] = vector(x, vertices[S::vertices * i + K]);
    return positions;
  }

  /// @brief Rows of the vertices of a segment.
  std::span<const std::int32_t> vertices_of(std::size_t i) const noexcept
  {
    return vertices.subspan(S::vertices * i, S::vertices);
  }

  /// @brief Bounding box of a segment.
  Box box(std::size_t i) const noexcept { return bounds(x, vertices_of(i)); }

  /// @brief Outward normal in the centre of a segment, of any length.
  Vec3 normal(std::size_t i) const noexcept
  {
    const auto positions = segment(i);
    const std::array<Vec3, 2> edge = S::directions(positions);
    const Vec3 mixed = combine(S::d2phi(), positions);
    return orientation[i]
           * cross(edge[0] + S::centre[1] * mixed,
                   edge[1] + S::centre[0] * mixed);
  }

  /// @brief Diameter of a segment [m].
  double size(std::size_t i) const noexcept { return diameter<S>(segment(i)); }

  /// @brief Whether the vertices of segment `other` are on average behind the
  /// plane of segment i with this normal, as beyond a convex edge of i.
  bool is_behind(std::size_t other, std::size_t i,
                 const Vec3& normal) const noexcept
  {
    double height = 0;
    for (std::size_t K = 0; K < S::vertices; ++K)
      height += dot(vector(x, vertices_of(other)[K])
                        - vector(x, vertices_of(i)[K]),
                    normal);
    return height < 0;
  }

  /// @brief Whether a node with this gap [m] is so deep below a segment that it
  /// belongs to another side of the body.
  bool is_too_deep(std::size_t i, double gap) const noexcept
  {
    return gap < 0 && gap < -std::max(LocalSearchRule::depth * size(i), sunk);
  }
};

/// @brief Default admissibility: a node may touch any segment.
struct Anything
{
  /// @brief Whether the node may stay with its segment, given the projection.
  template <class S>
  bool keeps(std::int32_t, const Projection<S>&) const noexcept
  {
    return true;
  }

  /// @brief Store the projection on the node's current segment.
  template <class S>
  void comes_from(const Projection<S>&) noexcept
  {
  }

  /// @brief Whether the node may touch a segment, given the projection.
  template <class S>
  bool touches(const Vec3&, std::int32_t, const Projection<S>&,
               const Tree&) const noexcept
  {
    return true;
  }

  /// @brief Whether a node in front of its segment may keep it.
  template <class S>
  bool stays(const Vec3&, std::int32_t, const Projection<S>&,
             const Tree&) const noexcept
  {
    return true;
  }

  /// @brief Whether any segment may be admissible for the node.
  bool faces_any(const Tree&) const noexcept { return true; }

  /// @brief Number of inadmissible segments that a query visits before it
  /// restricts itself to admissible branches of the tree.
  int patience() const noexcept { return std::numeric_limits<int>::max(); }

  /// @brief Whether the node may face a segment of a branch of the tree.
  bool enters(std::int32_t) const noexcept { return true; }

  /// @brief Whether to accept the nearest segment after the search.
  template <class S>
  bool confirms(const Projection<S>&, double, double) const noexcept
  {
    return true;
  }
};

/// @brief Nearest segments of a node on one side of it.
template <class S>
struct NearestOnSide
{
  std::int32_t segment = -1; ///< segment that the node gets
  Projection<S> projection;  ///< projection of the node on it
  double outside = INFINITY; ///< distance of the projection outside it [-]
  double height = 0;         ///< largest distance from one of their planes [m]
  int number = 0;            ///< number of equally near segments
};

/// @brief Whether a node is beyond a sharp convex edge of a segment.
///
/// It is then outside the segment, and in front of a segment that shares the
/// nearest edge point and turns away: no body lies beyond such an edge.
/// @param[in] node Position [m].
/// @param[in] i The segment.
/// @param[in] p Projection of the node on it.
/// @param[in] surface The segments.
/// @param[in] tree The tree over them.
template <class S>
bool is_beyond_sharp_edge(const Vec3& node, std::int32_t i,
                          const Projection<S>& p,
                          const SegmentSurface<S>& surface, const Tree& tree)
{
  if (S::outside(p.xi) <= LocalSearchRule::hysteresis)
    return false;
  constexpr double same
      = 1e-6; // distance of equal points, relative to a segment [-]
  const Vec3 there = nearest_of_edges<S>({node, surface.segment(i)});
  const double margin = same * surface.size(i);
  bool is_beyond = false;
  tree.nearest(there, margin,
               [&](std::int32_t other)
               {
                 const Pair<S> at = {there, surface.segment(other)};
                 const double sense = surface.orientation[other];
                 const Projection<S> edge = project(at, sense);
                 if (other != i && edge.converged && distance(at, edge) < margin
                     && dot(edge.normal, p.normal) < LocalSearchRule::sharp
                     && surface.is_behind(other, i, p.normal))
                   is_beyond
                       = is_beyond || dot(node - there, edge.normal) > margin;
                 return margin;
               });
  return is_beyond;
}

/// @brief Whether another segment continues the surface of a node's segment.
///
/// Both share a vertex, and none overhangs the other (`hanging`). A node over
/// the first, or slightly outside it, is then hardly behind the other.
template <class S>
bool continues(const Found& own, std::int32_t other,
               const SegmentSurface<S>& surface) noexcept
{
  const auto first = surface.vertices_of(own.segment),
             second = surface.vertices_of(other);
  if (std::ranges::find_first_of(first, second) == first.end())
    return false;
  const Vec3 normal = surface.normal(other);
  return dot(own.normal, normal) >= LocalSearchRule::hanging * norm(normal);
}

/// @brief Whether a node in front of its segment may have entered another part
/// of the surface: a nearer segment that is no continuation.
template <class S>
bool may_have_entered(const Vec3& node, const Found& own,
                      const SegmentSurface<S>& surface, const Tree& tree)
{
  bool may = false;
  tree.nearest(node, own.gap,
               [&](std::int32_t i)
               {
                 may = i != own.segment
                       && surface.box(i).squared_distance(node)
                              <= own.gap * own.gap
                       && !continues(own, i, surface);
                 return may ? NAN : own.gap;
               });
  return may;
}

/// @brief Find a node's segment.
///
/// A node keeps its current segment while it is over it. The exception is a
/// node in front of it that has entered another part of the surface: it is
/// behind its nearest segment, which does not continue the current one.
/// Otherwise the node gets the nearest segment. The lowest key wins a tie, as
/// at edges and vertices. At an edge sharper than a right angle a node may be
/// in front of one segment and behind another, both equally near; the side
/// with the larger distance from the planes counts. A node too far outside or
/// below the nearest segment (`overhang`, `depth`) has none. Nor has a node
/// behind it and beyond a sharp convex edge, unless its current segment is on
/// the same side of that edge: it did not pass the plane of the segment.
///
/// At concave edges (`in_dents`) a node may be above only one of the nearest
/// segments, or above none: it gets the segment that it is least outside of.
/// @param[in] node Position [m].
/// @param[in] current Segment of the previous choice, or -1.
/// @param[in] slack Distance of xi outside the current segment within which a
/// node keeps it [-]; if infinite, a node that keeps its segment skips the
/// search.
/// @param[in] reach Search radius [m].
/// @param[in] surface The segments.
/// @param[in] tree Returns the tree over the segments; called only if needed.
/// @param[in] may Admissible segments of the node, see `Anything`.
/// @param[in] first Probably near segment with which the search begins, to save
/// time, or -1.
template <class S, class GetTree, class May = Anything>
Found find_segment(const Vec3& node, std::int32_t current, double slack,
                   double reach, const SegmentSurface<S>& surface,
                   GetTree&& tree, May&& may = {}, std::int32_t first = -1)
{
  constexpr double tie = LocalSearchRule::tie;
  // Larger than for ties, relative to the segment [-].
  constexpr double more = 1e-6;
  const auto project_on = [&](std::int32_t i) noexcept
  { return project<S>({node, surface.segment(i)}, surface.orientation[i]); };
  const auto over
      = [&](const Projection<S>& p, std::int32_t i, double allowed) noexcept
  {
    return p.converged && S::outside(p.xi) <= allowed
           && !surface.is_too_deep(i, p.gap);
  };

  Found kept;
  if (current >= 0)
  {
    const Projection<S> p = project_on(current);
    if (p.converged)
      may.comes_from(p);
    if (over(p, current, slack) && p.gap <= reach && may.keeps(current, p))
    {
      kept = {current, p.xi, p.gap, p.normal};
      if (p.gap <= tie * surface.size(current) || std::isinf(slack))
        return kept;
      if (may.stays(node, current, p, tree()))
        reach = p.gap;
      else
        kept = {};
    }
  }
  const bool stays = kept.segment >= 0;
  const double overhang
      = stays ? LocalSearchRule::hysteresis : LocalSearchRule::overhang;

  const Tree& segments = tree();
  if (stays && !may_have_entered(node, kept, surface, segments))
    return kept;
  NearestOnSide<S> front, behind;
  double nearest = reach;
  int patience = may.patience();
  const auto visit = [&](std::int32_t i)
  {
    const double margin = tie * surface.size(i);
    // The boxes of a cached tree are wider than segments.
    if (surface.box(i).squared_distance(node)
        > (nearest + margin) * (nearest + margin))
      return nearest + margin;
    const Projection<S> p = project_on(i);
    if (!p.converged || !may.touches(node, i, p, segments))
    {
      if (front.segment < 0 && behind.segment < 0)
        --patience;
      return patience > 0 ? nearest + margin : NAN;
    }
    const double away = distance<S>({node, surface.segment(i)}, p);
    const bool is_only = front.segment < 0 && behind.segment < 0;
    if (away <= nearest - (is_only ? 0 : margin))
    {
      front = behind = {};
      nearest = away;
    }
    else if (is_only || away > nearest + margin)
      return nearest + margin;
    NearestOnSide<S>& side = p.gap < -margin ? behind : front;
    ++side.number;
    const double kept_by = i == current ? LocalSearchRule::hysteresis : 0;
    const double outside = !surface.in_dents ? overhang
                           : surface.is_too_deep(i, p.gap)
                               ? INFINITY
                               : std::max(S::outside(p.xi) - kept_by, overhang);
    if (side.segment < 0 || outside < side.outside
        || (outside == side.outside
            && surface.key[i] < surface.key[side.segment]))
    {
      side.segment = i;
      side.projection = p;
      side.outside = outside;
    }
    side.height = std::max(side.height, std::abs(p.gap));
    return nearest + margin; // ties must be detected
  };
  const auto chosen = [&]() noexcept -> const NearestOnSide<S>*
  {
    const auto& found = behind.height > front.height ? behind : front;
    // Behind an edge between nearest segments there is no rim. The depth of a
    // node above neither of them is its distance from the edge.
    const bool is_at_rim = !surface.in_dents || &found == &front
                           || front.number + behind.number == 1
                           || (found.segment >= 0
                               && surface.is_too_deep(found.segment, -nearest));
    return found.segment >= 0
                   && over(found.projection, found.segment,
                           is_at_rim ? overhang : INFINITY)
               ? &found
               : nullptr;
  };
  double bound = first < 0 ? reach : visit(first);
  const bool faces_first = front.segment >= 0 || behind.segment >= 0;
  if (!faces_first && !may.faces_any(segments))
    return kept;
  segments.nearest(node, bound, [&](std::int32_t i)
                   { return i == first ? bound : bound = visit(i); });
  if (patience <= 0)
  {
    patience = std::numeric_limits<int>::max();
    segments.nearest(node, reach, visit,
                     [&](std::int32_t branch) { return may.enters(branch); });
    if (!chosen())
      return kept;
    // Now all nearer segments are visited: the node may face one of them
    // instead, or be in front of one.
    nearest += more * surface.size(chosen()->segment);
    front = behind = {};
    segments.nearest(node, nearest, visit);
  }
  const NearestOnSide<S>* found = chosen();
  if (!found
      || !may.confirms(found->projection, nearest,
                       surface.size(found->segment)))
    return kept;
  const Projection<S>& p = found->projection;
  if (stays && (p.gap >= 0 || continues(kept, found->segment, surface)))
    return kept;
  const auto had_its_side = [&]() noexcept
  {
    if (current < 0)
      return false;
    const Projection<S> before = project_on(current);
    return before.converged
           && dot(before.normal, p.normal) >= LocalSearchRule::sharp;
  };
  if (p.gap < -tie * surface.size(found->segment)
      && is_beyond_sharp_edge(node, found->segment, p, surface, segments)
      && !had_its_side())
    return kept;
  return {found->segment, p.xi, p.gap, p.normal};
}
} // namespace nts
