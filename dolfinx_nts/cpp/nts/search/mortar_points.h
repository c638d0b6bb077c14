#pragma once

#include "nts/search/cached_tree.h"
#include "nts/search/local_search.h"

#include <span>
#include <vector>

/// @brief Contact points of surface-to-surface contact (mortar): quadrature
/// points of the facets of the nodes, on the parts below which there is one and
/// the same segment.
///
/// Segments are projected along the mean normal of a facet into its reference
/// cell and clipped there, so that neighbours tile the facet without gaps.
/// Weights are reference areas. The multipliers' shape functions are dual to
/// the shape functions of the facet on the part of it that is covered (Cichosz
/// and Bischoff 2011), and these themselves where a part is not.
namespace nts
{
/// @brief Numbers of the choice of contact points.
struct MortarRule
{
  /// Cosine between the normals of a facet and of a segment that it faces.
  static constexpr double facing = -0.1;
  /// Area in the reference cell below which a polygon is left out.
  static constexpr double least_area = 1e-10;
  /// Distance in the reference cell that is none.
  static constexpr double round_off = 1e-12;
  /// Covered part of a facet from which on it counts as a whole.
  static constexpr double whole = 0.999;
  /// By how much segments may cover a facet more than once: but for round-off
  /// they do so only where they overlap in projection.
  static constexpr double overlap = 1e-6;
};

/// @brief A polygon in the reference cell of a facet, or a point of it.
using Polygon = std::vector<Vec2>;

/// @brief Area of a polygon, > 0 where it runs counterclockwise.
inline double area(const Polygon& polygon) noexcept
{
  double sum = 0;
  for (std::size_t i = 0; i < polygon.size(); ++i)
  {
    const Vec2& a = polygon[i];
    const Vec2& b = polygon[(i + 1) % polygon.size()];
    sum += a[0] * b[1] - a[1] * b[0];
  }
  return sum / 2;
}

/// @brief Numbers of the vertices of a segment type, once around.
template <class S>
constexpr std::array<std::size_t, S::vertices> around() noexcept
{
  if constexpr (S::vertices == 3)
    return {0, 1, 2};
  else
    return {0, 1, 3, 2};
}

/// @brief Part of a convex polygon inside of the reference cell (Sutherland and
/// Hodgman).
template <class S>
Polygon clipped(Polygon polygon)
{
  // Sides of the cell: a . xi + c >= 0 inside.
  static constexpr std::array<std::array<double, 3>, 4> square
      = {{{1, 0, 0}, {0, 1, 0}, {-1, 0, 1}, {0, -1, 1}}};
  static constexpr std::array<std::array<double, 3>, 3> triangle
      = {{{1, 0, 0}, {0, 1, 0}, {-1, -1, 1}}};
  const auto cut = [&](const std::array<double, 3>& side)
  {
    const auto inside = [&](const Vec2& p)
    { return side[0] * p[0] + side[1] * p[1] + side[2]; };
    Polygon part;
    for (std::size_t i = 0; i < polygon.size(); ++i)
    {
      const Vec2 &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      // Round-off must not cut slivers from sides that lie on each other.
      const auto rounded = [](double distance)
      { return std::abs(distance) < MortarRule::round_off ? 0 : distance; };
      const double at_a = rounded(inside(a)), at_b = rounded(inside(b));
      if (at_a >= 0)
        part.push_back(a);
      if ((at_a > 0 && at_b < 0) || (at_a < 0 && at_b > 0))
      {
        const double t = at_a / (at_a - at_b);
        part.push_back({a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])});
      }
    }
    polygon = std::move(part);
  };
  if constexpr (S::vertices == 3)
    std::ranges::for_each(triangle, cut);
  else
    std::ranges::for_each(square, cut);
  return polygon;
}

