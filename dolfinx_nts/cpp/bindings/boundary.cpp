#include "nts/search/boundary.h"
#include "array.h"
#include "nts/search/meetings.h"

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>
#include <optional>

namespace nts::bindings
{
namespace
{
using Rows = In<std::int32_t>;

/// @brief Least coordinates of n boxes, and negative greatest ones, (2, n, 3).
template <class BoxOf>
auto corners(std::size_t n, BoxOf&& box_of)
{
  auto least = create<double>({2, n, 3});
  for (std::size_t i = 0; i < n; ++i)
  {
    const Box box = box_of(i);
    for (std::size_t c = 0; c < 3; ++c)
    {
      least.data()[3 * i + c] = box.lower[c];
      least.data()[3 * (n + i) + c] = -box.upper[c];
    }
  }
  return least;
}

/// @brief Positions that are found one after another, each with a number.
class Found
{
public:
  void add(std::int32_t number, std::initializer_list<Vec3> positions)
  {
    _numbers.push_back(number);
    for (const Vec3& position : positions)
      std::ranges::copy(position, std::back_inserter(_positions));
  }

  /// @brief All positions (n, width), and all numbers (n).
  auto arrays(std::size_t width) const
  {
    auto positions = create<double>({_numbers.size(), width});
    auto numbers = create<std::int32_t>({_numbers.size()});
    std::ranges::copy(_positions, positions.data());
    std::ranges::copy(_numbers, numbers.data());
    return std::tuple(positions, numbers);
  }

private:
  std::vector<double> _positions;
  std::vector<std::int32_t> _numbers;
};

/// @brief Boundaries that move, by arrays that are not copied, and a tree over
/// each, which is made at the first positions and moved when it is asked.
class MovingBoundaries
{
public:
  MovingBoundaries(std::vector<Rows> nodes, std::vector<Rows> triangles)
      : _nodes(std::move(nodes)), _triangles(std::move(triangles)),
        _moved(_nodes.size())
  {
    if (_triangles.size() != _nodes.size())
      throw nb::value_error("triangles: expected as many arrays as nodes");
    for (std::size_t i = 0; i < _nodes.size(); ++i)
    {
      check("nodes", _nodes[i], {any});
      check("triangles", _triangles[i], {any, 3});
      for (const Rows& rows : {_nodes[i], _triangles[i]})
        for (const std::int32_t row : view(rows))
        {
          if (row < 0)
            throw nb::value_error("expected no negative row");
          _num_rows = std::max(_num_rows, static_cast<std::size_t>(row) + 1);
        }
    }
  }

  void move(Doubles x)
  {
    check_positions("x", x);
    _x = std::move(x);
    _moved.assign(_nodes.size(), !_boundaries.empty());
    if (_boundaries.empty())
      for (const Rows& triangles : _triangles)
        _boundaries.emplace_back(positions(), view(triangles));
  }

  auto extents() const
  {
    return corners(_nodes.size(), [&](std::size_t i)
                   { return bounds(positions(), view(_nodes[i])); });
  }

  auto displacements(const Doubles& x, const Doubles& before) const
  {
    check_positions("x", x);
    check_positions("before", before);
    return corners(_nodes.size(),
                   [&](std::size_t i)
                   {
                     Box box;
                     for (const std::int32_t row : view(_nodes[i]))
                       box.include(vector(view(x), row)
                                   - vector(view(before), row));
                     return box;
                   });
  }

  /// @brief Which boxes overlap, in both orders, where, and how far all are
  /// apart.
  auto meetings(const Doubles& boxes, const Doubles& touch) const
  {
    const std::size_t n = _nodes.size();
    check("boxes", boxes, {2, n, 3});
    check("touch", touch, {n});
    std::vector<Box> around;
    for (std::size_t i = 0; i < n; ++i)
      around.push_back(box(boxes, i));
    auto apart = create<double>({n, n});
    const std::vector<Meeting> found
        = nts::meetings(around, view(touch), {apart.data(), n * n});
    auto pair = create<std::int32_t>({found.size(), 2});
    auto depth = create<double>({found.size()}),
         region = create<double>({found.size(), 2, 3});
    for (std::size_t p = 0; p < found.size(); ++p)
    {
      const Meeting& meeting = found[p];
      std::ranges::copy(std::array{meeting.inner, meeting.outer},
                        pair.data() + 2 * p);
      depth.data()[p] = meeting.depth;
      std::ranges::copy(meeting.region.lower, region.data() + 6 * p);
      std::ranges::copy(meeting.region.upper, region.data() + 6 * p + 3);
    }
    return std::tuple(apart, pair, depth, region);
  }

  auto crossings(const Doubles& points, const Rows& where, const Doubles& boxes)
  {
    check_points("points", points, 3, where);
    check("boxes", boxes, {2, _nodes.size(), 3});
    auto found = create<std::int32_t>({2, points.shape(0)});
    for (std::size_t i = 0; i < points.shape(0); ++i)
    {
      const std::size_t w = view(where)[i];
      const auto [count, at_an_edge]
          = at(w).crossings(vector(view(points), i), box(boxes, w));
      found.data()[i] = count;
      found.data()[points.shape(0) + i] = at_an_edge;
    }
    return found;
  }

