#pragma once

#include "nts/search/local_search.h"

#include <optional>

/// @brief Segments that a node can touch with the outside of its body.
namespace nts
{
/// @brief Cosines of angles between directions of nodes and segments [-].
struct FacingRule
{
  /// Least cosine between the normal of a segment and a direction of a node
  /// that may touch it: 84 degrees. Smaller: nodes on bulging lateral faces of
  /// a body touch the plane on which it stands. Larger: steep flanks of wedges
  /// do not touch flat surfaces.
  static constexpr double opposed = 0.1;
  /// Cosine of the largest angle that does not count as an edge, 20 degrees:
  /// rotations within a step, and angles between facets of smooth surfaces, are
  /// smaller. Larger angle: nodes that slide towards edges of more than 150
  /// degrees are blocked (T/N = 0.56 at 170, 0.64 at 160 degrees, friction
  /// coefficient 0.5). Smaller angle: nodes of coarse surfaces touch balls too
  /// late.
  static constexpr double turn = 0.93969262078590838;
  /// Segments whose normals differ by more than 120 degrees are opposite sides
  /// of a wall; a node and a segment whose normals differ by less than 60
  /// degrees are on the same side.
  static constexpr double wall = 0.5;
  /// Depth below the face beyond an edge up to which a node belongs to that
  /// face, relative to the segment [-]: vertices on edges penetrate about as
  /// deep between nodes. Smaller: edges of 150 degrees block sliding nodes in
  /// statics (T/N = 0.93 at 0.01, friction coefficient 0.5). Larger: nodes that
  /// touch lateral faces near edges are pushed under the edge.
  static constexpr double below = 0.02;
};

/// @brief Outward unit normal of a facet; zero if the facet is degenerate.
/// @param[in] vertices Vertices of an edge, triangle or quadrilateral, in Basix
/// order [m].
/// @param[in] orientation +1 where a_1 x a_2 points outward, otherwise -1.
inline Vec3 facet_normal(std::span<const Vec3> vertices,
                         double orientation) noexcept
{
  const auto& x = vertices;
  // Two edges of a triangle, the diagonals of a quadrilateral.
  const Vec3 first = x.size() == 4 ? x[3] - x[0] : x[1] - x[0];
  const Vec3 second = x.size() == 2   ? out_of_plane(first)
                      : x.size() == 3 ? x[2] - x[0]
                                      : x[2] - x[1];
  const Vec3 n = cross(first, second);
  const double length = norm(n);
  return length > 0 ? (orientation / length) * n : Vec3{};
}

/// @brief Facets around each node of a surface.
struct FacetsAroundNodes
{
  std::span<const std::int32_t> vertices; ///< rows of x, (f, k)
  std::span<const double> orientation;    ///< +1 or -1, (f,)
  std::size_t k;                          ///< vertices of a facet
  std::span<const std::int32_t> first;    ///< of each node, (n + 1,)
  std::span<const std::int32_t> facets;   ///< facets around each node
  std::span<const std::int32_t> corner;   ///< number of the node in each facet
  std::span<const double> angle; ///< undeformed angle of each there [rad]
  std::span<const double> x;     ///< positions, (l, 3) [m]

  /// Normals computed so far, NaN for the other facets.
  mutable std::vector<Vec3> normals = {};

  /// @brief Unit normal of a facet, see `facet_normal`.
  ///
  /// It is computed once for all nodes around the facet.
  const Vec3& normal(std::int32_t facet) const
  {
    if (normals.empty())
      normals.assign(orientation.size(), {NAN, NAN, NAN});
    Vec3& n = normals[facet];
    if (std::isnan(n[0]))
    {
      std::array<Vec3, 4> positions;
      for (std::size_t i = 0; i < k; ++i)
        positions[i] = vector(x, vertices[k * facet + i]);
      n = facet_normal(std::span(positions).first(k), orientation[facet]);
    }
    return n;
  }
};

/// @brief An edge at a node, as a direction along the facets around it.
struct Edge
{
  Vec3 along = {};   ///< unit vector
  double length = 0; ///< to the vertex there [m]
};

/// @brief Directions in which a node can be touched: the cone of the normals
/// around it.
class Directions
{
public:
  /// @brief Directions of a node; without facets around it, it faces every
  /// segment.
  /// @param[in] around Must outlive the directions.
  /// @param[in] node Number of the node.
  Directions(const FacetsAroundNodes& around, std::int32_t node)
      : _around(around), _begin(around.first[node]),
        _end(around.first[node + 1])
  {
  }

