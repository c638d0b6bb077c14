#include "nts/solvers/contact_schwarz.h"
#include "block_matrix.h"
#include "elimination.h"

#include <variant>

namespace nts::bindings
{
namespace
{
/// @brief `ContactSchwarz` and the matrix whose rows it reads.
class BoundContactSchwarz
{
public:
  BoundContactSchwarz(In<std::int64_t> start, In<std::int32_t> column,
                      Doubles value)
      : _start(std::move(start)), _column(std::move(column)),
        _value(std::move(value)), _schwarz(made(_start, _column, _value))
  {
  }

  void add(const BoundElimination& contacts)
  {
    if (contacts.num_nodes() > num_rows())
      throw nb::value_error(
          "contacts: expected nodes that are rows of the matrix");
    std::visit(
        [&]<std::size_t B>(ContactSchwarz<B>& schwarz)
        {
          if (contacts.components() == B)
            schwarz.add(contacts.get<B>());
          else if (num_rows())
            throw nb::value_error(
                "contacts: expected blocks as large as those of the matrix");
        },
        _schwarz);
  }

  void clear()
  {
    std::visit([](auto& schwarz) { schwarz.clear(); }, _schwarz);
  }

  bool build()
  {
    return std::visit([](auto& schwarz) { return schwarz.build(); }, _schwarz);
  }

  void correct(const Doubles& r, Out<double> z)
  {
    std::visit(
        [&]<std::size_t B>(ContactSchwarz<B>& schwarz)
        {
          const std::size_t width = num_rows() ? B : any;
          check("r", r, {num_rows(), width});
          check("z", z, {any, width});
          if (z.shape(0) < schwarz.num_columns())
            throw nb::value_error("z: expected a row for each column of the "
                                  "matrix and each row");
          if (num_rows())
            schwarz.correct(view(r), view(z));
        },
        _schwarz);
  }

  std::size_t size() const
  {
    return std::visit([](const auto& schwarz) { return schwarz.size(); },
                      _schwarz);
  }

private:
  using Schwarz = std::variant<ContactSchwarz<3>, ContactSchwarz<2>>;

  static Schwarz made(const In<std::int64_t>& start,
                      const In<std::int32_t>& column, const Doubles& value)
  {
    return dispatch_components(
        components_of(column, value), [&]<std::size_t B>() -> Schwarz
        { return ContactSchwarz<B>(block_matrix<B>(start, column, value)); });
  }

  std::size_t num_rows() const { return _start.size() - 1; }

  In<std::int64_t> _start;
  In<std::int32_t> _column;
  Doubles _value;
  Schwarz _schwarz;
};
} // namespace

void contact_schwarz(nb::module_& m)
{
  nb::class_<BoundContactSchwarz>(
      m, "ContactSchwarz",
      "Incomplete factors of the projected tangent around "
      "the contacts, see nts/solvers/contact_schwarz.h")
      .def(nb::init<In<std::int64_t>, In<std::int32_t>, Doubles>(),
           nb::arg("start"), nb::arg("column"), nb::arg("value"),
           "Matrix of B x B blocks, B = 2 or 3, whose rows are read when "
           "contacts first need them: (n + 1,), (b,), (B B b,)")
      .def("clear", &BoundContactSchwarz::clear, "Remove all contacts")
      .def("add", &BoundContactSchwarz::add, nb::arg("contacts"),
           "Add constraints and blocks of the tangent")
      .def("build", &BoundContactSchwarz::build, "Factorise; false if singular")
      .def("correct", &BoundContactSchwarz::correct, nb::arg("r"),
           nb::arg("z").noconvert(),
           "Constrain z and correct it around the contacts: (n, B), "
           "(columns, B)")
      .def_prop_ro("size", &BoundContactSchwarz::size,
                   "Nodes of the subdomain");
}
} // namespace nts::bindings