  auto winding(const Doubles& points, const Rows& where)
  {
    check_points("points", points, 3, where);
    auto values = create<double>({points.shape(0)});
    for (std::size_t i = 0; i < points.shape(0); ++i)
      values.data()[i] = at(view(where)[i]).winding(vector(view(points), i));
    return values;
  }

  auto distance(const Doubles& points, const Rows& where, const Doubles& least,
                const Rows& crossings)
  {
    const std::size_t n = points.shape(0);
    check_points("points", points, 3, where);
    check("least", least, {n});
    check("crossings", crossings, {2, n});
    auto values = create<double>({n});
    for (std::size_t i = 0; i < n; ++i)
    {
      const bool outside
          = crossings.data()[i] <= 0 && crossings.data()[n + i] == 0;
      values.data()[i]
          = outside ? 0.
                    : at(view(where)[i])
                          .distance(vector(view(points), i), least.data()[i]);
    }
    return values;
  }

  auto cuts(const Doubles& ways, const Rows& where)
  {
    check_points("ways", ways, 6, where);
    std::vector<WayCut> found;
    for (std::size_t i = 0; i < ways.shape(0); ++i)
    {
      const Vec3 begin = vector(view(ways), 2 * i),
                 end = vector(view(ways), 2 * i + 1);
      at(view(where)[i])
          .cuts(begin, end, [&](double s, int side)
                { found.push_back({static_cast<std::int32_t>(i), s, side}); });
    }
    auto way = create<std::int32_t>({found.size(), 2});
    auto s = create<double>({found.size()});
    for (std::size_t i = 0; i < found.size(); ++i)
    {
      way.data()[2 * i] = found[i].way;
      way.data()[2 * i + 1] = found[i].side;
      s.data()[i] = found[i].s;
    }
    return std::tuple(way, s);
  }

private:
  Box box(const Doubles& boxes, std::size_t i) const
  {
    return {vector(view(boxes), i), vector(view(boxes), _nodes.size() + i)};
  }

  std::span<const double> positions() const
  {
    if (!_x)
      throw nb::value_error("expected a call of move before");
    return view(*_x);
  }

  /// @brief The boundary with this number, where it is now.
  const Boundary& at(std::size_t number)
  {
    const std::span<const double> x = positions();
    if (_moved[number])
      _boundaries[number].move(x);
    _moved[number] = false;
    return _boundaries[number];
  }

  void check_positions(const char* name, const Doubles& x) const
  {
    check(name, x, {any, 3});
    if (x.shape(0) < _num_rows)
      throw nb::value_error("x: expected all rows of the boundaries");
  }

  void check_points(const char* name, const Doubles& points, std::size_t width,
                    const Rows& where) const
  {
    check(name, points, {any, width});
    check("where", where, {points.shape(0)});
    check_rows("where: expected numbers of boundaries", where, _nodes.size());
  }

