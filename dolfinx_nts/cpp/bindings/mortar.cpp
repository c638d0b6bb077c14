#include "array.h"
#include "nts/contact/aggregation.h"
#include "nts/search/mortar_points.h"
#include "nts/solvers/small_system.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;
using Keys = In<std::int64_t>;

template <class T>
Out<T> array(const std::vector<T>& values)
{
  auto copy = create<T>({values.size()});
  std::ranges::copy(values, copy.data());
  return copy;
}

Out<double> rows(const std::vector<double>& values, std::size_t width)
{
  auto copy = create<double>({values.size() / width, width});
  std::ranges::copy(values, copy.data());
  return copy;
}

/// @brief Call function.template operator()<F>() for facets with n nodes that
/// face segments with k vertices.
template <class Function>
void dispatch_whole_facets(std::size_t n, std::size_t k, Function&& function)
{
  if (n == k)
    return dispatch(k, std::forward<Function>(function));
  if (n == 3 && k == 2)
    return function.template operator()<Line3>();
  if (n == 6 && k == 3)
    return function.template operator()<Tri6>();
  if (n == 9 && k == 4)
    return function.template operator()<Quad9>();
  throw nb::value_error("facets: expected as many nodes as segments have "
                        "vertices (2, 3 or 4), or 3, 6 or 9 at degree 2");
}

auto find_points(const Ints& facets, const Doubles& facet_orientation,
                 const Doubles& X, const Doubles& x_n, const Doubles& x,
                 const Ints& segments, const Doubles& orientation,
                 const Keys& key, const Doubles& thickness, const Doubles& y_n,
                 const Doubles& y, double reach, double sunk, bool are_rings,
                 bool are_smooth)
{
  check("facets", facets, {any, any});
  check("facet_orientation", facet_orientation, {facets.shape(0)});
  check("X", X, {any, 3});
  check("x_n", x_n, {X.shape(0), 3});
  check("x", x, {X.shape(0), 3});
  check_rows("facets: expected row numbers of x", facets, x.shape(0));
  check("segments", segments, {any, any});
  check("orientation", orientation, {segments.shape(0)});
  check("key", key, {segments.shape(0)});
  check("thickness", thickness, {segments.shape(0)});
  check("y_n", y_n, {any, 3});
  check("y", y, {y_n.shape(0), 3});
  check_rows("segments: expected row numbers of y", segments, y.shape(0));
  const std::size_t n = facets.shape(1), k = segments.shape(1);
  MortarPoints points;
  dispatch_whole_facets(
      n, k,
      [&]<class F>()
      {
        const SegmentSurface<F> upper{
            view(x), view(facets), view(facet_orientation), {}};
        const SegmentSurface<typename F::Linear> lower{
            view(y), view(segments), view(orientation), view(key), sunk};
        std::vector<Box> boxes;
        for (std::size_t s = 0; s < segments.shape(0); ++s)
          boxes.push_back(lower.box(s));
        MortarSearch<F> search(upper, lower,
                               {view(X), view(x_n), view(y_n), view(thickness),
                                are_rings, are_smooth},
                               reach);
        points = search.find(Tree(std::move(boxes)));
      });
  return std::tuple(array(points.facet), array(points.segment),
                    array(points.weight), rows(points.phi, n),
                    rows(points.psi, k), array(points.step));
}

/// @brief Points and shares, checked.
Aggregation aggregation(const Doubles& phi, const Keys& start,
                        const Ints& point, const Doubles& share,
                        const Ints& place, std::size_t length,
                        std::size_t vertices)
{
  check("phi", phi, {any, any});
  check("start", start, {any});
  check("point", point, {any});
  const std::size_t size = point.size();
  check("place", place, {size, phi.shape(1) + vertices});
  check_rows("point: expected row numbers of phi", point, phi.shape(0));
  check_rows("place: expected places in rows", place, length);
  const auto begin = view(start);
  if (begin.empty() || begin.front() != 0
      || begin.back() != static_cast<std::int64_t>(size)
      || !std::ranges::is_sorted(begin))
    throw nb::value_error(
        "start: expected ascending offsets, from 0 to the number of shares");
  return {.phi = view(phi),
          .width = phi.shape(1),
          .start = begin,
          .point = view(point),
          .share = view(share),
          .place = view(place)};
}

auto sum_rows(const Doubles& phi, const Keys& start, const Ints& point,
              const Doubles& share, const Ints& place, std::size_t length,
              const Doubles& values)
{
  check("values", values, {any, any, any});
  const std::size_t count = values.shape(1), vertices = values.shape(2) / 3 - 1;
  const Aggregation a
      = aggregation(phi, start, point, share, place, length, vertices);
  check("values", values, {phi.shape(0), count, 3 * (1 + vertices)});
  check("share", share, {point.size(), count, count});
  auto sums = create<double>({start.size() - 1, count, 3 * length});
  std::fill_n(sums.data(), sums.size(), 0.0);
  sum_to_rows(a, vertices, view(values), count, length, view(sums));
  return sums;
}

