#include "nts/contact/leapfrog.h"
#include "array.h"
#include "nts/geometry/cell_length.h"

#include <nanobind/stl/pair.h>

namespace nts::bindings
{
namespace
{
auto drift_all(double dt, const Doubles& v, const Doubles& a, Out<double> rate,
               Out<double> u, Out<double> du, const Doubles& about)
{
  const std::size_t n = rate.shape(0);
  const std::size_t d = rate.shape(1);
  check("rate", rate, {n, d});
  check("v", v, {n, d});
  check("a", a, {n, d});
  check("u", u, {n, d});
  check("du", du, {n, d});
  check("about", about, {d});
  const Motion motion
      = dispatch_components(d,
                            [&]<std::size_t D>()
                            {
                              return drift<D>(dt, view(v), view(a), view(rate),
                                              view(u), view(du), view(about));
                            });
  return std::pair(motion.farthest, motion.relative);
}

double kick_all(double dt, const Doubles& mobility, const Doubles& force,
                Out<double> a, Out<double> rate)
{
  const std::size_t n = a.shape(0);
  const std::size_t d = a.shape(1);
  check("a", a, {n, d});
  check("mobility", mobility, {n, d});
  check("force", force, {n, d});
  check("rate", rate, {n, d});
  return kick(dt, view(mobility), view(force), view(a), view(rate));
}

auto cell_lengths_of(const Doubles& x, const In<std::int32_t>& cells)
{
  check("x", x, {any, any});
  if (x.shape(1) != 2 && x.shape(1) != 3)
    throw nb::value_error("x: expected 2 or 3 coordinates");
  check("cells", cells, {any, any});
  check_rows("cells: expected row numbers of x", cells, x.shape(0));
  auto length = create<double>({cells.shape(0)});
  cell_lengths(view(x), x.shape(1), view(cells), cells.shape(1), view(length));
  return length;
}
} // namespace

void leapfrog(nb::module_& m)
{
  m.def("drift", &drift_all, nb::arg("dt"), nb::arg("v"), nb::arg("a"),
        nb::arg("rate").noconvert(), nb::arg("u").noconvert(),
        nb::arg("du").noconvert(), nb::arg("about"),
        "-, (n, d), (n, d), -, -, -, (d,) a velocity -> longest row of du, and "
        "of du - dt about; sets rate (n, d), changes u (n, d) by du (n, d)");
  m.def("kick", &kick_all, nb::arg("dt"), nb::arg("mobility"), nb::arg("force"),
        nb::arg("a").noconvert(), nb::arg("rate").noconvert(),
        "-, (n, d), (n, d) -> force . a; sets a (n, d), changes rate (n, d)");
  m.def("cell_lengths", &cell_lengths_of, nb::arg("x"), nb::arg("cells"),
        "(n, 2 or 3), (c, k) -> twice the least radius of gyration of the "
        "nodes of "
        "each cell (c,)");
}
} // namespace nts::bindings
