#include "nts/contact/leapfrog.h"
#include "array.h"
#include "nts/geometry/cell_length.h"

namespace nts::bindings
{
namespace
{
double drift_all(double dt, const Doubles& v, const Doubles& a,
                 Out<double> rate, Out<double> u, Out<double> du)
{
  const std::size_t n = rate.shape(0);
  check("rate", rate, {n, 3});
  check("v", v, {n, 3});
  check("a", a, {n, 3});
  check("u", u, {n, 3});
  check("du", du, {n, 3});
  return drift(dt, view(v), view(a), view(rate), view(u), view(du));
}

double kick_all(double dt, const Doubles& mobility, const Doubles& force,
                Out<double> a, Out<double> rate)
{
  const std::size_t n = a.shape(0);
  check("a", a, {n, 3});
  check("mobility", mobility, {n, 3});
  check("force", force, {n, 3});
  check("rate", rate, {n, 3});
  return kick(dt, view(mobility), view(force), view(a), view(rate));
}

auto cell_lengths_of(const Doubles& x, const In<std::int32_t>& cells)
{
  check("x", x, {any, 3});
  check("cells", cells, {any, any});
  check_rows("cells: expected rows of x", cells, x.shape(0));
  auto length = create<double>({cells.shape(0)});
  cell_lengths(view(x), view(cells), cells.shape(1), view(length));
  return length;
}
} // namespace

void leapfrog(nb::module_& m)
{
  m.def("drift", &drift_all, nb::arg("dt"), nb::arg("v"), nb::arg("a"),
        nb::arg("rate").noconvert(), nb::arg("u").noconvert(),
        nb::arg("du").noconvert(),
        "-, (n, 3), (n, 3) -> longest row of du; sets rate (n, 3), changes u "
        "(n, 3) "
        "by du (n, 3)");
  m.def("kick", &kick_all, nb::arg("dt"), nb::arg("mobility"), nb::arg("force"),
        nb::arg("a").noconvert(), nb::arg("rate").noconvert(),
        "-, (n, 3), (n, 3) -> force . a; sets a (n, 3), changes rate (n, 3)");
  m.def("cell_lengths", &cell_lengths_of, nb::arg("x"), nb::arg("cells"),
        "(n, 3), (c, k) -> twice the least radius of gyration of the nodes of "
        "each cell (c,)");
}
} // namespace nts::bindings
