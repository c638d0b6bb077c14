#include "nts/search/boundary.h"
#include "array.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
void make(Boundary* place, const Doubles& x)
{
  check("x", x, {any, 3, 3});
  const nb::gil_scoped_release release;
  new (place) Boundary(view(x));
}

void move(Boundary& boundary, const Doubles& x)
{
  check("x", x, {boundary.size(), 3, 3});
  const nb::gil_scoped_release release;
  boundary.move(view(x));
}

/// @brief Evaluate a function of each point.
template <class T, class Function>
Out<T> each(const Doubles& points, const Function& function)
{
  check("points", points, {any, 3});
  auto values = create<T>({points.shape(0)});
  const nb::gil_scoped_release release;
  for (std::size_t i = 0; i < points.shape(0); ++i)
    values.data()[i] = function(vector(view(points), i));
  return values;
}

auto crossings(const Boundary& boundary, const Doubles& points)
{
  check("points", points, {any, 3});
  auto count = create<std::int32_t>({points.shape(0)});
  auto at_an_edge = create<bool>({points.shape(0)});
  {
    const nb::gil_scoped_release release;
    for (std::size_t i = 0; i < points.shape(0); ++i)
    {
      const auto found = boundary.crossings(vector(view(points), i));
      count.data()[i] = found.count;
      at_an_edge.data()[i] = found.at_an_edge;
    }
  }
  return std::tuple(count, at_an_edge);
}

auto cuts(const Boundary& boundary, const Doubles& begin, const Doubles& end)
{
  check("begin", begin, {any, 3});
  check("end", end, {begin.shape(0), 3});
  const auto found = boundary.cuts(view(begin), view(end));
  auto way = create<std::int32_t>({found.size()});
  auto s = create<double>({found.size()});
  std::ranges::transform(found, way.data(), &Boundary::WayCut::way);
  std::ranges::transform(found, s.data(), &Boundary::WayCut::s);
  return std::tuple(way, s);
}
} // namespace

void boundary(nb::module_& m)
{
  nb::class_<Boundary>(m, "Boundary",
                       "Triangles of the closed boundary of a body, or some of "
                       "them, and what is inside")
      .def("__init__", &make, nb::arg("x"),
           "(t, 3, 3) vertices in outward sense, which are copied")
      .def("move", &move, nb::arg("x"),
           "(t, 3, 3) other positions of the same vertices, which are copied")
      .def("crossings", &crossings, nb::arg("points"),
           "(n, 3) -> how often a ray leaves less how often it enters (n,), "
           "whether it hits an edge, so that the count may be wrong (n,)")
      .def(
          "winding",
          [](const Boundary& boundary, const Doubles& points)
          {
            return each<double>(points, [&](const Vec3& point)
                                { return boundary.winding(point); });
          },
          nb::arg("points"),
          "(n, 3) -> solid angle over 4 pi (n,), of all triangles 1 inside")
      .def(
          "distance",
          [](const Boundary& boundary, const Doubles& points)
          {
            return each<double>(points, [&](const Vec3& point)
                                { return boundary.distance(point); });
          },
          nb::arg("points"), "(n, 3) -> distance to the nearest triangle (n,)")
      .def("cuts", &cuts, nb::arg("begin"), nb::arg("end"),
           "(w, 3), (w, 3) -> which way and where on it, from 0 to 1, straight "
           "ways meet a triangle (c,), (c,)");
}
} // namespace nts::bindings
