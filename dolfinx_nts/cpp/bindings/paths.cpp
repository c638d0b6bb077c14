#include "nts/search/paths.h"
#include "array.h"

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

namespace nts::bindings
{
namespace
{
using Rows = In<std::int32_t>;

/// @brief Growing list of positions, each with a number.
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

/// @brief Points on paths, and the number of the path of each.
auto points_on_paths(const Doubles& paths, const Rows& number, const Rows& path,
                     const Doubles& s)
{
  check("paths", paths, {any, 6});
  check("number", number, {paths.shape(0)});
  check("path", path, {s.size(), 2});
  std::vector<PathCut> cuts(s.size());
  for (std::size_t i = 0; i < cuts.size(); ++i)
  {
    cuts[i] = {path.data()[2 * i], s.data()[i], path.data()[2 * i + 1]};
    if (cuts[i].path < 0
        || static_cast<std::size_t>(cuts[i].path) >= paths.shape(0))
      throw nb::value_error("path: expected row numbers of paths");
  }
  Found found;
  points_of_paths(view(paths), std::move(cuts),
                  [&](std::int32_t w, const Vec3& point)
                  { found.add(number.data()[w], {point}); });
  return found.arrays(3);
}

/// @brief Nodes and edges in regions, as paths, and the number of the region.
auto paths_in_regions(const Doubles& x, const std::vector<Rows>& nodes,
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
      check_rows("nodes, edges: expected row numbers of x", rows, x.shape(0));
    paths_in(view(x), view(some), view(others),
             {vector(view(regions), 2 * r), vector(view(regions), 2 * r + 1)},
             [&](const Vec3& begin, const Vec3& end)
             { found.add(static_cast<std::int32_t>(r), {begin, end}); });
  }
  return found.arrays(6);
}
} // namespace

void paths(nb::module_& m)
{
  m.def("points_on_paths", &points_on_paths, nb::arg("paths"),
        nb::arg("number"), nb::arg("path"), nb::arg("s"),
        "(w, 6), (w,), (c, 2), (c,) cuts as of Boundaries.cuts -> paths that "
        "are points, then middles of the parts of paths that are cut and not "
        "known to be outside (m, 3), and the number of the path of each (m,)");
  m.def("paths_in", &paths_in_regions, nb::arg("x"), nb::arg("nodes"),
        nb::arg("edges"), nb::arg("which"), nb::arg("regions"),
        "(l, 3), for each boundary rows of x (n,) and (e, 2), (r,) the "
        "boundary of each region, (r, 2, 3) -> begin and end of nodes, which "
        "are the same, and of edges whose box meets the region (w, 6), and "
        "number of the region (w,)");
}
} // namespace nts::bindings
