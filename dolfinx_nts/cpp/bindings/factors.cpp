#include "block_matrix.h"
#include "nts/solvers/single_matrix.h"

namespace nts::bindings
{
namespace
{
using Factors = IncompleteFactors;

bool factorise(Factors& factors, const In<std::int64_t>& start,
               const In<std::int32_t>& column, const Doubles& value,
               const In<std::int32_t>& order, bool fill)
{
  const BlockMatrix A = block_matrix(start, column, value);
  const std::size_t n = start.size() - 1;
  check("order", order, {n});
  std::vector<bool> found(n, false);
  for (const std::int32_t row : view(order))
  {
    if (row < 0 || static_cast<std::size_t>(row) >= n || found[row])
      throw nb::value_error("order: expected each row once");
    found[row] = true;
  }
  return factors.factorise(A, view(order), fill);
}

void apply(Factors& factors, const Doubles& b, Out<double> x)
{
  check("b", b, {factors.size(), 3});
  check("x", x, {any, 3});
  if (x.shape(0) > factors.size())
    throw nb::value_error("x: expected no more rows than the matrix has");
  factors.apply(view(b), view(x));
}

void pack(SingleMatrix* self, const In<std::int64_t>& start,
          const In<std::int32_t>& column, const Doubles& value)
{
  new (self) SingleMatrix(block_matrix(start, column, value));
}

void multiply(SingleMatrix& A, const Doubles& x, Out<double> y)
{
  check("x", x, {any, 3});
  if (x.shape(0) < A.width())
    throw nb::value_error("x: expected a row for each column of the matrix");
  check("y", y, {A.size(), 3});
  A.multiply(view(x), view(y));
}
} // namespace

void factors(nb::module_& m)
{
  nb::class_<Factors>(m, "IncompleteFactors",
                      "Incomplete factors of a matrix of 3 x 3 blocks in "
                      "single precision, see nts/solvers/incomplete_factors.h")
      .def(nb::init<>())
      .def("factorise", &factorise, nb::arg("start"), nb::arg("column"),
           nb::arg("value"), nb::arg("order"), nb::arg("fill") = false,
           "Factorise rows, columns beyond them left out; false if singular: "
           "(n + 1,), (b,), (9 b,), (n,) rows in the order of elimination, "
           "whether to keep what the elimination of a neighbour fills")
      .def("apply", &apply, nb::arg("b"), nb::arg("x").noconvert(),
           "Solve for x at the first m rows: (n, 3), (m, 3)");
  nb::class_<SingleMatrix>(m, "SingleMatrix",
                           "Rows of 3 x 3 blocks in single precision, see "
                           "nts/solvers/single_matrix.h")
      .def("__init__", &pack, nb::arg("start"), nb::arg("column"),
           nb::arg("value"), "Copy: (n + 1,), (b,), (9 b,)")
      .def("multiply", &multiply, nb::arg("x"), nb::arg("y").noconvert(),
           "Set y to the product with x, columns in any number from those of "
           "the matrix on: (m, 3), (n, 3)");
}
} // namespace nts::bindings
