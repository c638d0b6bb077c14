#pragma once

#include "nts/geometry/intervals.h"
#include "nts/geometry/polygons.h"
#include "nts/search/cached_tree.h"
#include "nts/search/local_search.h"
#include "nts/search/multiplier_functions.h"

#include <cmath>
#include <iterator>
#include <numbers>
#include <numeric>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

/// @brief Contact points of surface-to-surface contact (mortar): quadrature
/// points of the facets of the nodes, on the parts below which there is one and
/// the same segment.
///
/// Segments are projected along the mean normal of a facet into its reference
/// cell and clipped there, so that neighbours tile the facet without gaps; in
/// the plane, edges are projected on edges.
/// Weights are reference areas, in axisymmetric meshes over the circumference.
/// Multipliers belong to the vertices. Their shape functions are dual to the
/// linear ones of the facet on the part of it that is covered (Cichosz and
/// Bischoff 2011). For vertices outside of that part, see
/// multiplier_functions.h.
namespace nts
{
/// @brief Tolerances for the choice of contact points.
struct MortarRule
{
  /// Largest cosine between the normals of a facet and of a segment that it
  /// faces: their directions differ from opposite ones by up to 66 degrees.
  /// Larger: small parts of lateral faces next to a contact carry forces (at
  /// -0.1 the pressure next to a roller on a plate is twelve times that below
  /// it, and a step takes three times the iterations). Smaller: at -0.5, facets
  /// at edges of 120 degrees become active and inactive again and again.
  static constexpr double facing = -0.4;
  /// Area in the reference cell below which a polygon is left out.
  static constexpr double least_area = 1e-10;
  /// Fraction of a facet that may be covered more than once, as a tolerance for
  /// round-off: larger overlaps are not round-off.
  static constexpr double overlap = 1e-6;
  /// Height of a step between unconnected parts of the segments below a facet,
  /// relative to its diameter, above which only the nearest part counts.
  /// Larger: open points of the lower part take force away (without a limit, 4
  /// to 5 % from a block by springs above a step of half a facet); smaller:
  /// parts are left out that facets reach after some compression.
  static constexpr double farthest = 0.25;
};

/// @brief Contact points, in the order of their facets. The points of a facet
/// are followed by the corners of its parts, as extrema of gaps are at corners.
struct MortarPoints
{
  std::vector<std::int32_t> facet;   ///< number of the facet
  std::vector<std::int32_t> segment; ///< number of the segment
  std::vector<double> weight;        ///< reference area [m^2]; 0 at corners
  std::vector<double> phi;           ///< shape functions of the facet, (p, n)
  std::vector<double> psi;           ///< shape functions of multipliers, (p, k)
  std::vector<double> step; ///< of each facet, see `MortarSearch::step`
};

/// @brief Positions of nodes at one end of a step, and of segments [m].
struct Ends
{
  std::span<const double> X;          ///< reference, of nodes of facets, (l, 3)
  std::span<const double> x_n;        ///< of the same nodes at t_n
  std::span<const double> segments_n; ///< at t_n, of vertices of segments
  std::span<const double> thickness;  ///< of cells at segments, (s,) [m]
  bool are_rings;  ///< whether the mesh is axisymmetric about x = 0
  bool are_smooth; ///< whether there are patches on facets or segments
};

/// @brief Chooses the contact points of facets F with segments of degree 1.
template <class F>
class MortarSearch
{
public:
  using S = typename F::Linear;
  static constexpr std::size_t k = S::vertices, n = F::vertices;
  /// Part of a reference cell.
  using Part = std::conditional_t<k == 2, Interval, Polygon>;

  /// @param[in] facets Facets of the nodes, like segments.
  /// @param[in] segments Segments of the other surface.
  /// @param[in] ends Other positions of both.
  /// @param[in] reach Search distance of the facets [m].
  MortarSearch(const SegmentSurface<F>& facets,
               const SegmentSurface<S>& segments, const Ends& ends,
               double reach)
      : _facets(facets), _segments(segments), _ends(ends), _reach(reach)
  {
  }

  /// @brief Choose the points of all facets.
  /// @param[in] tree Tree over the segments at their current positions.
  MortarPoints find(const Tree& tree)
  {
    for (std::size_t e = 0; e < _facets.vertices.size() / n; ++e)
      add_facet(static_cast<std::int32_t>(e), tree);
    return std::move(_points);
  }

private:
  /// @brief A segment below a facet.
  struct Below
  {
    std::int32_t segment;
    Part whole, part; // polygon of the segment nearby, and its part in the
                      // reference cell
    double gap;       // mean gap at the corners of the polygon [m]
  };

