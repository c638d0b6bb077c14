#include "block_matrix.h"
#include "nts/solvers/complete_factors.h"
#include "nts/solvers/single_matrix.h"

#include <nanobind/stl/optional.h>

#include <variant>

namespace nts::bindings
{
namespace
{
/// @brief Factors of a matrix whose block size is known at run time.
struct Factors
{
  std::variant<IncompleteFactors<3>, IncompleteFactors<2>> factors;

  std::size_t size() const noexcept
  {
    return std::visit([](const auto& f) { return f.size(); }, factors);
  }
};

/// @brief A matrix with 2 x 2 or 3 x 3 blocks.
struct Product
{
  std::variant<SingleMatrix<3>, SingleMatrix<2>> matrix;
};

/// @brief Components of a node in the blocks of factors or of a matrix.
template <template <std::size_t> class T, std::size_t B>
constexpr std::size_t components(const T<B>&) noexcept
{
  return B;
}

/// @brief Raise ValueError unless columns ascend in each row and the pattern is
/// symmetric.
void check_pattern(std::span<const std::int64_t> start,
                   std::span<const std::int32_t> column)
{
  if (start.front() != 0
      || static_cast<std::size_t>(start.back()) != column.size()
      || !std::ranges::is_sorted(start))
    throw nb::value_error(
        "start: expected ascending offsets, from 0 to the length of column");
  const auto n = static_cast<std::int32_t>(start.size() - 1);
  if (std::ranges::any_of(column, [n](auto j) { return j < 0 || j >= n; }))
    throw nb::value_error("column: expected row numbers");
  const auto row = [&](std::int32_t i)
  {
    return column.subspan(static_cast<std::size_t>(start[i]),
                          static_cast<std::size_t>(start[i + 1] - start[i]));
  };
  for (std::int32_t i = 0; i < n; ++i)
  {
    bool holds = std::ranges::is_sorted(row(i), std::ranges::less_equal{});
    for (const std::int32_t j : row(i))
      holds = holds && std::ranges::binary_search(row(j), i);
    if (!holds)
      throw nb::value_error(
          "column: expected a symmetric pattern, ascending in each row");
  }
}

/// @brief Right-hand side of the rows after the first ones, if it is in another
/// array.
std::span<const double> rest(const std::optional<Doubles>& behind)
{
  return behind ? view(*behind) : std::span<const double>{};
}

bool factorise(Factors& factors, const In<std::int64_t>& start,
               const In<std::int32_t>& column, const Doubles& value,
               const In<std::int32_t>& order, bool fill,
               const std::optional<Doubles>& behind)
{
  check("start", start, {any});
  if (!start.size())
    throw nb::value_error("start: expected at least one entry");
  const std::size_t n = start.size() - 1;
  check("order", order, {n});
  std::vector<bool> found(n, false);
  for (const std::int32_t row : view(order))
  {
    if (row < 0 || static_cast<std::size_t>(row) >= n || found[row])
      throw nb::value_error("order: expected each row once");
    found[row] = true;
  }
  return dispatch_components(
      components_of(column, value, rest(behind)),
      [&]<std::size_t B>()
      {
        const auto A = block_matrix<B>(start, column, value, rest(behind));
        if (!std::holds_alternative<IncompleteFactors<B>>(factors.factors))
          factors.factors.emplace<IncompleteFactors<B>>();
        return std::get<IncompleteFactors<B>>(factors.factors)
            .factorise(A, view(order), fill);
      });
}

/// @brief Call a function with the factors, after a check of right-hand side
/// and result.
template <class Function>
void with_factors(Factors& factors, const Doubles& b, const Out<double>& x,
                  const std::optional<Doubles>& behind,
                  const Function& function)
{
  const std::size_t n = factors.size(), m = behind ? behind->shape(0) : 0;
  if (n == 0 && b.size() == 0 && x.size() == 0 && m == 0)
    return; // a rank without nodes
  std::visit(
      [&](auto& some)
      {
        const std::size_t width = components(some);
        if (behind)
          check("behind", *behind, {any, width});
        if (m > n)
          throw nb::value_error(
              "behind: expected no more rows than the matrix has");
        check("b", b, {n - m, width});
        check("x", x, {any, width});
        if (x.shape(0) > n)
          throw nb::value_error("x: expected no more rows than the matrix has");
        function(some);
      },
      factors.factors);
}

void apply(Factors& factors, const Doubles& b, Out<double> x,
           const std::optional<Doubles>& behind)
{
  with_factors(factors, b, x, behind,
               [&](auto& some) { some.apply(view(b), view(x), rest(behind)); });
}

void apply_at(Factors& factors, const In<std::int32_t>& places,
              const Doubles& b, Out<double> x,
              const std::optional<Doubles>& behind)
{
  check("places", places, {any});
  std::int64_t last = -1;
  for (const std::int32_t place : view(places))
  {
    if (place <= last || static_cast<std::size_t>(place) >= factors.size())
      throw nb::value_error("places: expected ascending indices of rows");
    last = place;
  }
  with_factors(
      factors, b, x, behind, [&](auto& some)
      { some.apply_at(view(places), view(b), view(x), rest(behind)); });
}

void dissect(CompleteFactors* self, const In<std::int64_t>& start,
             const In<std::int32_t>& column, const Doubles& X)
{
  check("start", start, {any});
  if (!start.size())
    throw nb::value_error("start: expected at least one entry");
  const std::size_t n = start.size() - 1;
  check("X", X, {n, 3});
  check_pattern(view(start), view(column));
  new (self) CompleteFactors(view(start), view(column), view(X));
}

bool factorise_whole(CompleteFactors& factors, const In<std::int64_t>& start,
                     const In<std::int32_t>& column, const Doubles& value)
{
  return dispatch_components(
      components_of(column, value),
      [&]<std::size_t B>()
      {
        const auto A = block_matrix<B>(start, column, value);
        if (!factors.fits(A.start, A.column))
          throw nb::value_error("column: expected the sparsity pattern with "
                                "which the factors were made");
        return factors.factorise(A);
      });
}

void apply_whole(CompleteFactors& factors, const Doubles& b, Out<double> x)
{
  const std::size_t n = factors.size(), width = factors.dim();
  if (b.ndim() == 3)
  {
    check("b", b, {any, n, width});
    check("x", x, {b.shape(0), n, width});
  }
  else
  {
    check("b", b, {n, width});
    check("x", x, {n, width});
  }
  if (b.size() == 0)
    return;
  factors.apply(view(b), view(x));
}

void pack(Product* self, const In<std::int64_t>& start,
          const In<std::int32_t>& column, const Doubles& value)
{
  dispatch_components(components_of(column, value),
                      [&]<std::size_t B>()
                      {
                        new (self) Product{SingleMatrix<B>(
                            block_matrix<B>(start, column, value))};
                      });
}

void multiply(Product& product, const Doubles& x, Out<double> y)
{
  std::visit(
      [&](auto& A)
      {
        // Without blocks their size is unknown.
        const std::size_t width = A.width() ? components(A) : any;
        check("x", x, {any, width});
        if (x.shape(0) < A.width())
          throw nb::value_error(
              "x: expected a row for each column of the matrix");
        check("y", y, {A.size(), width});
        if (A.width())
          A.multiply(view(x), view(y));
        else
          std::fill_n(y.data(), y.size(), 0.);
      },
      product.matrix);
}
} // namespace

void factors(nb::module_& m)
{
  nb::class_<Factors>(
      m, "IncompleteFactors",
      "Incomplete factors of a matrix of 2 x 2 or 3 x 3 blocks "
      "in single precision, see nts/solvers/incomplete_factors.h")
      .def(nb::init<>())
      .def("factorise", &factorise, nb::arg("start"), nb::arg("column"),
           nb::arg("value"), nb::arg("order"), nb::arg("fill") = false,
           nb::arg("behind") = nb::none(),
           "Factorise rows, columns beyond them left out; false if singular: "
           "(n + 1,), (b,), (B B b,), (n,) rows in the order of elimination, "
           "whether to keep what the elimination of a neighbour fills, blocks "
           "of the last rows if value lacks them")
      .def("apply", &apply, nb::arg("b"), nb::arg("x").noconvert(),
           nb::arg("behind") = nb::none(),
           "Solve for x at the first m rows: (n, B), (m, B), last rows of the "
           "right-hand side if b lacks them")
      .def("apply_at", &apply_at, nb::arg("places"), nb::arg("b"),
           nb::arg("x").noconvert(), nb::arg("behind") = nb::none(),
           "The same at rows with some places in the order of elimination, "
           "others zero: (k,) ascending, (n, B), (m, B), last rows as above");
  nb::class_<CompleteFactors>(
      m, "CompleteFactors",
      "Complete factors of a matrix of 2 x 2 or 3 x 3 blocks with a symmetric "
      "pattern, in single precision, see nts/solvers/complete_factors.h")
      .def("__init__", &dissect, nb::arg("start"), nb::arg("column"),
           nb::arg("X"), "Order of elimination: (n + 1,), (b,), (n, 3)")
      .def("factorise", &factorise_whole, nb::arg("start"), nb::arg("column"),
           nb::arg("value"),
           "Factorise a matrix of this pattern; false if singular: (n + 1,), "
           "(b,), (B B b,)")
      .def("apply", &apply_whole, nb::arg("b"), nb::arg("x").noconvert(),
           "Solve for x, of one or many: both (n, B) or (k, n, B)")
      .def_prop_ro("entries", &CompleteFactors::entries,
                   "Numbers that the factors consist of");
  nb::class_<Product>(m, "SingleMatrix",
                      "Rows of 2 x 2 or 3 x 3 blocks in single precision, see "
                      "nts/solvers/single_matrix.h")
      .def("__init__", &pack, nb::arg("start"), nb::arg("column"),
           nb::arg("value"), "Copy: (n + 1,), (b,), (B B b,)")
      .def("multiply", &multiply, nb::arg("x"), nb::arg("y").noconvert(),
           "Set y to the product with x, columns in any number from those of "
           "the matrix on: (m, B), (n, B)");
}
} // namespace nts::bindings