auto sum_contact(const Doubles& phi, const Keys& start, const Ints& point,
                 const Doubles& share, const Ints& place, std::size_t length,
                 const Doubles& gap_n, const Doubles& gap, const Doubles& turn,
                 const Doubles& force, const Doubles& gradient)
{
  check("force", force, {any, any});
  const std::size_t p = force.shape(0), vertices = force.shape(1) / 3 - 1;
  const Aggregation a
      = aggregation(phi, start, point, share, place, length, vertices);
  check("phi", phi, {p, any});
  check("share", share, {point.size()});
  for (const Doubles* values : {&gap_n, &gap, &turn})
    check("gap_n, gap and turn", *values, {p});
  for (const Doubles* values : {&force, &gradient})
    check("force and gradient", *values, {p, 3 * (1 + vertices)});
  const std::size_t n = start.size() - 1;
  const auto scalars = [n] { return create<double>({n}); };
  const auto summed = [&](const Doubles& values)
  {
    auto rows = create<double>({n, 3 * length});
    std::fill_n(rows.data(), rows.size(), 0.0);
    sum_to_rows(a, vertices, view(values), 1, length, view(rows));
    return rows;
  };
  auto gaps_n = scalars(), gaps = scalars(), turns = scalars();
  means(a, view(gap_n), view(gaps_n));
  means(a, view(gap), view(gaps));
  least(a, view(turn), view(turns));
  return std::tuple(gaps_n, gaps, summed(force), summed(gradient), turns);
}

auto sum_blocks(const Doubles& phi, const Ints& block, std::size_t count,
                const Doubles& factor, const Doubles& matrix)
{
  check("phi", phi, {any, any});
  const std::size_t p = phi.shape(0);
  check("block", block, {p});
  check_rows("block: expected numbers of blocks", block, count);
  check("factor", factor, {p});
  check("matrix", matrix, {p, any, any});
  const std::size_t vertices = matrix.shape(1) / 3 - 1,
                    n = 3 * (phi.shape(1) + vertices);
  check("matrix", matrix, {p, 3 * (1 + vertices), 3 * (1 + vertices)});
  auto sums = create<double>({count, n, n});
  std::fill_n(sums.data(), sums.size(), 0.0);
  sum_to_blocks(view(phi), phi.shape(1), vertices, view(block), view(factor),
                view(matrix), view(sums));
  return sums;
}

auto points_of(const Doubles& phi, const Ints& nodes, const Doubles& x)
{
  check("phi", phi, {any, any});
  check("nodes", nodes, {phi.shape(0), any});
  check("x", x, {any, 3});
  check_rows("nodes: expected row numbers of x", nodes, x.shape(0));
  if (nodes.shape(1) < phi.shape(1))
    throw nb::value_error(
        "nodes: expected at least as many columns as phi has");
  auto out = create<double>({phi.shape(0), 3});
  at_points(view(phi), phi.shape(1), view(nodes), nodes.shape(1), view(x),
            view(out));
  return out;
}

auto eliminated_directions(const Ints& rank, const Doubles& rows,
                           const Doubles& normal, std::size_t c)
{
  const std::size_t m = rank.size();
  check("rank", rank, {m});
  check("normal", normal, {m, any});
  const std::size_t b = normal.shape(1);
  check("rows", rows, {m, any, any});
  check_rows("rank: expected as many directions and rows", rank,
             1 + std::min(c, rows.shape(1)));
  if (b == 0 || rows.shape(2) < b)
    throw nb::value_error("rows: expected at least the components of one node");
  auto directions = create<double>({m, c, b});
  nts::eliminated_directions(
      {{}, view(rank), view(rows), rows.shape(2) / b, rows.shape(1)},
      view(normal), c, b, view(directions));
  return directions;
}

auto constraint_products(const Ints& nodes, const Ints& rank,
                         const Doubles& rows, const Ints& parents,
                         const Doubles& weights, const Doubles& directions)
{
  check("nodes", nodes, {any, any});
  const std::size_t m = nodes.shape(0), d = nodes.shape(1);
  check("rank", rank, {m});
  check("directions", directions, {any, any, any});
  const std::size_t c = directions.shape(0), l = directions.shape(1),
                    b = directions.shape(2);
  check("rows", rows, {m, any, d * b});
  check("parents", parents, {l, any});
  check("weights", weights, {l, parents.shape(1)});
  check_rows("nodes: expected row numbers of directions", nodes, l);
  check_rows("parents: expected row numbers of directions", parents, l);
  check_rows("rank: expected as many directions and rows", rank,
             1 + std::min(c, rows.shape(1)));
  const Entries entries = products(
      {view(nodes), view(rank), view(rows), d, rows.shape(1)},
      {view(parents), view(weights), parents.shape(1)}, view(directions), c, b);
  return std::tuple(array(entries.row), array(entries.column),
                    array(entries.value));
}