  std::vector<Rows> _nodes, _triangles;
  std::vector<Boundary> _boundaries;
  std::vector<bool> _moved;
  std::size_t _num_rows = 0;
  std::optional<Doubles> _x;
};

/// @brief Bounds on how much boundaries have come nearer to each other, from
/// the extremes of their displacements.
auto nearer(const Doubles& displacements)
{
  check("displacements", displacements, {2, any, 3});
  const std::size_t n = displacements.shape(1);
  const auto least
      = [&](std::size_t i) { return vector(view(displacements), i); };
  const auto negative_greatest
      = [&](std::size_t i) { return vector(view(displacements), n + i); };
  auto values = create<double>({n, n});
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
    {
      const Vec3 one = negative_greatest(i) + least(j),
                 other = negative_greatest(j) + least(i);
      Vec3 apart;
      for (std::size_t c = 0; c < 3; ++c)
        apart[c] = std::min(one[c], other[c]);
      values.data()[n * i + j] = i == j ? 0 : norm(apart);
    }
  return values;
}

/// @brief Points on ways, and a number of each way by which they are found
/// again.
auto points_on_ways(const Doubles& ways, const Rows& number, const Rows& way,
                    const Doubles& s)
{
  check("ways", ways, {any, 6});
  check("number", number, {ways.shape(0)});
  check("way", way, {s.size(), 2});
  std::vector<WayCut> cuts(s.size());
  for (std::size_t i = 0; i < cuts.size(); ++i)
  {
    cuts[i] = {way.data()[2 * i], s.data()[i], way.data()[2 * i + 1]};
    if (cuts[i].way < 0
        || static_cast<std::size_t>(cuts[i].way) >= ways.shape(0))
      throw nb::value_error("way: expected rows of ways");
  }
  Found found;
  points_of_ways(view(ways), std::move(cuts),
                 [&](std::int32_t w, const Vec3& point)
                 { found.add(number.data()[w], {point}); });
  return found.arrays(3);
}

/// @brief Nodes and edges in regions, as ways, and the number of the region.
auto ways_in_regions(const Doubles& x, const std::vector<Rows>& nodes,
                     const std::vector<Rows>& edges, const Rows& which,
                     const Doubles& regions)
{
  check("x", x, {any, 3});
  check("regions", regions, {which.size(), 2, 3});
  check_rows("which: expected numbers of boundaries", which,
             std::min(nodes.size(), edges.size()));
  Found found;
  for (std::size_t r = 0; r < which.size(); ++r)
  {
    const Rows &some = nodes[view(which)[r]], &others = edges[view(which)[r]];
    check("nodes", some, {any});
    check("edges", others, {any, 2});
    for (const Rows& rows : {some, others})
      check_rows("nodes, edges: expected rows of x", rows, x.shape(0));
    ways_in(view(x), view(some), view(others),
            {vector(view(regions), 2 * r), vector(view(regions), 2 * r + 1)},
            [&](const Vec3& begin, const Vec3& end)
            { found.add(static_cast<std::int32_t>(r), {begin, end}); });
  }
  return found.arrays(6);
}
} // namespace

void boundary(nb::module_& m)
{
  nb::class_<MovingBoundaries>(
      m, "Boundaries",
      "Closed boundaries that move, or parts of them, and what is inside; the "
      "arrays are read, not copied")
      .def(nb::init<std::vector<Rows>, std::vector<Rows>>(), nb::arg("nodes"),
           nb::arg("triangles"),
           "for each boundary rows of positions: (n,), and (t, 3) vertices in "
           "outward sense")
      .def("move", &MovingBoundaries::move, nb::arg("x"),
           "(l, 3) positions, which must stay as they are until the next call")
      .def("extents", &MovingBoundaries::extents,
           "-> least coordinates and negative greatest ones of the nodes "
           "(2, g, 3)")
      .def("meetings", &MovingBoundaries::meetings, nb::arg("boxes"),
           nb::arg("touch"),
           "(2, g, 3) corners of boxes around the whole of each boundary, (g,) "
           "-> distances of any two boxes (g, g), 0 where they overlap and "
           "infinite on the diagonal; "
           "those two that overlap by more than a touch, in both orders "
           "(p, 2); that touch (p,); and boxes around all that may be deeper "
           "in the second (p, 2, 3)")
      .def("displacements", &MovingBoundaries::displacements, nb::arg("x"),
           nb::arg("before"),
           "(l, 3), (l, 3) -> least coordinates and negative greatest ones of "
           "the displacements of the nodes (2, g, 3)")
      .def("crossings", &MovingBoundaries::crossings, nb::arg("points"),
           nb::arg("where"), nb::arg("boxes"),
           "(n, 3), (n,) numbers of boundaries, (2, g, 3) corners of boxes "
           "around the whole of them -> how often a ray leaves less how often "
           "it enters, and whether it hits an edge, so that the count may be "
           "wrong (2, n)")
      .def("winding", &MovingBoundaries::winding, nb::arg("points"),
           nb::arg("where"),
           "(n, 3), (n,) -> solid angle over 4 pi (n,), of all triangles 1 "
           "inside")
      .def("distance", &MovingBoundaries::distance, nb::arg("points"),
           nb::arg("where"), nb::arg("least"), nb::arg("crossings"),
           "(n, 3), (n,), (n,), (2, n) sum over all parts of a boundary -> "
           "distance to the nearest triangle (n,), or to another that is as "
           "near as the third argument; 0 where crossings say outside")
      .def("cuts", &MovingBoundaries::cuts, nb::arg("ways"), nb::arg("where"),
           "(w, 6) begins and ends, (w,) -> where straight ways meet a "
           "triangle: which way, and 1 if it leaves the boundary there, -1 if "
           "it enters it, 0 at edges of triangles (c, 2); and where on it, "
           "from 0 to 1 (c,)");
  m.def("nearer", &nearer, nb::arg("displacements"),
        "(2, g, 3) as of Boundaries.displacements -> bound on how much each "
        "two boundaries have come nearer to each other, 0 on the diagonal "
        "(g, g)");
  m.def("points_on_ways", &points_on_ways, nb::arg("ways"), nb::arg("number"),
        nb::arg("way"), nb::arg("s"),
        "(w, 6), (w,), (c, 2), (c,) cuts as of Boundaries.cuts -> ways that "
        "are points, then middles of the parts of ways that are cut and not "
        "known to be outside (m, 3), and the number of the way of each (m,)");
  m.def("ways_in", &ways_in_regions, nb::arg("x"), nb::arg("nodes"),
        nb::arg("edges"), nb::arg("which"), nb::arg("regions"),
        "(l, 3), for each boundary rows of x (n,) and (e, 2), (r,) the "
        "boundary of each region, (r, 2, 3) -> begin and end of nodes, which "
        "are the same, and of edges whose box meets the region (w, 6), and "
        "number of the region (w,)");
}
} // namespace nts::bindings
