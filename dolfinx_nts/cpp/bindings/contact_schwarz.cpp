#include "nts/solvers/contact_schwarz.h"
#include "block_matrix.h"
#include "elimination.h"

#include <optional>

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
        _value(std::move(value))
  {
    _schwarz.emplace(block_matrix(_start, _column, _value));
  }

  void add(const BoundElimination& contacts)
  {
    if (contacts.num_nodes() > num_rows())
      throw nb::value_error(
          "contacts: expected nodes that are rows of the matrix");
    _schwarz->add(contacts.get());
  }

  void clear() noexcept { _schwarz->clear(); }

  bool build() { return _schwarz->build(); }

  void correct(const Doubles& r, Out<double> z)
  {
    check("r", r, {num_rows(), 3});
    check("z", z, {any, 3});
    if (z.shape(0) < _schwarz->num_columns())
      throw nb::value_error("z: expected a row for each column of the matrix "
                            "and each row");
    _schwarz->correct(view(r), view(z));
  }

  std::size_t size() const { return _schwarz->size(); }

private:
  std::size_t num_rows() const { return _start.size() - 1; }

  In<std::int64_t> _start;
  In<std::int32_t> _column;
  Doubles _value;
  std::optional<ContactSchwarz> _schwarz;
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
           "Matrix of 3 x 3 blocks that is read, not copied: (n + 1,), (b,), "
           "(9 b,)")
      .def("clear", &BoundContactSchwarz::clear, "Remove all contacts")
      .def("add", &BoundContactSchwarz::add, nb::arg("contacts"),
           "Add constraints and blocks of the tangent")
      .def("build", &BoundContactSchwarz::build, "Factorise; false if singular")
      .def("correct", &BoundContactSchwarz::correct, nb::arg("r"),
           nb::arg("z").noconvert(),
           "Constrain z and correct it around the contacts: (n, 3), "
           "(columns, 3)")
      .def_prop_ro("size", &BoundContactSchwarz::size,
                   "Nodes of the subdomain");
}
} // namespace nts::bindings
