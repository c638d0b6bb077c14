#include "nts/patch.h"
#include "block_matrix.h"

#include <optional>

namespace nts::bindings
{
namespace
{
/// @brief `Patch` and the matrix whose rows it reads.
class KeptPatch
{
public:
  KeptPatch(In<std::int64_t> start, In<std::int32_t> column, Doubles value)
      : _start(std::move(start)), _column(std::move(column)),
        _value(std::move(value))
  {
    _patch.emplace(block_matrix(_start, _column, _value));
  }

  void add(const In<std::int32_t>& dofs, const In<std::int32_t>& rank,
           const Doubles& normal, const Doubles& gradients,
           const Doubles& columns, const Doubles& tangent)
  {
    check("dofs", dofs, {any, any});
    const std::size_t m = dofs.shape(0), n = 3 * dofs.shape(1);
    check("rank", rank, {m});
    check("normal", normal, {m, 3});
    check("gradients", gradients, {m, 3, n});
    check("columns", columns, {m, 3, n});
    check("tangent", tangent, {m, n, n});
    for (const std::int32_t dof : view(dofs))
      if (dof < 0 || static_cast<std::size_t>(dof) >= num_rows())
        throw nb::value_error("dofs: expected rows of the matrix");
    dispatch_pairs(dofs.shape(1) - 1,
                   [&]<class S>()
                   {
                     _patch->add<S>({.dofs = view(dofs),
                                     .rank = view(rank),
                                     .normal = view(normal),
                                     .gradients = view(gradients),
                                     .columns = view(columns),
                                     .tangent = view(tangent)});
                   });
  }

  void clear() noexcept { _patch->clear(); }

  bool build() { return _patch->build(); }

  void correct(const Doubles& r, Out<double> z)
  {
    check("r", r, {num_rows(), 3});
    check("z", z, {any, 3});
    if (z.shape(0) < _patch->num_columns())
      throw nb::value_error("z: expected a row for each column of the matrix "
                            "and each row");
    _patch->correct(view(r), view(z));
  }

  std::size_t size() const { return _patch->size(); }

private:
  std::size_t num_rows() const { return _start.size() - 1; }

  In<std::int64_t> _start;
  In<std::int32_t> _column;
  Doubles _value;
  std::optional<Patch> _patch;
};
} // namespace

void patch(nb::module_& m)
{
  nb::class_<KeptPatch>(m, "Patch",
                        "Incomplete factors of the projected tangent around "
                        "the contacts, see nts/patch.h")
      .def(nb::init<In<std::int64_t>, In<std::int32_t>, Doubles>(),
           nb::arg("start"), nb::arg("column"), nb::arg("value"),
           "Matrix of 3 x 3 blocks that is read, not copied: (n + 1,), (b,), "
           "(9 b,)")
      .def("clear", &KeptPatch::clear, "Be without pairs, as in the beginning")
      .def("add", &KeptPatch::add, nb::arg("dofs"), nb::arg("rank"),
           nb::arg("normal"), nb::arg("gradients"), nb::arg("columns"),
           nb::arg("tangent"),
           "Active pairs: (m, 1+k), (m,) of 0, 1, 3, (m, 3), (m, 3, 3(1+k)), "
           "(m, 3, 3(1+k)), (m, 3(1+k), 3(1+k))")
      .def("build", &KeptPatch::build, "Factorise; false if singular")
      .def("correct", &KeptPatch::correct, nb::arg("r"),
           nb::arg("z").noconvert(),
           "Constrain z and add what the patch solves for: (n, 3), "
           "(columns, 3)")
      .def_prop_ro("size", &KeptPatch::size, "Nodes in the patch");
}
} // namespace nts::bindings