  /// @brief Whether the node has no known facets, and therefore faces
  /// everything.
  bool are_all() const noexcept { return _begin == _end; }

  /// @brief Cosine of the angle between a unit vector and the cone.
  /// @param[in] d The vector.
  /// @param[in] enough Larger cosines need not be exact.
  double cosine(const Vec3& d, double enough = 1) const
  {
    double found = are_all() ? 1 : -1;
    for (std::int32_t i = _begin; i < _end; ++i)
      found = std::max(found, dot(normal(i), d));
    // The direction of the cone nearest to d is on one of its rays, between two
    // of them, or d itself if d is within the cone.
    constexpr double flat = 1e-9; // sine of the angle between rays
    for (std::int32_t i = _begin; i < _end; ++i)
      for (std::int32_t j = _begin; j < i; ++j)
      {
        // The angle exceeds 90 degrees only if it does for all rays.
        if (found <= 0 || found >= enough)
          return found;
        const Vec3 across = cross(normal(i), normal(j));
        const double square = dot(across, across);
        if (square <= flat * flat)
          continue;
        const double g = dot(normal(i), normal(j)), a = dot(normal(i), d),
                     b = dot(normal(j), d);
        if (a >= g * b && b >= g * a)
          found = std::max(
              found, std::sqrt((a * (a - g * b) + b * (b - g * a)) / square));
        for (std::int32_t k = _begin; k < j; ++k)
        {
          const double volume = dot(across, normal(k));
          if (std::abs(volume) > flat && volume * dot(across, d) >= 0
              && volume * dot(cross(normal(j), normal(k)), d) >= 0
              && volume * dot(cross(normal(k), normal(i)), d) >= 0)
            return 1;
        }
      }
    return found;
  }

  /// @brief Whether the node faces a segment with this normal.
  bool faces(const Vec3& normal) const
  {
    return cosine(-1. * normal, FacingRule::opposed) > FacingRule::opposed;
  }

  /// @brief Whether the node may face a segment whose normal is along a vector
  /// in this box, of length 1 at most.
  bool may_face(const Box& normals) const
  {
    constexpr double round_off = 1e-9;
    const auto meets = [&](const Vec3& direction) noexcept
    {
      double most = round_off;
      for (std::size_t i = 0; i < 3; ++i)
        most += std::max(-direction[i] * normals.lower[i],
                         -direction[i] * normals.upper[i]);
      return most > 0;
    };
    bool may = are_all();
    for (std::int32_t i = _begin; i < _end && !may; ++i)
      may = meets(normal(i));
    return may;
  }

  /// @brief Edge at the node along which the distance from the plane of a
  /// segment decreases at the highest rate.
  Edge towards(const Vec3& normal) const
  {
    Edge found;
    double steepest = 0;
    for (std::int32_t e = _begin; e < _end; ++e)
    {
      const std::size_t first = _around.k * _around.facets[e];
      const Vec3 own
          = vector(_around.x, _around.vertices[first + _around.corner[e]]);
      for (std::size_t i = 0; i < _around.k; ++i)
      {
        const Vec3 edge = vector(_around.x, _around.vertices[first + i]) - own;
        const double length = norm(edge);
        if (length > 0 && -dot(edge, normal) > steepest * length)
        {
          steepest = -dot(edge, normal) / length;
          found = {(1 / length) * edge, length};
        }
      }
    }
    return found;
  }

  /// @brief Whether the mean normal at the node is close to a segment's normal;
  /// the node is then on the leading side of its body, not on a rim.
  bool lead_along(const Vec3& normal) const
  {
    Vec3 mean = {};
    for (std::int32_t i = _begin; i < _end; ++i)
      mean += _around.angle[i] * this->normal(i);
    return dot(mean, normal) > LocalSearchRule::sharp * norm(mean);
  }

private:
  const Vec3& normal(std::int32_t i) const
  {
    return _around.normal(_around.facets[i]);
  }

  const FacetsAroundNodes& _around;
  std::int32_t _begin, _end; // range of the facets around the node
};

/// @brief Bounds of the normals of segments, by branches of their tree.
///
/// Without bounds, a search at any distance would visit all segments for a node
/// that faces none of them.
template <class S>
class NormalBounds
{
public:
  /// @param[in] surface The segments.
  /// @param[in] tree Tree over the segments; without one, there are no bounds.
  NormalBounds(const SegmentSurface<S>& surface, const Tree* tree)
  {
    if (tree)
      _boxes = tree->around([&](std::int32_t i) { return of(surface, i); });
  }

