#include "nts/contact/friction.h"
#include "array.h"
#include "nts/contact/batch.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
Vec2 pair(const Doubles& x, std::size_t i) noexcept
{
  return {x.data()[2 * i], x.data()[2 * i + 1]};
}

auto exact_batch(double mu, const Doubles& t, const Doubles& slip,
                 const Doubles& p, const Doubles& c, const Doubles& heading,
                 const In<bool>& sliding)
{
  const std::size_t m = p.size();
  check("p", p, {m});
  check("t", t, {m, 2});
  check("slip", slip, {m, 2});
  check("c", c, {m});
  check("heading", heading, {m, 2});
  check("sliding", sliding, {m});
  auto fixed = create<double>({m, 2});
  auto direction = create<double>({m, 2});
  auto stiffness = create<double>({m, 2, 2});
  for (std::size_t i = 0; i < m; ++i)
  {
    const TractionModel model
        = exact_friction(mu, pair(t, i), pair(slip, i), p.data()[i],
                         c.data()[i], pair(heading, i), sliding.data()[i]);
    store(model.fixed, view(fixed), i);
    store(model.direction, view(direction), i);
    store(model.stiffness, view(stiffness), i);
  }
  return std::tuple(fixed, direction, stiffness);
}

auto balance_batch(const Doubles& normal, const Doubles& force,
                   const Doubles& columns, const In<std::int32_t>& rank,
                   const Doubles& known, const Doubles& direction)
{
  const std::size_t m = rank.size();
  check("rank", rank, {m});
  check("normal", normal, {m, 3});
  check("force", force, {m, 3});
  check("columns", columns, {m, 3, any});
  check("known", known, {m, 2});
  check("direction", direction, {m, 2});
  const std::size_t d = columns.shape(2);
  if (d < 3)
    throw nb::value_error("columns: expected the node of each pair");
  auto multipliers = create<double>({m, 3});
  for (std::size_t i = 0; i < m; ++i)
  {
    Matrix<3, 3> own;
    for (std::size_t a = 0; a < 3; ++a)
      std::copy_n(columns.data() + (3 * i + a) * d, 3, own[a].begin());
    const Vec3 result = balance(vector(view(normal), i), vector(view(force), i),
                                own, static_cast<std::size_t>(rank.data()[i]),
                                pair(known, i), pair(direction, i));
    store(result, view(multipliers), i);
  }
  return multipliers;
}
} // namespace

void friction(nb::module_& m)
{
  m.def("exact_friction", &exact_batch, nb::arg("mu"), nb::arg("t"),
        nb::arg("slip"), nb::arg("p"), nb::arg("c"), nb::arg("heading"),
        nb::arg("sliding"),
        "-, (m, 2), (m, 2), (m,), (m,), (m, 2), (m,) -> what does not scale "
        "with p (m, 2), direction (m, 2), stiffness (m, 2, 2)");
  m.def("balance", &balance_batch, nb::arg("normal"), nb::arg("force"),
        nb::arg("columns"), nb::arg("rank"), nb::arg("known"),
        nb::arg("direction"),
        "(m, 3), (m, 3), (m, 3, d) of which [:, :, :3] count, (m,), (m, 2), "
        "(m, 2) -> multipliers (m, 3), of which rank count");
}
} // namespace nts::bindings
