#include "nts/fem/volume_ratio.h"
#include "array.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
/// @brief Call a function with `CellVolumes` of these shape functions.
auto with_volumes(const Doubles& values, const Doubles& gradients,
                  bool makes_rings, const Doubles& x,
                  const In<std::int32_t>& cells, auto&& function)
{
  check("values", values, {any, any});
  const std::size_t points = values.shape(0), nodes = values.shape(1);
  check("gradients", gradients, {points, nodes, any});
  check("x", x, {any, 3});
  check("cells", cells, {any, nodes});
  check_rows("cells: expected row numbers of x", cells, x.shape(0));
  return dispatch_components(gradients.shape(2),
                             [&]<std::size_t D>()
                             {
                               return function(
                                   CellVolumes<D>(view(values), view(gradients),
                                                  points, nodes, makes_rings));
                             });
}

auto volumes(const Doubles& values, const Doubles& gradients, bool makes_rings,
             const Doubles& x, const In<std::int32_t>& cells)
{
  return with_volumes(
      values, gradients, makes_rings, x, cells,
      [&](const auto& of)
      {
        auto all = create<double>({cells.shape(0), of.points()});
        each_cell(of, view(x), view(cells),
                  [&](std::size_t c, std::span<const double> own)
                  {
                    std::ranges::copy(own, all.data() + of.points() * c);
                    return true;
                  });
        return all;
      });
}

auto least_ratio(const Doubles& values, const Doubles& gradients,
                 bool makes_rings, const Doubles& x, const Doubles& reference,
                 const In<std::int32_t>& cells)
{
  return with_volumes(
      values, gradients, makes_rings, x, cells,
      [&](const auto& of)
      {
        check("reference", reference, {cells.shape(0), of.points()});
        const VolumeRatio least
            = least_volume_ratio(of, view(x), view(reference), view(cells));
        return std::tuple(least.ratio, least.cell);
      });
}
} // namespace

void volume_ratio(nb::module_& m)
{
  m.def("cell_volumes", &volumes, nb::arg("values"), nb::arg("gradients"),
        nb::arg("makes_rings"), nb::arg("x"), nb::arg("cells"),
        "(q, k), (q, k, d), -, (n, 3), (c, k) -> volumes of the cells at the "
        "points (c, q)");
  m.def("least_volume_ratio", &least_ratio, nb::arg("values"),
        nb::arg("gradients"), nb::arg("makes_rings"), nb::arg("x"),
        nb::arg("reference"), nb::arg("cells"),
        "(q, k), (q, k, d), -, (n, 3), (c, q), (c, k) -> least det F of all "
        "points, or NaN, and its cell, or -1");
}
} // namespace nts::bindings