void small_system(nb::module_& m)
{
  nb::class_<SmallSystem>(
      m, "SmallSystem",
      "A sparse system near to a diagonal one, see nts/solvers/small_system.h")
      .def(
          "__init__",
          [](SmallSystem* self, const Keys& number, const Keys& row,
             const Keys& column, const Doubles& value)
          {
            check("number", number, {any});
            check("row", row, {any});
            check("column", column, {row.size()});
            check("value", value, {row.size()});
            SmallSystem system(view(number));
            if (!system.fill(view(row), view(column), view(value)))
              throw nb::value_error(
                  "number: expected every number that row and column contain");
            new (self) SmallSystem(std::move(system));
          },
          nb::arg("number"), nb::arg("row"), nb::arg("column"),
          nb::arg("value"),
          "Numbers of rows and columns (n,), and entries by these (e,), (e,), "
          "(e,)")
      .def(
          "solve",
          [](const SmallSystem& self, const Doubles& b)
          {
            check("b", b, {self.size()});
            auto x = create<double>({self.size()});
            self.solve(view(b), view(x));
            return x;
          },
          nb::arg("b"), "(n,) -> (n,), NaN where it fails");
}
} // namespace

void mortar(nb::module_& m)
{
  m.def(
      "mortar_points", &find_points, nb::arg("facets"),
      nb::arg("facet_orientation"), nb::arg("X"), nb::arg("x_n"), nb::arg("x"),
      nb::arg("segments"), nb::arg("orientation"), nb::arg("key"),
      nb::arg("thickness"), nb::arg("y_n"), nb::arg("y"), nb::arg("reach"),
      nb::arg("sunk"), nb::arg("are_rings"), nb::arg("are_smooth"),
      "(f, n) rows of positions (f,), (l, 3), (l, 3), (l, 3), (s, k) rows of "
      "other positions (s,), (s,), (s,), (v, 3), (v, 3), -, -, -, - -> facet, "
      "segment, weight of each point (p,), phi (p, n), psi (p, k) and step of "
      "each facet (f,), see nts/search/mortar_points.h");
  m.def("sum_rows", &sum_rows, nb::arg("phi"), nb::arg("start"),
        nb::arg("point"), nb::arg("share"), nb::arg("place"), nb::arg("length"),
        nb::arg("values"),
        "(p, k), (n + 1,), (i,), (i, c, c), (i, k + s), L, (p, c, 3 (1 + s)) "
        "-> (n, c, 3 L), see nts/contact/aggregation.h");
  m.def("sum_contact", &sum_contact, nb::arg("phi"), nb::arg("start"),
        nb::arg("point"), nb::arg("share"), nb::arg("place"), nb::arg("length"),
        nb::arg("gap_n"), nb::arg("gap"), nb::arg("turn"), nb::arg("force"),
        nb::arg("gradient"),
        "(p, k), (n + 1,), (i,), (i,), (i, k + s), L, (p,), (p,), (p,), (p, 3 "
        "(1 + s)), (p, 3 (1 + s)) -> means of both gaps (n,), (n,), rows (n, 3 "
        "L), (n, 3 L), and least turn (n,)");
  m.def("sum_blocks", &sum_blocks, nb::arg("phi"), nb::arg("block"),
        nb::arg("count"), nb::arg("factor"), nb::arg("matrix"),
        "(p, k), (p,), b, (p,), (p, 3 (1 + s), 3 (1 + s)) -> "
        "(b, 3 (k + s), 3 (k + s)), see nts/contact/aggregation.h");
  m.def("at_points", &points_of, nb::arg("phi"), nb::arg("nodes"), nb::arg("x"),
        "(p, k), (p, at least k), (n, 3) -> (p, 3), see "
        "nts/contact/aggregation.h");
  m.def("eliminated_directions", &eliminated_directions, nb::arg("rank"),
        nb::arg("rows"), nb::arg("normal"), nb::arg("count"),
        "(m,), (m, r, d b), (m, b), c -> directions (m, c, b), see "
        "nts/solvers/constraint_products.h");
  m.def("constraint_products", &constraint_products, nb::arg("nodes"),
        nb::arg("rank"), nb::arg("rows"), nb::arg("parents"),
        nb::arg("weights"), nb::arg("directions"),
        "(m, d), (m,), (m, r, d b), (l, h), (l, h), (c, l, b) -> row, column, "
        "value of entries (e,), see nts/solvers/constraint_products.h; with h "
        "= 0 nodes are their own parents");
  small_system(m);
}
} // namespace nts::bindings
