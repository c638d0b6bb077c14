#pragma once

#include "nts/search/facing.h"

/// @brief Passage of nodes through a surface within a step.
///
/// Nodes and vertices move straight from one state to the other.
/// Quadrilaterals are two triangles, and edges in the plane are extruded along
/// z. A node crosses the plane of a moving triangle at the zeros of a cubic
/// polynomial of time.
namespace nts
{
/// @brief The longest part of the path of a node below a surface.
///
/// Times are step fractions, from 0 to 1.
struct Trajectory
{
  std::int32_t entered = -1; ///< segment that it enters, or -1
  bool leaves = false;       ///< whether it leaves again
  double begin = 0;          ///< time when it enters, -1 if it starts inside
  double length = 0;         ///< path below the moving surface [m]
  double cosine = 1;         ///< between the normals at entry and exit [-]
  double gap = NAN; ///< at the end, to the plane of the segment entered [m]
};

/// @brief Zeros in [0, 1] of a cubic polynomial.
/// @param[in] f Values at 0, 1/3, 2/3 and 1.
/// @param[in] found Called with a zero, and whether f decreases there.
template <class OnZero>
void cubic_zeros(const std::array<double, 4>& f, OnZero&& found)
{
  constexpr int bisections = 50;
  constexpr double round_off = 1e-15;
  // Coefficients of the powers of s.
  const double a = f[0], b = -5.5 * f[0] + 9 * f[1] - 4.5 * f[2] + f[3],
               c = 9 * f[0] - 22.5 * f[1] + 18 * f[2] - 4.5 * f[3],
               d = -4.5 * f[0] + 13.5 * f[1] - 13.5 * f[2] + 4.5 * f[3];
  const auto value
      = [&](double s) noexcept { return ((d * s + c) * s + b) * s + a; };
  // Extrema: zeros of its derivative 3 d s^2 + 2 c s + b, computed without
  // cancellation.
  std::array<double, 4> ends = {0, 1, 1, 1};
  std::size_t num_parts = 1;
  const double discriminant = c * c - 3 * b * d;
  if (discriminant > 0)
  {
    const double q = -(c + std::copysign(std::sqrt(discriminant), c));
    std::array<double, 2> turns
        = {d != 0 ? q / (3 * d) : 2, q != 0 ? b / q : 2};
    std::ranges::sort(turns);
    for (const double s : turns)
      if (s > 0 && s < 1)
        ends[num_parts++] = s;
  }
  ends[num_parts] = 1;
  for (std::size_t i = 0; i < num_parts; ++i)
  {
    double low = ends[i], high = ends[i + 1];
    const bool falls = (i == 0 ? f[0] : value(low)) > 0;
    if (falls == ((i + 1 == num_parts ? f[3] : value(high)) > 0))
      continue;
    for (int k = 0; k < bisections && high - low > round_off; ++k)
    {
      const double middle = (low + high) / 2;
      ((value(middle) > 0) == falls ? low : high) = middle;
    }
    found(high, falls);
  }
}

/// @brief Segments that move from one state to another.
struct MovingSurface
{
  std::span<const double> x_n, x;         ///< positions, (l, 3) [m]
  std::span<const std::int32_t> vertices; ///< rows of x, (s, k)
  std::span<const double> orientation;    ///< (s,)
  std::size_t k;                          ///< vertices of a segment

  /// @brief Vertices of a segment, rows of x.
  std::span<const std::int32_t> segment(std::size_t i) const noexcept
  {
    return vertices.subspan(k * i, k);
  }

  /// @brief Box of a segment in both states.
  Box box(std::size_t i) const noexcept
  {
    Box box = bounds(x_n, segment(i));
    const Box end = bounds(x, segment(i));
    box.include(end.lower);
    box.include(end.upper);
    return box;
  }

  /// @brief Position of a vertex at a time.
  Vec3 at(std::int32_t row, double s) const noexcept
  {
    const Vec3 begin = vector(x_n, row);
    return begin + s * (vector(x, row) - begin);
  }

  /// @brief Centre and normal of a segment at a time.
  std::array<Vec3, 2> plane(std::size_t i, double s) const noexcept
  {
    std::array<Vec3, 4> positions;
    Vec3 centre = {};
    for (std::size_t K = 0; K < k; ++K)
    {
      positions[K] = at(segment(i)[K], s);
      centre += (1. / k) * positions[K];
    }
    return {centre,
            facet_normal(std::span(positions).first(k), orientation[i])};
  }
};

/// @brief Intersections of nodal paths with a moving surface.
class Trajectories
{
public:
  /// @brief Build a tree over the space that the segments sweep.
  explicit Trajectories(const MovingSurface& surface)
      : _surface(surface), _tree(boxes(surface))
  {
  }