  /// @brief A point in the reference cell of a facet.
  struct Point
  {
    Vec2 xi;
    double weight;
    std::int32_t segment;
  };

  template <class T>
  static Vec3 normal(const std::array<Vec3, T::vertices>& x,
                     double orientation) noexcept
  {
    const auto [first, second] = tangents<T>(x, T::centre);
    const Vec3 across = cross(first, second);
    return (orientation / norm(across)) * across;
  }

  /// @brief Positions of the nodes of a facet or segment.
  template <class T>
  static std::array<Vec3, T::vertices> nodes(const SegmentSurface<T>& surface,
                                             std::size_t i,
                                             std::span<const double> x)
  {
    SegmentSurface<T> there = surface;
    there.x = x;
    return there.segment(i);
  }

  /// @brief Gap of a point of a facet, NaN where it does not project.
  double gap(std::int32_t facet, const Vec2& xi, std::int32_t segment,
             std::span<const double> x, std::span<const double> y) const
  {
    const Pair<S> pair = {combine(F::phi(xi), nodes(_facets, facet, x)),
                          nodes(_segments, segment, y)};
    const Projection<S> p = project(pair, _segments.orientation[segment]);
    return p.converged ? p.gap : NAN;
  }

  /// @brief Box around a facet in its plane. Curved edges may leave the box of
  /// the nodes.
  struct Box
  {
    Vec2 low, high;

    explicit Box(const std::array<Vec2, n>& facet) noexcept
    {
      constexpr double beyond = n > k ? 0.25 : 0; // sides of the box
      for (std::size_t d = 0; d < 2; ++d)
      {
        const auto [first, last] = std::ranges::minmax(
            facet, {}, [d](const Vec2& node) { return node[d]; });
        const double margin = beyond * (last[d] - first[d]);
        low[d] = first[d] - margin;
        high[d] = last[d] + margin;
      }
    }

    /// @brief Whether the box around a projected segment does not meet it.
    bool is_apart(const std::array<Vec2, k>& segment) const noexcept
    {
      for (std::size_t d = 0; d < (k == 2 ? 1 : 2); ++d)
      {
        const auto [first, last] = std::ranges::minmax(
            segment, {}, [d](const Vec2& corner) { return corner[d]; });
        if (first[d] > high[d] || last[d] < low[d])
          return true;
      }
      return false;
    }

    /// @brief Part of a projected segment inside a curved facet. Far outside of
    /// the facet its map folds, so that points there have no unique
    /// coordinates.
    Polygon part(const std::array<Vec2, k>& segment) const
    {
      Polygon polygon;
      for (const std::size_t i : around<S>())
        polygon.push_back(segment[i]);
      if constexpr (n == k)
        return polygon;
      Sides<4> sides;
      for (std::size_t d = 0; d < 2; ++d)
      {
        const double a = 1 / (high[d] - low[d]);
        sides[d] = sides[d + 2] = {};
        sides[d][d] = a;
        sides[d][2] = -a * low[d];
        sides[d + 2][d] = -a;
        sides[d + 2][2] = a * high[d];
      }
      return clipped(std::move(polygon), sides);
    }
  };

  /// @brief Mean gap at the corners of a polygon, the greater one of both ends
  /// of the step. A facet that is far behind a segment at both ends belongs to
  /// another side of the body.
  double gap_of(std::int32_t facet, const Below& below) const
  {
    double there = 0, before = 0;
    for (const Vec2& xi : below.part)
    {
      there += gap(facet, xi, below.segment, _facets.x, _segments.x);
      before += gap(facet, xi, below.segment, _ends.x_n, _ends.segments_n);
    }
    return (std::isnan(there) || std::isnan(before))
               ? NAN
               : std::max(there, before) / below.part.size();
  }

  /// @brief Number of the connected component of each segment; segments with a
  /// common vertex are connected.
  std::vector<std::size_t> components(const std::vector<Below>& found) const
  {
    std::vector<std::size_t> part(found.size());
    std::iota(part.begin(), part.end(), std::size_t(0));
    const auto first = [&part](std::size_t i)
    {
      while (part[i] != i)
        i = part[i] = part[part[i]];
      return i;
    };
    std::vector<std::pair<std::int32_t, std::size_t>> corners;
    for (std::size_t i = 0; i < found.size(); ++i)
      for (std::size_t j = 0; j < k; ++j)
        corners.emplace_back(_segments.vertices[k * found[i].segment + j], i);
    std::ranges::sort(corners);
    for (std::size_t i = 1; i < corners.size(); ++i)
      if (corners[i].first == corners[i - 1].first)
        part[first(corners[i].second)] = first(corners[i - 1].second);
    for (std::size_t i = 0; i < part.size(); ++i)
      part[i] = first(i);
    return part;
  }

