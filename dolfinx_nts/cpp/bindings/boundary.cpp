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

auto winding(const Boundary& boundary, const Doubles& points)
{
  check("points", points, {any, 3});
  auto values = create<double>({points.shape(0)});
  const nb::gil_scoped_release release;
  for (std::size_t i = 0; i < points.shape(0); ++i)
    values.data()[i] = boundary.winding(vector(view(points), i));
  return values;
}

auto distance(const Boundary& boundary, const Doubles& points,
              const Doubles& least)
{
  check("points", points, {any, 3});
  check("least", least, {points.shape(0)});
  auto values = create<double>({points.shape(0)});
  const nb::gil_scoped_release release;
  for (std::size_t i = 0; i < points.shape(0); ++i)
    values.data()[i]
        = boundary.distance(vector(view(points), i), least.data()[i]);
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

auto cuts(const Boundary& boundary, const Doubles& ways)
{
  check("ways", ways, {any, 6});
  const auto found = boundary.cuts(view(ways));
  auto way = create<std::int32_t>({found.size()});
  auto s = create<double>({found.size()});
  std::ranges::transform(found, way.data(), &WayCut::way);
  std::ranges::transform(found, s.data(), &WayCut::s);
  return std::tuple(way, s);
}

auto parts(const Doubles& ways, const In<std::int32_t>& way, const Doubles& s)
{
  check("ways", ways, {any, 6});
  check("s", s, {way.size()});
  check_rows("way: expected rows of ways", way, ways.shape(0));
  std::vector<WayCut> cuts(way.size());
  for (std::size_t i = 0; i < cuts.size(); ++i)
    cuts[i] = {way.data()[i], s.data()[i]};
  std::vector<std::int32_t> numbers;
  std::vector<Vec3> middles;
  parts_of_ways(view(ways), std::move(cuts),
                [&](std::int32_t number, const Vec3& middle)
                {
                  numbers.push_back(number);
                  middles.push_back(middle);
                });
  auto middle = create<double>({middles.size(), 3});
  auto number = create<std::int32_t>({numbers.size()});
  for (std::size_t i = 0; i < middles.size(); ++i)
    std::ranges::copy(middles[i], middle.data() + 3 * i);
  std::ranges::copy(numbers, number.data());
  return std::tuple(middle, number);
}

/// @brief Positions of rows of nodes whose boxes meet a box.
auto rows_in(const Doubles& x, const In<std::int32_t>& rows, const Doubles& box)
{
  check("x", x, {any, 3});
  check("rows", rows, {any, any});
  check("box", box, {2, 3});
  check_rows("rows: expected rows of x", rows, x.shape(0));
  const std::size_t k = rows.shape(1);
  const Box region{vector(view(box), 0), vector(view(box), 1)};
  std::vector<std::int32_t> found;
  for (std::size_t i = 0; i < rows.shape(0); ++i)
    if (bounds(view(x), view(rows).subspan(k * i, k)).meets(region))
      found.push_back(static_cast<std::int32_t>(i));
  auto positions = create<double>({found.size(), 3 * k});
  double* place = positions.data();
  for (const std::int32_t i : found)
    for (std::size_t a = 0; a < k; ++a, place += 3)
      std::ranges::copy(vector(view(x), rows.data()[k * i + a]), place);
  return positions;
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
      .def("winding", &winding, nb::arg("points"),
           "(n, 3) -> solid angle over 4 pi (n,), of all triangles 1 inside")
      .def("distance", &distance, nb::arg("points"), nb::arg("least"),
           "(n, 3), (n,) -> distance to the nearest triangle (n,), or to "
           "another that is as near as the second argument")
      .def("cuts", &cuts, nb::arg("ways"),
           "(w, 6) begins and ends -> which way and where on it, from 0 to 1, "
           "straight ways meet a triangle (c,), (c,)");
  m.def("parts_of_ways", &parts, nb::arg("ways"), nb::arg("way"), nb::arg("s"),
        "(w, 6), (c,), (c,) cuts as of Boundary.cuts -> middles of the parts "
        "of ways that are cut (m, 3), and the way of each (m,)");
  m.def("rows_in", &rows_in, nb::arg("x"), nb::arg("rows"), nb::arg("box"),
        "(l, 3), (n, k) rows of x, (2, 3) -> positions of those whose box "
        "meets the given one (m, 3 k)");
}
} // namespace nts::bindings
