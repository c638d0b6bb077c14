#include "nts/elimination.h"
#include "array.h"

namespace nts::bindings
{
namespace
{
using Dofs = In<std::int32_t>;

/// @brief Raise ValueError unless all are rows of x.
void check_rows(const char* name, const Dofs& nodes, const Out<double>& x)
{
  for (const std::int32_t node : view(nodes))
    if (node < 0 || static_cast<std::size_t>(node) >= x.shape(0))
      throw nb::value_error(
          (std::string(name) + ": expected rows of x").c_str());
}

/// @brief Check the shapes of x and dofs, and that every dof is a row of x.
std::size_t check_dofs(const Dofs& dofs, const Out<double>& x)
{
  check("dofs", dofs, {any, any});
  check("x", x, {any, 3});
  check_rows("dofs", dofs, x);
  return dofs.shape(1) - 1;
}

void constrain_batch(const Dofs& dofs, const Dofs& rank, const Doubles& normal,
                     const Doubles& gradients, const Doubles& values,
                     Out<double> x)
{
  const std::size_t k = check_dofs(dofs, x), m = dofs.shape(0);
  check("rank", rank, {m});
  check("normal", normal, {m, 3});
  check("gradients", gradients, {m, 3, 3 * (1 + k)});
  if (values.size())
    check("values", values, {m, 3});
  dispatch_pairs(k,
                 [&]<class S>()
                 {
                   constrain<S>({.dofs = view(dofs),
                                 .rank = view(rank),
                                 .normal = view(normal),
                                 .gradients = view(gradients),
                                 .columns = {},
                                 .tangent = {}},
                                view(values), view(x));
                 });
}

void act_batch(const Dofs& dofs, const Dofs& rank, const Doubles& normal,
               const Doubles& columns, const Doubles& tangent, const Doubles& x,
               Out<double> y)
{
  const std::size_t k = check_dofs(dofs, y), m = dofs.shape(0);
  const std::size_t n = 3 * (1 + k);
  check("rank", rank, {m});
  check("normal", normal, {m, 3});
  check("columns", columns, {m, 3, n});
  check("tangent", tangent, {m, n, n});
  check("x", x, {y.shape(0), 3});
  dispatch_pairs(k,
                 [&]<class S>()
                 {
                   act<S>({.dofs = view(dofs),
                           .rank = view(rank),
                           .normal = view(normal),
                           .gradients = {},
                           .columns = view(columns),
                           .tangent = view(tangent)},
                          view(x), view(y));
                 });
}

auto balance_batch(const Doubles& normal, const Doubles& rest,
                   const Doubles& columns)
{
  check("columns", columns, {any, any, any});
  const std::size_t m = columns.shape(0);
  check("normal", normal, {m, 3});
  check("rest", rest, {m, 3});
  if (columns.shape(1) == 0 || columns.shape(2) < 3)
    throw nb::value_error("columns: expected three numbers of each pair");
  auto lambda = create<double>({m});
  balance(view(normal), view(rest), view(columns),
          columns.shape(1) * columns.shape(2), view(lambda));
  return lambda;
}

void close_gaps_batch(const Dofs& nodes, const In<bool>& moves,
                      const Doubles& gap, const Doubles& normal,
                      const Doubles& gradients, double farthest, Out<double> x)
{
  const std::size_t m = nodes.size();
  check("nodes", nodes, {m});
  check("moves", moves, {m});
  check("gap", gap, {m});
  check("normal", normal, {m, 3});
  check("gradients", gradients, {m, any, any});
  check("x", x, {any, 3});
  check_rows("nodes", nodes, x);
  if (gradients.shape(1) == 0 || gradients.shape(2) < 3)
    throw nb::value_error("gradients: expected three numbers of each pair");
  close_gaps(view(nodes), view(moves), view(gap), view(normal), view(gradients),
             gradients.shape(1) * gradients.shape(2), farthest, view(x));
}
} // namespace

void elimination(nb::module_& m)
{
  m.def("constrain", &constrain_batch, nb::arg("dofs"), nb::arg("rank"),
        nb::arg("normal"), nb::arg("gradients"), nb::arg("values"),
        nb::arg("x").noconvert(),
        "x <- Z x + E (G^T E)^-1 values: (m, 1+k), (m,) of 0, 1, 3, (m, 3), "
        "(m, 3, 3(1+k)), (m, 3) or (0,), (n, 3)");
  m.def("act", &act_batch, nb::arg("dofs"), nb::arg("rank"), nb::arg("normal"),
        nb::arg("columns"), nb::arg("tangent"), nb::arg("x"),
        nb::arg("y").noconvert(),
        "y <- Z~^T (y + C x): (m, 1+k), (m,) of 0, 1, 3, (m, 3), "
        "(m, 3, 3(1+k)), (m, 3(1+k), 3(1+k)), (n, 3), (n, 3)");
  m.def("balance", &balance_batch, nb::arg("normal"), nb::arg("rest"),
        nb::arg("columns"),
        "lambda (m,) with n . (rest + lambda F) = 0, 0 where n . F is small: "
        "(m, 3), (m, 3), (m, c, d) of which F is [:, 0, :3]");
  m.def(
      "close_gaps", &close_gaps_batch, nb::arg("nodes"), nb::arg("moves"),
      nb::arg("gap"), nb::arg("normal"), nb::arg("gradients"),
      nb::arg("farthest"), nb::arg("x").noconvert(),
      "Move nodes along their normals to zero gap, unless that is farther: "
      "(m,), (m,), (m,), (m, 3), (m, c, d) of which [:, 0, :3] count, scalar, "
      "(n, 3)");
}
} // namespace nts::bindings
