#include "nts/geometry/rows.h"
#include "array.h"
#include "nts/geometry/box.h"

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;

/// @brief Raise ValueError unless row numbers (r,) are valid for x, (n, 3).
void check_points(const Doubles& x, const Ints& rows)
{
  check("x", x, {any, 3});
  check("rows", rows, {any});
  check_rows("rows: expected row numbers of x", rows, x.shape(0));
}

auto bounds_of(const Doubles& x, const Ints& rows)
{
  check_points(x, rows);
  const Box box = bounds(view(x), view(rows));
  auto both = create<double>({2, 3});
  std::ranges::copy(box.lower, both.data());
  std::ranges::copy(box.upper, both.data() + 3);
  return both;
}

auto change_components_of(const Doubles& x)
{
  check("x", x, {any, any});
  const std::size_t n = x.shape(0);
  return dispatch_components(x.shape(1),
                             [&]<std::size_t B>()
                             {
                               auto out = create<double>({n, 5 - B});
                               change_components<5 - B>(view(x), view(out));
                               return out;
                             });
}

void take_rows_of(const Doubles& x, const In<std::int64_t>& rows,
                  const Out<double>& out)
{
  check("x", x, {any, any});
  check("rows", rows, {any});
  check("out", out, {rows.size(), x.shape(1)});
  for (const std::int64_t row : view(rows))
    if (row < 0 || static_cast<std::size_t>(row) >= x.shape(0))
      throw nb::value_error("rows: expected row numbers of x");
  take_rows(view(x), view(rows), view(out));
}

auto motion_sums_of(const Doubles& x, const Doubles& p, const Doubles& v)
{
  check("p", p, {any, any});
  const std::size_t n = p.shape(0), d = p.shape(1);
  check("v", v, {n, d});
  check("x", x, {any, 3});
  if (x.shape(0) < n)
    throw nb::value_error("x: expected a row for each row of p");
  const MotionSums sums = dispatch_components(
      d, [&]<std::size_t D>()
      { return motion_sums<D>(view(x), view(p), view(v)); });
  auto all = create<double>({7});
  all.data()[0] = sums.energy;
  std::ranges::copy(sums.momentum.sum, all.data() + 1);
  std::ranges::copy(sums.momentum.moment, all.data() + 4);
  return all;
}
auto counts_of_parts(const In<bool>& flags, const Ints& number,
                     const In<std::int64_t>& ends)
{
  check("number", number, {any});
  check("flags", flags, {number.size()});
  check("ends", ends, {any});
  if (ends.size() == 0)
    throw nb::value_error("ends: expected at least one offset");
  auto counts = create<std::int64_t>({ends.size() - 1});
  std::ranges::fill(view(counts), 0);
  for (std::size_t i = 0, part = 0; i < number.size(); ++i)
  {
    while (part < counts.size() && number.data()[i] >= ends.data()[part + 1])
      ++part;
    if (part == counts.size() || number.data()[i] < ends.data()[part])
      throw nb::value_error(
          "number: expected ascending numbers within the ranges of ends");
    counts.data()[part] += flags.data()[i];
  }
  return counts;
}
} // namespace

void rows(nb::module_& m)
{
  m.def("bounds", &bounds_of, nb::arg("x"), nb::arg("rows"),
        "(n, 3), (r,) -> least and greatest coordinates of these rows (2, 3), "
        "inf and -inf of none");
  m.def("change_components", &change_components_of, nb::arg("x"),
        "(n, 2) -> (n, 3) with zeros; (n, 3) -> (n, 2)");
  m.def("counts_of_parts", &counts_of_parts, nb::arg("flags"),
        nb::arg("number"), nb::arg("ends"),
        "(m,), (m,) ascending, (c + 1,) where parts of the numbers begin, and "
        "the end -> how many flags of each part are set (c,)");
  m.def("take_rows", &take_rows_of, nb::arg("x"), nb::arg("rows"),
        nb::arg("out").noconvert(), "(n, w), (r,), set to these rows (r, w)");
  m.def("motion_sums", &motion_sums_of, nb::arg("x"), nb::arg("p"),
        nb::arg("v"),
        "(l, 3), (n, d) momenta at the first rows of x, (n, d) -> kinetic "
        "energy, linear and angular momentum (7,)");
}
} // namespace nts::bindings
