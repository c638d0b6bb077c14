#include "boxes.h"
#include "nts/search/moving_boundaries.h"
#include "nts/search/paths.h"

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>
#include <optional>

namespace nts::bindings
{
namespace
{
using Rows = In<std::int32_t>;

/// @brief `nts::MovingBoundaries` with arrays that are kept alive.
class Boundaries
{
public:
  Boundaries(std::vector<Rows> nodes, std::vector<Rows> triangles)
      : _nodes(std::move(nodes)), _triangles(std::move(triangles)),
        _boundaries(views("nodes", _nodes, {any}),
                    views("triangles", _triangles, {any, 3}))
  {
    if (_triangles.size() != _nodes.size())
      throw nb::value_error(
          "triangles: expected one array for each array of nodes");
  }

  void move(Doubles x)
  {
    check_positions("x", x);
    _x = std::move(x);
    _boundaries.move(view(*_x));
  }

  auto extents() { return extremes(placed().extents()); }

  auto displacements(const Doubles& x, const Doubles& before) const
  {
    check_positions("x", x);
    check_positions("before", before);
    return extremes(_boundaries.displacements(view(x), view(before)));
  }

  auto crossings(const Doubles& points, const Rows& where, const Doubles& boxes)
  {
    check_points("points", points, 3, where);
    check("boxes", boxes, {2, _boundaries.size(), 3});
    auto found = create<std::int32_t>({2, points.shape(0)});
    for (std::size_t i = 0; i < points.shape(0); ++i)
    {
      const Box whole = box_by_corners(boxes, where.data()[i]);
      const auto [count, at_an_edge]
          = at(where, i).crossings(vector(view(points), i), whole);
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
      values.data()[i] = at(where, i).winding(vector(view(points), i));
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
      values.data()[i] = outside
                             ? 0.
                             : at(where, i).distance(vector(view(points), i),
                                                     least.data()[i]);
    }
    return values;
  }

  auto cuts(const Doubles& paths, const Rows& where)
  {
    check_points("paths", paths, 6, where);
    std::vector<PathCut> found;
    for (std::size_t i = 0; i < paths.shape(0); ++i)
    {
      const Vec3 begin = vector(view(paths), 2 * i),
                 end = vector(view(paths), 2 * i + 1);
      at(where, i).cuts(
          begin, end, [&](double s, int side)
          { found.push_back({static_cast<std::int32_t>(i), s, side}); });
    }
    auto path = create<std::int32_t>({found.size(), 2});
    auto s = create<double>({found.size()});
    for (std::size_t i = 0; i < found.size(); ++i)
    {
      path.data()[2 * i] = found[i].path;
      path.data()[2 * i + 1] = found[i].side;
      s.data()[i] = found[i].s;
    }
    return std::tuple(path, s);
  }

private:
  /// @brief Views of arrays of rows, which are checked.
  std::vector<std::span<const std::int32_t>>
  views(const char* name, const std::vector<Rows>& arrays,
        std::initializer_list<std::size_t> shape)
  {
    std::vector<std::span<const std::int32_t>> views;
    for (const Rows& rows : arrays)
    {
      check(name, rows, shape);
      views.push_back(view(rows));
      for (const std::int32_t row : views.back())
      {
        if (row < 0)
          throw nb::value_error("expected no negative row");
        _num_rows = std::max(_num_rows, static_cast<std::size_t>(row) + 1);
      }
    }
    return views;
  }

  /// @brief The boundaries, after a check that they have positions.
  MovingBoundaries& placed()
  {
    if (!_x)
      throw nb::value_error("expected an earlier call of move");
    return _boundaries;
  }

  const Boundary& at(const Rows& where, std::size_t i)
  {
    return placed().at(static_cast<std::size_t>(where.data()[i]));
  }

  void check_positions(const char* name, const Doubles& x) const
  {
    check(name, x, {any, 3});
    if (x.shape(0) < _num_rows)
      throw nb::value_error(
          "x: expected a row for each node of the boundaries");
  }

  void check_points(const char* name, const Doubles& points, std::size_t width,
                    const Rows& where) const
  {
    check(name, points, {any, width});
    check("where", where, {points.shape(0)});
    check_rows("where: expected numbers of boundaries", where,
               _boundaries.size());
  }

  std::vector<Rows> _nodes, _triangles;
  std::size_t _num_rows = 0;
  MovingBoundaries _boundaries;
  std::optional<Doubles> _x;
};
} // namespace

void boundary(nb::module_& m)
{
  nb::class_<Boundaries>(
      m, "Boundaries",
      "Closed boundaries that move, or parts of them, and what is inside; the "
      "arrays are read, not copied")
      .def(nb::init<std::vector<Rows>, std::vector<Rows>>(), nb::arg("nodes"),
           nb::arg("triangles"),
           "for each boundary rows of positions: (n,), and (t, 3) vertices in "
           "outward sense")
      .def("move", &Boundaries::move, nb::arg("x"),
           "(l, 3) positions, which must stay as they are until the next call")
      .def("extents", &Boundaries::extents,
           "-> least coordinates and negative greatest ones of the nodes "
           "(2, g, 3)")
      .def("displacements", &Boundaries::displacements, nb::arg("x"),
           nb::arg("before"),
           "(l, 3), (l, 3) -> least coordinates and negative greatest ones of "
           "the displacements of the nodes (2, g, 3)")
      .def("crossings", &Boundaries::crossings, nb::arg("points"),
           nb::arg("where"), nb::arg("boxes"),
           "(n, 3), (n,) numbers of boundaries, (2, g, 3) corners of boxes "
           "around the whole of them -> how often a ray leaves less how often "
           "it enters, and whether it hits an edge, so that the count may be "
           "wrong (2, n)")
      .def("winding", &Boundaries::winding, nb::arg("points"), nb::arg("where"),
           "(n, 3), (n,) -> solid angle over 4 pi (n,), of all triangles 1 "
           "inside")
      .def("distance", &Boundaries::distance, nb::arg("points"),
           nb::arg("where"), nb::arg("least"), nb::arg("crossings"),
           "(n, 3), (n,), (n,), (2, n) sum over all parts of a boundary -> "
           "distance to the nearest triangle (n,), or to another that is as "
           "near as the third argument; 0 where crossings say outside")
      .def("cuts", &Boundaries::cuts, nb::arg("paths"), nb::arg("where"),
           "(w, 6) begins and ends, (w,) -> where straight paths meet a "
           "triangle: which path, and 1 if it leaves the boundary there, -1 if "
           "it enters it, 0 at edges of triangles (c, 2); and where on it, "
           "from 0 to 1 (c,)");
}
} // namespace nts::bindings
