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
                      Doubles value, In<std::int32_t> places)
      : _start(std::move(start)), _column(std::move(column)),
        _value(std::move(value)), _places(std::move(places)),
        _schwarz(made(_start, _column, _value))
  {
    _num_places = std::visit([](const auto& schwarz)
                             { return schwarz.num_columns(); }, _schwarz);
    if (_places.size() == 0)
      return;
    check("places", _places, {_num_places});
    _num_places = 0;
    for (const std::int32_t place : view(_places))
    {
      if (place < 0)
        throw nb::value_error("places: expected no negative entry");
      _num_places = std::max(_num_places, static_cast<std::size_t>(place) + 1);
    }
  }

  void add(const BoundElimination& contacts)
  {
    if (contacts.num_nodes() > num_rows())
      throw nb::value_error("contacts: expected node numbers below the number "
                            "of rows of the matrix");
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

  bool build(bool wide)
  {
    return std::visit([&](auto& schwarz) { return schwarz.build(wide); },
                      _schwarz);
  }

  /// @brief Correct values in rows of z, (n, B), and at ghosts, (g, 2 B), whose
  /// rows contain values of r and of z.
  void correct(const Doubles& r, Out<double> z, Out<double> ghosts)
  {
    std::visit(
        [&]<std::size_t B>(ContactSchwarz<B>& schwarz)
        {
          const std::size_t owned = z.shape(0), width = num_rows() ? B : any;
          check("z", z, {any, width});
          check("r", r, {owned, width});
          check("ghosts", ghosts, {any, num_rows() ? 2 * B : any});
          if (owned + ghosts.shape(0) < _num_places)
            throw nb::value_error("z and ghosts: expected together a row for "
                                  "each row and column of the matrix");
          if (!num_rows())
            return;
          const auto place = [&](std::size_t node)
          {
            return _places.size()
                       ? static_cast<std::size_t>(view(_places)[node])
                       : node;
          };
          const auto ghost = [&](std::size_t i)
          { return ghosts.data() + 2 * B * (i - owned); };
          schwarz.correct(
              [&](std::size_t node) -> const double*
              {
                const std::size_t i = place(node);
                return i < owned ? r.data() + B * i : ghost(i);
              },
              [&](std::size_t node)
              {
                const std::size_t i = place(node);
                return i < owned ? z.data() + B * i : ghost(i) + B;
              });
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
  In<std::int32_t> _places;
  Schwarz _schwarz;
  std::size_t _num_places
      = 0; // number of vector rows that have values of columns
};
} // namespace

void contact_schwarz(nb::module_& m)
{
  nb::class_<BoundContactSchwarz>(
      m, "ContactSchwarz",
      "Incomplete factors of the projected tangent around "
      "the contacts, see nts/solvers/contact_schwarz.h")
      .def(nb::init<In<std::int64_t>, In<std::int32_t>, Doubles,
                    In<std::int32_t>>(),
           nb::arg("start"), nb::arg("column"), nb::arg("value"),
           nb::arg("places"),
           "Matrix of B x B blocks, B = 2 or 3, whose rows are read when "
           "contacts first need them: (n + 1,), (b,), (B B b,); and rows of "
           "vectors that have the values of its columns (columns,), or (0,) "
           "where they have their numbers")
      .def("clear", &BoundContactSchwarz::clear, "Remove all contacts")
      .def("add", &BoundContactSchwarz::add, nb::arg("contacts"),
           "Add constraints and blocks of the tangent")
      .def("build", &BoundContactSchwarz::build, nb::kw_only(),
           nb::arg("wide") = false,
           "Factorise, a wide subdomain with fill; false if singular")
      .def("correct", &BoundContactSchwarz::correct, nb::arg("r"),
           nb::arg("z").noconvert(), nb::arg("ghosts").noconvert(),
           "Constrain z and correct it around the contacts: (n, B), (n, B), "
           "and rows of both after these, (g, 2 B)")
      .def_prop_ro("size", &BoundContactSchwarz::size,
                   "Nodes of the subdomain");
}
} // namespace nts::bindings