  /// @brief Least distance of the vertices of a part from the plane of a
  /// segment [m].
  double height(const std::vector<Below>& found,
                const std::vector<std::size_t>& part, std::size_t number,
                std::int32_t segment) const
  {
    const std::array<Vec3, k> plane = nodes(_segments, segment, _segments.x);
    const Vec3 up = normal<S>(plane, _segments.orientation[segment]);
    double least = INFINITY;
    for (std::size_t i = 0; i < found.size(); ++i)
      if (part[i] == number)
        for (const Vec3& y : nodes(_segments, found[i].segment, _segments.x))
          least = std::min(least, std::abs(dot(up, y - plane[0])));
    return least;
  }

  /// @brief Largest step between unconnected parts of the segments below a
  /// facet, relative to its diameter [-]. Parts behind a step of more than
  /// `MortarRule::farthest` from the nearest part are removed.
  double step(std::vector<Below>& found, double diameter) const
  {
    std::vector<std::size_t> part = components(found);
    std::vector<std::size_t> nearest; // segment of each part
    const auto distance
        = [&found](std::size_t i) { return std::abs(found[i].gap); };
    for (std::size_t i = 0; i < found.size(); ++i)
    {
      const auto same = std::ranges::find_if(nearest, [&](std::size_t j)
                                             { return part[j] == part[i]; });
      if (same == nearest.end())
        nearest.push_back(i);
      else if (distance(i) < distance(*same))
        *same = i;
    }
    if (nearest.size() < 2)
      return 0;
    const std::size_t own = *std::ranges::min_element(nearest, {}, distance);
    double largest = 0;
    std::vector<bool> is_far(found.size());
    for (const std::size_t other : nearest)
      if (other != own)
      {
        const double high
            = std::min(height(found, part, part[other], found[own].segment),
                       height(found, part, part[own], found[other].segment))
              / diameter;
        if (high > MortarRule::farthest)
          for (std::size_t i = 0; i < found.size(); ++i)
            is_far[i] = is_far[i] || part[i] == part[other];
        else
          largest = std::max(largest, high);
      }
    std::vector<Below> kept;
    for (std::size_t i = 0; i < found.size(); ++i)
      if (!is_far[i])
        kept.push_back(std::move(found[i]));
    found = std::move(kept);
    return largest;
  }

  void add_facet(std::int32_t e, const Tree& tree)
  {
    const std::array<Vec3, n> x = nodes(_facets, e, _facets.x);
    const Vec3 up = normal<F>(x, _facets.orientation[e]);
    Vec3 centre = {};
    for (const Vec3& node : x)
      centre += (1. / n) * node;
    double radius = 0;
    for (const Vec3& node : x)
      radius = std::max(radius, norm(node - centre));
    const Vec3 edge = x[1] - x[0];
    const Vec3 along = edge - dot(edge, up) * up;
    const std::array<Vec3, 2> axes
        = {(1 / norm(along)) * along, cross(up, (1 / norm(along)) * along)};
    const auto flat = [&](const Vec3& point) -> Vec2
    { return {dot(point - centre, axes[0]), dot(point - centre, axes[1])}; };
    std::array<Vec2, n> c;
    for (std::size_t i = 0; i < n; ++i)
      c[i] = flat(x[i]);
    const Box box(c);

    std::vector<Below> found;
    // All segments in the shadow of the facet up to the gap of radius + reach,
    // or down to the depth of initial penetration, are within this distance, in
    // any rotated scene.
    const double limit
        = std::hypot(radius, radius + std::max(_reach, _segments.sunk));
    const auto visit = [&](std::int32_t s)
    {
      const std::array<Vec3, k> y = nodes(_segments, s, _segments.x);
      if (!(dot(normal<S>(y, _segments.orientation[s]), up)
            < MortarRule::facing))
        return limit;
      std::array<Vec2, k> corners;
      for (std::size_t i = 0; i < k; ++i)
        corners[i] = flat(y[i]);
      if (box.is_apart(corners))
        return limit;
      Below below = {s, {}, {}, 0};
      if constexpr (k == 2)
      {
        below.whole
            = {pulled_back<F>(corners[0], c), pulled_back<F>(corners[1], c)};
        below.part = clipped(below.whole);
      }
      else
      {
        for (const Vec2& corner : box.part(corners))
          below.whole.push_back(pulled_back<F>(corner, c));
        below.part = clipped<S>(below.whole);
      }
      const double size = std::abs(area(below.part));
      if (size < MortarRule::least_area)
        return limit;
      const double g = gap_of(e, below);
      // A deeper facet belongs to the opposite side of the body.
      const bool is_behind = g < -std::max(_ends.thickness[s], _segments.sunk);
      if (!std::isnan(g) && g <= radius + _reach && !is_behind
          && !_segments.is_too_deep(s, g))
      {
        below.gap = g;
        found.push_back(std::move(below));
      }
      return limit;
    };
    tree.nearest(centre, limit, visit);
    _points.step.push_back(step(found, 2 * radius));
    double nearest = INFINITY, covered = 0;
    for (const Below& below : found)
    {
      nearest = std::min(nearest, below.gap);
      covered += std::abs(area(below.part));
    }
    if (!(nearest <= _reach))
      return;
    // The order of sums is the same on any partition.
    std::ranges::sort(found, {}, [&](const Below& below)
                      { return _segments.key[below.segment]; });

    constexpr double cell = k == 3 ? 0.5 : 1;
    std::vector<Point> points;
    if (covered <= (1 + MortarRule::overlap) * cell)
      for (const Below& below : found)
        add_rule(below.part, [&](const Vec2& xi, double weight)
                 { points.push_back({xi, weight, below.segment}); });
    else
    {
      covered = pair_nearest(e, found, points);
      found.clear(); // with overlaps, corners may not be on the nearest segment
    }
    add_points(e, std::move(points), covered / cell, found);
  }

