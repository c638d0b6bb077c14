#include "nts/leapfrog.h"
#include "array.h"

namespace nts::bindings
{
namespace
{
double drift_all(double dt, const Doubles& v, const Doubles& a,
                 Out<double> rate, Out<double> u)
{
  const std::size_t n = rate.shape(0);
  check("rate", rate, {n, 3});
  check("v", v, {n, 3});
  check("a", a, {n, 3});
  check("u", u, {n, 3});
  return drift(dt, view(v), view(a), view(rate), view(u));
}

void kick_all(double dt, const Doubles& mobility, const Doubles& force,
              Out<double> a, Out<double> rate)
{
  const std::size_t n = a.shape(0);
  check("a", a, {n, 3});
  check("mobility", mobility, {n, 3});
  check("force", force, {n, 3});
  check("rate", rate, {n, 3});
  kick(dt, view(mobility), view(force), view(a), view(rate));
}
} // namespace

void leapfrog(nb::module_& m)
{
  m.def("drift", &drift_all, nb::arg("dt"), nb::arg("v"), nb::arg("a"),
        nb::arg("rate").noconvert(), nb::arg("u").noconvert(),
        "-, (n, 3), (n, 3) -> largest change of u; sets rate (n, 3), moves u "
        "(n, 3)");
  m.def("kick", &kick_all, nb::arg("dt"), nb::arg("mobility"), nb::arg("force"),
        nb::arg("a").noconvert(), nb::arg("rate").noconvert(),
        "-, (n, 3), (n, 3); sets a (n, 3), changes rate (n, 3)");
}
} // namespace nts::bindings