  /// @brief Whether there are bounds.
  bool exist() const noexcept { return !_boxes.empty(); }

  /// @brief Whether a node may face a segment of a branch.
  bool meet(const Directions& directions, std::int32_t branch) const
  {
    return directions.may_face(_boxes[branch]);
  }

private:
  static Box of(const SegmentSurface<S>& surface, std::int32_t i)
  {
    // Nodes up to this far beyond the rim are included; there the normal is a
    // mean of the normals at the corners.
    constexpr double begin = -LocalSearchRule::overhang, end = 1 - begin;
    const auto x = surface.segment(i);
    const std::array<Vec3, 2> edge = S::directions(x);
    const Vec3 mixed = combine(S::d2phi(), x);
    Box box;
    for (const Vec2& xi : {Vec2{begin, begin}, Vec2{end, begin},
                           Vec2{begin, end}, Vec2{end, end}})
    {
      const Vec3 n = cross(edge[0] + xi[1] * mixed, edge[1] + xi[0] * mixed);
      const double length = norm(n);
      if (length > 0)
        box.include((surface.orientation[i] / length) * n);
    }
    return box;
  }

  std::vector<Box> _boxes;
};

/// @brief Admissible segments of one node: segments that face it, see
/// `find_segment`. The node keeps its current segment in any orientation.
template <class S>
class Facing
{
public:
  /// @param[in] around Facets around the nodes at t_n.
  /// @param[in] node Number of the node.
  /// @param[in] surface The segments.
  /// @param[in] normals Bounds of the normals of the segments.
  /// @param[in] thickness Of the cells behind the segments, (s,) [m].
  Facing(const FacetsAroundNodes& around, std::int32_t node,
         const SegmentSurface<S>& surface, const NormalBounds<S>& normals,
         std::span<const double> thickness)
      : _around(around), _node(node), _surface(surface), _normals(normals),
        _thickness(thickness)
  {
  }

  bool keeps(std::int32_t, const Projection<S>&) const noexcept { return true; }

  /// @brief Store normal and depth of the projection on the current segment.
  void comes_from(const Projection<S>& current) noexcept
  {
    _before = current.normal;
    _is_inside = current.gap < 0;
  }

  /// @brief Whether a node in front of its segment keeps it.
  bool stays(const Vec3& node, std::int32_t i, const Projection<S>& p,
             const Tree& tree)
  {
    return !waits(node, i, p, [&]() -> const Tree& { return tree; });
  }

  /// @brief Whether the node may enter a segment on its path.
  /// @param[in] from Start of the path [m].
  /// @param[in] i The segment.
  /// @param[in] normal Normal of the segment where the path crosses it.
  /// @param[in] tree Returns the tree over the segments at the start.
  template <class GetTree>
  bool may_enter(const Vec3& from, std::int32_t i, const Vec3& normal,
                 const GetTree& tree)
  {
    if (!directions().faces(normal))
      return false;
    const Projection<S> p
        = project<S>({from, _surface.segment(i)}, _surface.orientation[i]);
    return !p.converged || !waits(from, i, p, tree);
  }

  /// @brief See `Directions`.
  bool leads_along(const Vec3& normal)
  {
    return !directions().are_all() && directions().lead_along(normal);
  }

  /// @brief Whether the node may face any segment.
  bool faces_any(const Tree& tree)
  {
    return !_normals.exist()
           || tree.has_entry([&](std::int32_t b) { return enters(b); });
  }

  /// @brief Number of visits before branches are excluded, see `Anything`;
  /// without bounds, branches are never excluded.
  int patience() const noexcept
  {
    return _normals.exist() ? 8 : std::numeric_limits<int>::max();
  }

  /// @brief Whether the node may face a segment of a branch.
  bool enters(std::int32_t branch)
  {
    return _normals.meet(directions(), branch);
  }

  /// @brief Whether the node may touch a segment. If not, and if the node is in
  /// front of the segment, the segment is recorded.
  bool touches(const Vec3& node, std::int32_t i, const Projection<S>& p,
               const Tree& tree)
  {
    // A deeper node is nearer to the other side of the wall, unless it was
    // behind the segment next to it. Contact continues across edges that are
    // not sharp.
    const bool goes_on = dot(_before, p.normal) >= LocalSearchRule::sharp;
    const double depth = std::max(_thickness[i], _surface.sunk);
    if (directions().are_all()
        || ((p.gap >= -depth || (goes_on && _is_inside))
            && directions().faces(p.normal)
            && (goes_on || stays(node, i, p, tree))))
      return true;
    if (p.gap > 0 && p.gap < _in_front_by && S::outside(p.xi) <= 0)
    {
      _in_front_by = p.gap;
      _normal = p.normal;
      // Lateral faces of two bodies in one plane do not hide a rim if they
      // bulge by less than the overhang of nodes.
      _size = _surface.size(i);
      _hides_from = directions().cosine(p.normal) > FacingRule::wall
                        ? LocalSearchRule::overhang
                        : LocalSearchRule::hysteresis;
    }
    return false;
  }