/// @brief Coordinates in the reference cell of a point in the plane of a
/// facet with corners c; any, but one function of the point, if there are none.
template <class S>
Vec2 pulled_back(const Vec2& y, const std::array<Vec2, S::vertices>& c) noexcept
{
  constexpr int max_iterations = 20;
  constexpr double accurate = 1e-14, longest = 2, degenerate = 1e-12;
  const auto at = [&](const auto& weights)
  {
    Vec2 sum = {};
    for (std::size_t i = 0; i < S::vertices; ++i)
      for (std::size_t d = 0; d < 2; ++d)
        sum[d] += weights[i] * c[i][d];
    return sum;
  };
  const auto jacobian = [&](const Vec2& xi) -> Matrix<2, 2>
  {
    const Matrix<2, S::vertices> d = S::dphi(xi);
    const Vec2 a = at(d[0]), b = at(d[1]);
    return {{{a[0], b[0]}, {a[1], b[1]}}};
  };
  Vec2 xi = S::centre;
  const Matrix<2, 2> first = jacobian(xi);
  for (int iteration = 0; iteration < max_iterations; ++iteration)
  {
    const Vec2 there = at(S::phi(xi));
    Matrix<2, 2> J = jacobian(xi);
    if (!(std::abs(det(J)) > degenerate * std::abs(det(first))))
      J = first;
    Vec2 step = inverse(J) * Vec2{y[0] - there[0], y[1] - there[1]};
    const double way = std::max(std::abs(step[0]), std::abs(step[1]));
    // The first step goes to where the affine part of the map leads.
    if (iteration > 0 && way > longest)
      step = {longest / way * step[0], longest / way * step[1]};
    xi = {xi[0] + step[0], xi[1] + step[1]};
    if (way < accurate)
      break;
  }
  return xi;
}

/// @brief Call add(xi, weight) for the points of a rule on a convex polygon
/// that is exact for polynomials of degree 2.
template <class Add>
void integrate(const Polygon& p, Add&& add)
{
  if (p.size() == 4)
  {
    static const double offset = std::sqrt(1. / 12);
    for (const double a : {0.5 - offset, 0.5 + offset})
      for (const double b : {0.5 - offset, 0.5 + offset})
      {
        Vec2 xi, d1, d2;
        for (std::size_t d = 0; d < 2; ++d)
        {
          xi[d] = (1 - a) * (1 - b) * p[0][d] + a * (1 - b) * p[1][d]
                  + a * b * p[2][d] + (1 - a) * b * p[3][d];
          d1[d] = (1 - b) * (p[1][d] - p[0][d]) + b * (p[2][d] - p[3][d]);
          d2[d] = (1 - a) * (p[3][d] - p[0][d]) + a * (p[2][d] - p[1][d]);
        }
        add(xi, std::abs(d1[0] * d2[1] - d1[1] * d2[0]) / 4);
      }
    return;
  }
  // From the mean of the vertices, so that it does not matter which is the
  // first.
  Vec2 mean = {};
  for (const Vec2& vertex : p)
    for (std::size_t d = 0; d < 2; ++d)
      mean[d] += vertex[d] / static_cast<double>(p.size());
  const auto add_triangle = [&](const std::array<Vec2, 3>& corner)
  {
    const double weight = std::abs(area({corner[0], corner[1], corner[2]})) / 3;
    for (std::size_t q = 0; q < 3; ++q)
    {
      Vec2 xi;
      for (std::size_t d = 0; d < 2; ++d)
        xi[d] = (corner[0][d] + corner[1][d] + corner[2][d] + 3 * corner[q][d])
                / 6;
      add(xi, weight);
    }
  };
  if (p.size() == 3)
    add_triangle({p[0], p[1], p[2]});
  else
    for (std::size_t i = 0; i < p.size(); ++i)
      add_triangle({mean, p[i], p[(i + 1) % p.size()]});
}

/// @brief Contact points, in the order of their facets.
struct MortarPoints
{
  std::vector<std::int32_t> facet;   ///< number of the facet
  std::vector<std::int32_t> segment; ///< number of the segment
  std::vector<double> weight;        ///< reference area [m^2]
  std::vector<double> phi;           ///< shape functions of the facet, (p, k)
  std::vector<double> psi;           ///< those of the multipliers, (p, k)
};

/// @brief Chooses the contact points of facets.
template <class S>
class MortarSearch
{
public:
  static constexpr std::size_t k = S::vertices;

