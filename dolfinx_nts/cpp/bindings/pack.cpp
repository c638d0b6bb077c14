#include "nts/pack.h"
#include "array.h"

namespace nts::bindings
{
namespace
{
void pack_cells(const Doubles& x, const In<std::int32_t>& nodes,
                std::size_t first, Out<double> rows)
{
  check("x", x, {any, 3});
  check("nodes", nodes, {any, any});
  check("rows", rows, {nodes.shape(0), any});
  check_rows("nodes: expected rows of x", nodes, x.shape(0));
  const std::size_t k = nodes.shape(1), width = rows.shape(1);
  if (k == 0 || first > width || 3 * k > width - first)
    throw nb::value_error("rows: expected three columns for each node");
  pack(view(x), view(nodes), k, first, view(rows), width);
}

bool follow_values(const Doubles& values, Out<double> kept)
{
  check("values", values, {any});
  check("kept", kept, {values.size()});
  return follow(view(values), view(kept));
}
} // namespace

void pack(nb::module_& m)
{
  m.def("pack", &pack_cells, nb::arg("x"), nb::arg("nodes"), nb::arg("first"),
        nb::arg("rows").noconvert(),
        "(l, 3), (c, k), -; sets 3 k columns of rows (c, width) from the first "
        "on");
  m.def("follow", &follow_values, nb::arg("values"),
        nb::arg("kept").noconvert(),
        "(n,) -> whether a bit of them was not in kept (n,), where it is then");
}
} // namespace nts::bindings