  /// @brief Whether the node is in front of the segment found, or inside the
  /// body behind it.
  ///
  /// A node is outside if it is in front of a nearer segment. A gap that counts
  /// as zero matters only before the opposite side of a wall.
  bool confirms(const Projection<S>& found, double distance,
                double size) const noexcept
  {
    return found.gap >= 0 || _in_front_by > distance
           || (_in_front_by <= _hides_from * std::min(_size, size)
               && dot(_normal, found.normal) >= -FacingRule::wall);
  }

private:
  /// @brief Whether the node is ahead of an edge of the segments whose other
  /// side faces the node better. The node is then below the edge. The edge will
  /// touch the facets around the node, not the node the segment. Vertices on
  /// the edge may be below these facets, and the node below the segment beyond
  /// the edge by as much (`FacingRule::below`), so that it is behind both
  /// segments.
  template <class GetTree>
  bool waits(const Vec3& node, std::int32_t i, const Projection<S>& p,
             const GetTree& tree)
  {
    const std::int32_t other = beyond_edge(node, i, p, tree);
    if (other < 0 || p.gap >= 0)
      return other >= 0;
    // A node that is deeper below both has passed through the segment, and
    // stays in contact.
    const Projection<S> q = project<S>({node, _surface.segment(other)},
                                       _surface.orientation[other]);
    return q.converged && q.gap >= -FacingRule::below * _surface.size(other);
  }

  /// @brief Segment beyond the nearest edge ahead of the node, if it faces the
  /// node better by more than the angle of `FacingRule::turn`, otherwise -1.
  template <class GetTree>
  std::int32_t beyond_edge(const Vec3& node, std::int32_t i,
                           const Projection<S>& p, const GetTree& tree)
  {
    const double cosine = directions().cosine(-1. * p.normal, FacingRule::turn);
    if (cosine >= FacingRule::turn)
      return -1;
    const Edge edge = directions().towards(p.normal);
    const double rate = -dot(edge.along, p.normal);
    if (!(rate > 0))
      return -1;
    // Point one edge length below the plane of the segment, and the segment
    // nearest to it.
    const Vec3 beyond = node + (p.gap / rate + edge.length) * edge.along;
    double nearest = rate * edge.length, best = -1;
    std::int32_t found = -1;
    const double margin = LocalSearchRule::tie * _surface.size(i);
    tree().nearest(
        beyond, nearest + margin,
        [&](std::int32_t other)
        {
          const double bound = nearest + margin;
          if (other == i
              || _surface.box(other).squared_distance(beyond) > bound * bound)
            return bound;
          const Pair<S> pair = {beyond, _surface.segment(other)};
          const Projection<S> q = project(pair, _surface.orientation[other]);
          const double away = q.converged ? distance(pair, q) : INFINITY;
          if (away > bound)
            return bound;
          // Of equally near segments, choose the one that faces the node best.
          const double facing = directions().cosine(-1. * q.normal);
          if (away < nearest - margin || facing > best)
          {
            best = facing;
            found = other;
          }
          nearest = std::min(away, nearest);
          return nearest + margin;
        });
    const bool is_better
        = std::acos(std::min(best, 1.)) + std::acos(FacingRule::turn)
          < std::acos(cosine);
    return is_better && _surface.is_behind(found, i, p.normal) ? found : -1;
  }

  const Directions& directions()
  {
    if (!_directions)
      _directions.emplace(_around, _node);
    return *_directions;
  }

  const FacetsAroundNodes& _around;
  std::int32_t _node;
  const SegmentSurface<S>& _surface;
  const NormalBounds<S>& _normals;
  std::span<const double> _thickness;
  std::optional<Directions> _directions;
  // Smallest gap in front of a segment, size of that segment [m], and gap that
  // counts as zero, relative to the smaller segment [-].
  double _in_front_by = INFINITY, _size = 0, _hides_from = 0;
  Vec3 _normal = {};
  Vec3 _before = {};       // normal of the current segment
  bool _is_inside = false; // whether the node is behind it
};
} // namespace nts
