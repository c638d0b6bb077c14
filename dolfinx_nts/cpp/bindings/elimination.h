#pragma once

#include "array.h"
#include "nts/solvers/elimination.h"

namespace nts::bindings
{
/// @brief Active pairs of one contact pair and the arrays that hold them.
class KeptElimination
{
public:
  KeptElimination(In<std::int32_t> dofs, In<std::int32_t> rank, Doubles normal,
                  Doubles gradients, Doubles columns, Doubles tangent)
      : _dofs(std::move(dofs)), _rank(std::move(rank)),
        _normal(std::move(normal)), _gradients(std::move(gradients)),
        _columns(std::move(columns)), _tangent(std::move(tangent))
  {
    check("dofs", _dofs, {any, any});
    const std::size_t m = _dofs.shape(0), n = 3 * _dofs.shape(1);
    check("rank", _rank, {m});
    check("normal", _normal, {m, 3});
    check("gradients", _gradients, {m, 3, n});
    check("columns", _columns, {m, 3, n});
    check("tangent", _tangent, {m, n, n});
    for (const std::int32_t dof : view(_dofs))
    {
      if (dof < 0)
        throw nb::value_error("dofs: expected no negative entry");
      _num_nodes = std::max(_num_nodes, static_cast<std::size_t>(dof) + 1);
    }
  }

  /// @brief Call function with the pairs as `nts::Elimination`.
  template <class Function>
  void visit(Function&& function) const
  {
    dispatch_pairs(_dofs.shape(1) - 1,
                   [&]<class S>()
                   {
                     function(Elimination<S>{.dofs = view(_dofs),
                                             .rank = view(_rank),
                                             .normal = view(_normal),
                                             .gradients = view(_gradients),
                                             .columns = view(_columns),
                                             .tangent = view(_tangent)});
                   });
  }

  void constrain(const Doubles& values, Out<double> x) const
  {
    if (values.size())
      check("values", values, {_dofs.shape(0), 3});
    check_rows("x", x);
    visit([&](const auto& e) { nts::constrain(e, view(values), view(x)); });
  }

  void act(const Doubles& x, Out<double> y) const
  {
    check_rows("y", y);
    check("x", x, {y.shape(0), 3});
    visit([&](const auto& e) { nts::act(e, view(x), view(y)); });
  }

  /// @brief One more than the greatest dof.
  std::size_t num_nodes() const noexcept { return _num_nodes; }

private:
  void check_rows(const char* name, const Out<double>& x) const
  {
    check(name, x, {any, 3});
    if (x.shape(0) < _num_nodes)
      throw nb::value_error(
          (std::string(name) + ": expected a row for each of the dofs")
              .c_str());
  }

  In<std::int32_t> _dofs, _rank;
  Doubles _normal, _gradients, _columns, _tangent;
  std::size_t _num_nodes = 0;
};
} // namespace nts::bindings
