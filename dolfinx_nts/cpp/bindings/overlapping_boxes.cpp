#include "nts/search/overlapping_boxes.h"
#include "boxes.h"
#include "nts/search/facet_distance.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
auto overlapping_boxes_of(const Doubles& boxes, const Doubles& touch)
{
  const std::size_t n = touch.size();
  check("touch", touch, {n});
  check("boxes", boxes, {2, n, 3});
  std::vector<Box> around;
  for (std::size_t i = 0; i < n; ++i)
    around.push_back(box_by_corners(boxes, i));
  auto apart = create<double>({n, n});
  const std::vector<OverlappingBoxes> found
      = overlapping_boxes(around, view(touch), view(apart));
  auto pair = create<std::int32_t>({found.size(), 2});
  auto depth = create<double>({found.size()}),
       region = create<double>({found.size(), 2, 3});
  for (std::size_t p = 0; p < found.size(); ++p)
  {
    const OverlappingBoxes& both = found[p];
    pair.data()[2 * p] = both.inner;
    pair.data()[2 * p + 1] = both.outer;
    depth.data()[p] = both.depth;
    store(both.region.lower, view(region), 2 * p);
    store(both.region.upper, view(region), 2 * p + 1);
  }
  return std::tuple(apart, pair, depth, region);
}

auto approach_of(const Doubles& displacements)
{
  const std::vector<Box> boxes = boxes_by_extremes(displacements);
  auto nearer = create<double>({boxes.size(), boxes.size()});
  approach(boxes, view(nearer));
  return nearer;
}

bool facets_may_be_within(const Doubles& x, const In<std::int32_t>& facets,
                          const In<std::int32_t>& others, double reach)
{
  check("x", x, {any, 3});
  check("facets", facets, {any, any});
  check("others", others, {any, facets.shape(1)});
  check_rows("facets: expected row numbers of x", facets, x.shape(0));
  check_rows("others: expected row numbers of x", others, x.shape(0));
  return may_be_within(view(x), view(facets), view(others), facets.shape(1),
                       reach);
}
} // namespace

void overlapping_boxes(nb::module_& m)
{
  m.def("overlapping_boxes", &overlapping_boxes_of, nb::arg("boxes"),
        nb::arg("touch"),
        "(2, g, 3) corners of boxes around the whole of each boundary, (g,) "
        "-> distances of any two boxes (g, g), 0 where they overlap and "
        "infinite on the diagonal; those two that overlap by more than a "
        "touch, in both orders (p, 2); that touch (p,); and boxes around all "
        "that may be deeper in the second (p, 2, 3)");
  m.def("approach", &approach_of, nb::arg("displacements"),
        "(2, g, 3) as of Boundaries.displacements -> bound on how much each "
        "two boundaries have come nearer to each other, 0 on the diagonal "
        "(g, g)");
  m.def("facets_may_be_within", &facets_may_be_within, nb::arg("x"),
        nb::arg("facets"), nb::arg("others"), nb::arg("reach"),
        "(l, 3), (f, k) and (s, k) rows of x, - -> whether facets of both "
        "groups may be as near as that, see nts/search/facet_distance.h");
}
} // namespace nts::bindings