  /// @brief Compute the intersections of the path of one node.
  /// @param[in] from, to Its positions in both states [m].
  /// @param[in] row Its row of the surface's positions, or -1: segments of
  /// which it is a vertex are left out.
  /// @param[in] inside Segment behind which it starts, or -1.
  /// @param[in] node Admissible segments of the node, see `Facing`.
  /// @param[in] tree Returns the tree over the segments in the first state.
  template <class S, class GetTree>
  Trajectory follow(const Vec3& from, const Vec3& to, std::int32_t row,
                    std::int32_t inside, Facing<S> node, const GetTree& tree)
  {
    const Vec3 path = to - from;
    find_crossings(from, path, row);
    if (inside >= 0)
      _crossings.push_back({-1, true, inside, _surface.plane(inside, 0)[1]});
    if (_crossings.empty())
      return {};
    // If two triangles are crossed simultaneously, the node enters first.
    std::ranges::sort(_crossings, {}, [](const Crossing& c)
                      { return std::pair(c.time, !c.inward); });
    Trajectory longest;
    // On the leading side of its body, a node whose first crossing is an exit
    // was inside before.
    if (!_crossings[0].inward && node.leads_along(_crossings[0].normal))
      longest = {.entered = _crossings[0].segment,
                 .leaves = true,
                 .length = _crossings[0].time * norm(path),
                 .cosine = -1};
    for (std::size_t i = 0; i < _crossings.size(); ++i)
    {
      const Crossing& in = _crossings[i];
      if (!in.inward
          || !(in.time < 0
               || node.may_enter(from, in.segment, in.normal, tree)))
        continue;
      Trajectory t{.entered = in.segment, .begin = in.time};
      double end = 1;
      const auto out
          = std::find_if(_crossings.begin() + i, _crossings.end(),
                         [](const Crossing& c) { return !c.inward; });
      if (out != _crossings.end())
      {
        t.leaves = true;
        t.cosine = dot(in.normal, out->normal);
        end = out->time;
      }
      const auto [centre, normal] = _surface.plane(in.segment, 1);
      const Vec3 moved = centre - _surface.plane(in.segment, 0)[0];
      t.length = (end - std::max(in.time, 0.)) * norm(path - moved);
      t.gap = dot(to - centre, normal);
      if (longest.entered < 0 || t.length > longest.length)
        longest = t;
    }
    return longest;
  }

private:
  /// Distances relative to the size of a triangle [-]: from its plane, counted
  /// as zero, and outside of its edges, counted as inside.
  static constexpr double on_plane = 1e-9, outside = 1e-6;

  struct Crossing
  {
    double time;
    bool inward;
    std::int32_t segment;
    Vec3 normal;
  };

  static std::vector<Box> boxes(const MovingSurface& surface)
  {
    std::vector<Box> boxes(surface.vertices.size() / surface.k);
    for (std::size_t i = 0; i < boxes.size(); ++i)
      boxes[i] = surface.box(i);
    return boxes;
  }

  void find_crossings(const Vec3& from, const Vec3& path, std::int32_t row)
  {
    _crossings.clear();
    const double radius = norm(path) / 2 * (1 + on_plane);
    _tree.nearest(
        from + 0.5 * path, radius,
        [&](std::int32_t i)
        {
          const auto rows = _surface.segment(i);
          if (std::ranges::find(rows, row) == rows.end())
          {
            cross_triangle(from, path, i,
                           {rows[0], rows[1], rows[_surface.k == 2 ? 1 : 2]});
            if (_surface.k == 4)
              cross_triangle(from, path, i, {rows[1], rows[3], rows[2]});
          }
          return radius;
        });
  }

  void cross_triangle(const Vec3& from, const Vec3& path, std::int32_t segment,
                      const std::array<std::int32_t, 3>& rows)
  {
    const bool is_edge = rows[1] == rows[2];
    struct Plane
    {
      Vec3 first, second, normal, node; // edges, their product, from a vertex
    };
    const auto at = [&](double s) noexcept
    {
      const Vec3 corner = _surface.at(rows[0], s);
      const Vec3 first = _surface.at(rows[1], s) - corner;
      const Vec3 second
          = is_edge ? out_of_plane(first) : _surface.at(rows[2], s) - corner;
      return Plane{first, second, cross(first, second),
                   from + s * path - corner};
    };
    const double orientation = _surface.orientation[segment];
    const auto side = [&](double s) noexcept
    {
      const Plane p = at(s);
      // A node that lies on the surface is in front of it.
      const double size
          = std::sqrt(std::max(dot(p.first, p.first), dot(p.second, p.second)));
      return orientation * dot(p.node, p.normal)
             + on_plane * size * norm(p.normal);
    };
    cubic_zeros({side(0), side(1. / 3), side(2. / 3), side(1)},
                [&](double s, bool inward)
                {
                  const Plane p = at(s);
                  const double square = dot(p.normal, p.normal);
                  if (!(square > 0))
                    return;
                  const double u
                      = dot(cross(p.node, p.second), p.normal) / square,
                      v = dot(cross(p.first, p.node), p.normal) / square;
                  if (u >= -outside && v >= -outside && u + v <= 1 + outside)
                    _crossings.push_back(
                        {s, inward, segment,
                         (orientation / std::sqrt(square)) * p.normal});
                });
  }

  const MovingSurface& _surface;
  Tree _tree;
  std::vector<Crossing> _crossings; // crossings of the last node
};
} // namespace nts