  /// @param[in] facets Facets of the nodes, like segments.
  /// @param[in] segments What they may touch.
  /// @param[in] X Reference positions, (l, 3) [m].
  /// @param[in] x_n Positions at t_n, (l, 3) [m].
  /// @param[in] reach Distance up to which facets look for segments [m].
  MortarSearch(const SegmentSurface<S>& facets,
               const SegmentSurface<S>& segments, std::span<const double> X,
               std::span<const double> x_n, double reach)
      : _facets(facets), _segments(segments), _X(X), _x_n(x_n), _reach(reach)
  {
  }

  /// @brief Choose the points of all facets.
  /// @param[in] tree Over the segments where they are.
  MortarPoints find(const Tree& tree)
  {
    for (std::size_t e = 0; e < _facets.vertices.size() / k; ++e)
      add_facet(static_cast<std::int32_t>(e), tree);
    return std::move(_points);
  }

private:
  /// @brief A segment below a facet.
  struct Below
  {
    std::int32_t segment;
    Polygon whole, part; // in the reference cell, before and after clipping
  };

  /// @brief A point in the reference cell of a facet.
  struct Point
  {
    Vec2 xi;
    double weight;
    std::int32_t segment;
  };

  static Vec3 normal(const std::array<Vec3, k>& x, double orientation) noexcept
  {
    const Matrix<2, k> d = S::dphi(S::centre);
    const Vec3 n = cross(combine(d[0], x), combine(d[1], x));
    return (orientation / norm(n)) * n;
  }

  /// @brief Positions of the vertices of a facet or segment.
  static std::array<Vec3, k> corners(const SegmentSurface<S>& surface,
                                     std::size_t i, std::span<const double> x)
  {
    SegmentSurface<S> there = surface;
    there.x = x;
    return there.segment(i);
  }

  /// @brief Gap of a point of a facet, NaN where it does not project.
  double gap(std::int32_t facet, const Vec2& xi, std::int32_t segment,
             std::span<const double> x) const
  {
    const Pair<S> pair = {combine(S::phi(xi), corners(_facets, facet, x)),
                          corners(_segments, segment, x)};
    const Projection<S> p = project(pair, _segments.orientation[segment]);
    return p.converged ? p.gap : NAN;
  }

  /// @brief Mean gap at the corners of a polygon, the greater one of both ends
  /// of the step: what is far behind a segment all the time is that of another
  /// side of the body.
  double gap_of(std::int32_t facet, const Below& below) const
  {
    double there = 0, before = 0;
    for (const Vec2& xi : below.part)
    {
      there += gap(facet, xi, below.segment, _segments.x);
      before += gap(facet, xi, below.segment, _x_n);
    }
    return (std::isnan(there) || std::isnan(before))
               ? NAN
               : std::max(there, before) / below.part.size();
  }