  /// @brief Call add(xi, weight) for points by which shape functions are
  /// integrated exactly.
  template <class Add>
  void add_rule(const Part& part, Add&& add) const
  {
    if constexpr (n == 9)
      integrate_fourth(part, add);
    else if constexpr (k == 2)
      integrate<S>(part, add);
    else if (_ends.are_smooth)
      integrate_fourth(part, add);
    else
      integrate<S>(part, add);
  }

  /// @brief Pair points of a facet with the nearest segment each; returns the
  /// area in the reference cell that they cover.
  double pair_nearest(std::int32_t e, const std::vector<Below>& found,
                      std::vector<Point>& points) const
  {
    constexpr int parts = 4; // along an edge of the facet
    double covered = 0;
    const auto add = [&](const Vec2& xi, double weight)
    {
      Point point = {xi, weight, -1};
      double least = INFINITY;
      for (const Below& below : found)
      {
        const double g
            = std::abs(gap(e, xi, below.segment, _facets.x, _segments.x));
        if (holds(below.whole, xi) && g < least)
        {
          least = g;
          point.segment = below.segment;
        }
      }
      if (point.segment < 0)
        return;
      covered += weight;
      points.push_back(point);
    };
    constexpr double h = 1. / parts;
    if constexpr (k == 2)
    {
      for (int i = 0; i < parts; ++i)
        add({(i + 0.5) * h, 0}, h);
      return covered;
    }
    for (int i = 0; i < parts; ++i)
      for (int j = 0; j < (k == 3 ? parts - i : parts); ++j)
      {
        const double a = i * h, b = j * h;
        if constexpr (k == 3)
        {
          add_rule({{a, b}, {a + h, b}, {a, b + h}}, add);
          if (i + j + 1 < parts)
            add_rule({{a + h, b}, {a + h, b + h}, {a, b + h}}, add);
        }
        else
          add({a + h / 2, b + h / 2}, h * h);
      }
    return covered;
  }

  /// @brief Add the points of a facet, of which a part is covered [-], and the
  /// corners of parts, with the shape functions there.
  void add_points(std::int32_t e, std::vector<Point> points, double covered,
                  const std::vector<Below>& found)
  {
    const std::array<Vec3, n> X = nodes(_facets, e, _ends.X);
    MultiplierFunctions<S> functions;
    for (Point& point : points)
    {
      point.weight *= area_ratio<F>(X, point.xi);
      if (_ends.are_rings)
        point.weight *= 2 * std::numbers::pi * combine(F::phi(point.xi), X)[0];
      functions.add(point.xi, point.weight);
    }
    functions.finish(covered);
    for (const Below& below : found)
      for (const Vec2& xi : below.part)
        points.push_back({xi, 0, below.segment});
    for (const Point& point : points)
    {
      _points.facet.push_back(e);
      _points.segment.push_back(point.segment);
      _points.weight.push_back(point.weight);
      std::ranges::copy(F::phi(point.xi), std::back_inserter(_points.phi));
      std::ranges::copy(functions(point.xi), std::back_inserter(_points.psi));
    }
  }

  SegmentSurface<F> _facets;
  SegmentSurface<S> _segments;
  Ends _ends;
  double _reach;
  MortarPoints _points;
};
} // namespace nts
