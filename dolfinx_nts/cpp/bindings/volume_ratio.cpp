#include "nts/fem/volume_ratio.h"
#include "array.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
auto least_ratio(const Doubles& values, const Doubles& gradients,
                 bool makes_rings, const Doubles& x, const Doubles& X,
                 const In<std::int32_t>& cells)
{
  check("values", values, {any, any});
  const std::size_t points = values.shape(0), nodes = values.shape(1);
  check("gradients", gradients, {points, nodes, any});
  check("X", X, {any, 3});
  check("x", x, {X.shape(0), 3});
  check("cells", cells, {any, nodes});
  check_rows("cells: expected rows of X", cells, X.shape(0));
  const VolumeRatio least = dispatch_components(
      gradients.shape(2),
      [&]<std::size_t D>()
      {
        const ShapeFunctions<D> shapes{view(values), view(gradients), points,
                                       nodes, makes_rings};
        return least_volume_ratio(shapes, view(x), view(X), view(cells));
      });
  return std::tuple(least.ratio, least.cell);
}
} // namespace

void volume_ratio(nb::module_& m)
{
  m.def("least_volume_ratio", &least_ratio, nb::arg("values"),
        nb::arg("gradients"), nb::arg("makes_rings"), nb::arg("x"),
        nb::arg("X"), nb::arg("cells"),
        "(q, k), (q, k, d), -, (n, 3), (n, 3), (c, k) -> least det F of all "
        "points, or NaN, and its cell, or -1");
}
} // namespace nts::bindings