  void add_facet(std::int32_t e, const Tree& tree)
  {
    const std::array<Vec3, k> x = corners(_facets, e, _facets.x);
    const Vec3 n = normal(x, _facets.orientation[e]);
    Vec3 centre = {};
    for (const Vec3& vertex : x)
      centre += (1. / k) * vertex;
    double radius = 0;
    for (const Vec3& vertex : x)
      radius = std::max(radius, norm(vertex - centre));
    const Vec3 edge = x[1] - x[0];
    const Vec3 along = edge - dot(edge, n) * n;
    const std::array<Vec3, 2> axes
        = {(1 / norm(along)) * along, cross(n, (1 / norm(along)) * along)};
    const auto flat = [&](const Vec3& point) -> Vec2
    { return {dot(point - centre, axes[0]), dot(point - centre, axes[1])}; };
    std::array<Vec2, k> c;
    for (std::size_t i = 0; i < k; ++i)
      c[i] = flat(x[i]);

    std::vector<Below> found;
    double nearest = INFINITY, covered = 0;
    const auto visit = [&](std::int32_t s)
    {
      const std::array<Vec3, k> y = corners(_segments, s, _segments.x);
      if (!(dot(normal(y, _segments.orientation[s]), n) < MortarRule::facing))
        return radius + _reach;
      Below below = {s, {}, {}};
      for (const std::size_t i : around<S>())
        below.whole.push_back(pulled_back<S>(flat(y[i]), c));
      below.part = clipped<S>(below.whole);
      const double size = std::abs(area(below.part));
      if (size < MortarRule::least_area)
        return radius + _reach;
      const double g = gap_of(e, below);
      // False, and quiet, where it is NaN.
      if (std::isgreater(g, -LocalSearchRule::depth * _segments.size(s)))
      {
        nearest = std::min(nearest, g);
        covered += size;
        found.push_back(std::move(below));
      }
      return radius + _reach;
    };
    tree.nearest(centre, radius + _reach, visit);
    if (!(nearest <= _reach))
      return;
    // One order of sums on any partition.
    std::ranges::sort(found, {}, [&](const Below& below)
                      { return _segments.key[below.segment]; });

    constexpr double cell = k == 3 ? 0.5 : 1;
    std::vector<Point> points;
    if (covered <= (1 + MortarRule::overlap) * cell)
      for (const Below& below : found)
        integrate(below.part, [&](const Vec2& xi, double weight)
                  { points.push_back({xi, weight, below.segment}); });
    else
      covered = pair_nearest(e, found, points);
    add_points(e, points, covered >= MortarRule::whole * cell);
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
        const double g = std::abs(gap(e, xi, below.segment, _segments.x));
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
    for (int i = 0; i < parts; ++i)
      for (int j = 0; j < (k == 3 ? parts - i : parts); ++j)
      {
        const double a = i * h, b = j * h;
        if constexpr (k == 3)
        {
          integrate({{a, b}, {a + h, b}, {a, b + h}}, add);
          if (i + j + 1 < parts)
            integrate({{a + h, b}, {a + h, b + h}, {a, b + h}}, add);
        }
        else
          add({a + h / 2, b + h / 2}, h * h);
      }
    return covered;
  }

  /// @brief Whether a convex polygon holds a point.
  static bool holds(const Polygon& polygon, const Vec2& xi) noexcept
  {
    const double sense = area(polygon) < 0 ? -1 : 1;
    for (std::size_t i = 0; i < polygon.size(); ++i)
    {
      const Vec2 &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      if (sense
              * ((b[0] - a[0]) * (xi[1] - a[1])
                 - (b[1] - a[1]) * (xi[0] - a[0]))
          < 0)
        return false;
    }
    return true;
  }

  /// @brief Add the points of a facet, with the shape functions there.
  void add_points(std::int32_t e, const std::vector<Point>& points,
                  bool is_whole)
  {
    const std::array<Vec3, k> X = corners(_facets, e, _X);
    std::vector<std::array<double, k>> phi;
    std::vector<double> weight;
    Matrix<k, k> M = {}, D = {};
    for (const Point& point : points)
    {
      const Matrix<2, k> d = S::dphi(point.xi);
      weight.push_back(point.weight
                       * norm(cross(combine(d[0], X), combine(d[1], X))));
      phi.push_back(S::phi(point.xi));
      for (std::size_t a = 0; a < k; ++a)
      {
        for (std::size_t b = 0; b < k; ++b)
          M[a][b] += weight.back() * phi.back()[a] * phi.back()[b];
        D[a][a] += weight.back() * phi.back()[a];
      }
    }
    // psi = D M^-1 phi, with the transpose in D.
    const bool is_dual = is_whole && solve(M, D);
    for (std::size_t q = 0; q < points.size(); ++q)
    {
      _points.facet.push_back(e);
      _points.segment.push_back(points[q].segment);
      _points.weight.push_back(weight[q]);
      for (std::size_t a = 0; a < k; ++a)
      {
        double psi = phi[q][a];
        if (is_dual)
        {
          psi = 0;
          for (std::size_t b = 0; b < k; ++b)
            psi += D[b][a] * phi[q][b];
        }
        _points.phi.push_back(phi[q][a]);
        _points.psi.push_back(psi);
      }
    }
  }

  SegmentSurface<S> _facets, _segments;
  std::span<const double> _X, _x_n;
  double _reach;
  MortarPoints _points;
};
} // namespace nts
