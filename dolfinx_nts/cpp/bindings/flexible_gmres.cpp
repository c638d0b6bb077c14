#include "nts/solvers/flexible_gmres.h"
#include "array.h"

namespace nts::bindings
{
namespace
{
/// @brief Solution of one system, see `HessenbergSystem`. Vectors are
/// distributed.
class FlexibleGmres
{
public:
  FlexibleGmres(const Doubles& b, nb::object sums)
      : _sums(std::move(sums)), _system(norm(gmres::inner(view(b), b.data())))
  {
    check("b", b, {any, any});
    _shape = {b.shape(0), b.shape(1)};
    const Out<double> first = create<double>({_shape[0], _shape[1]});
    std::ranges::copy(view(b), first.data());
    scale(first, residual());
    _basis.push_back(first);
  }

  double residual() const noexcept { return _system.residual(); }

  Doubles vector() const { return _basis.back(); }

  double add(const Doubles& z, Out<double> w)
  {
    check("z", z, {_shape[0], _shape[1]});
    check("w", w, {_shape[0], _shape[1]});
    const std::size_t k = _basis.size();
    const Out<double> column = create<double>({k});
    products(pointers(_basis), view(w), view(column));
    const Doubles sums = summed(column);
    std::vector<double> factors(k);
    std::ranges::transform(view(sums), factors.begin(), std::negate<>());
    const double length = norm(nts::add(pointers(_basis), factors, view(w)));
    std::vector<double> entries(view(sums).begin(), view(sums).end());
    entries.push_back(length);
    _system.append(std::move(entries));
    scale(w, length);
    _basis.push_back(w);
    _given.push_back(z);
    return residual();
  }

  auto solution() const
  {
    const Out<double> x = create<double>({_shape[0], _shape[1]});
    std::ranges::fill(view(x), 0.0);
    nts::add(pointers(_given), _system.solution(), view(x));
    return x;
  }

private:
  static std::vector<const double*> pointers(const std::vector<Doubles>& arrays)
  {
    std::vector<const double*> result;
    for (const Doubles& array : arrays)
      result.push_back(array.data());
    return result;
  }

  static void scale(const Out<double>& vector, double length) noexcept
  {
    for (double& value : view(vector))
      value /= length;
  }

  /// @brief Sums over all ranks.
  Doubles summed(const Out<double>& values) const
  {
    return _sums.is_none() ? Doubles(values) : nb::cast<Doubles>(_sums(values));
  }

  double norm(double square) const
  {
    const Out<double> values = create<double>({1});
    values.data()[0] = square;
    return std::sqrt(summed(values).data()[0]);
  }

  nb::object _sums;
  HessenbergSystem _system;
  std::array<std::size_t, 2> _shape = {};
  std::vector<Doubles> _basis, _given;
};
} // namespace

void flexible_gmres(nb::module_& m)
{
  nb::class_<FlexibleGmres>(
      m, "FlexibleGmres",
      "Iterations of one linear system, see nts/solvers/flexible_gmres.h")
      .def(nb::init<const Doubles&, nb::object>(), nb::arg("b"),
           nb::arg("sums").none(),
           "(n, d) rows of this rank; function that returns sums of an array "
           "over all ranks, None on one")
      .def_prop_ro("residual", &FlexibleGmres::residual, "Norm of the residual")
      .def_prop_ro("vector", &FlexibleGmres::vector,
                   "Unit vector that is to be preconditioned, (n, d)")
      .def("add", &FlexibleGmres::add, nb::arg("z"), nb::arg("w").noconvert(),
           "What the preconditioner gave for the vector, (n, d), and its "
           "product, (n, d), both kept, the latter changed -> the residual")
      .def("solution", &FlexibleGmres::solution,
           "Of the least residual, (n, d)");
}
} // namespace nts::bindings
