#include "array.h"
#include "nts/contact/nodal_friction.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
auto exact_batch(const Doubles& limit, const Doubles& by_p,
                 const Doubles& by_slip, const Doubles& t, const Doubles& slip,
                 const Doubles& p, const Doubles& c, const Doubles& heading,
                 const In<bool>& sliding)
{
  const std::size_t m = p.size();
  check("limit", limit, {m});
  check("by_p", by_p, {m});
  check("by_slip", by_slip, {m});
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
    const TractionModel model = exact_friction(
        {limit.data()[i], by_p.data()[i], by_slip.data()[i]},
        vector2(view(t), i), vector2(view(slip), i), p.data()[i], c.data()[i],
        vector2(view(heading), i), sliding.data()[i]);
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
    throw nb::value_error(
        "columns: expected at least 3 entries, for the node of each pair");
  auto multipliers = create<double>({m, 3});
  for (std::size_t i = 0; i < m; ++i)
  {
    Matrix<3, 3> own;
    for (std::size_t a = 0; a < 3; ++a)
      std::copy_n(columns.data() + (3 * i + a) * d, 3, own[a].begin());
    const Vec3 result
        = balance(vector(view(normal), i), vector(view(force), i), own,
                  static_cast<std::size_t>(rank.data()[i]),
                  vector2(view(known), i), vector2(view(direction), i));
    store(result, view(multipliers), i);
  }
  return multipliers;
}

auto slides_batch(const Doubles& limit, const Doubles& trial,
                  const Doubles& motion, const Doubles& heading,
                  const In<bool>& sliding)
{
  const std::size_t m = limit.size();
  check("limit", limit, {m});
  check("trial", trial, {m, 2});
  check("motion", motion, {m, 2});
  check("heading", heading, {m, 2});
  check("sliding", sliding, {m});
  auto flags = create<bool>({m});
  for (std::size_t i = 0; i < m; ++i)
    flags.data()[i] = slides(limit.data()[i], vector2(view(trial), i),
                             vector2(view(motion), i),
                             vector2(view(heading), i), sliding.data()[i]);
  return flags;
}

auto with_friction_batch(const Doubles& columns, const Doubles& direction)
{
  const std::size_t m = direction.shape(0);
  check("direction", direction, {m, 2});
  check("columns", columns, {m, 3, any});
  const std::size_t d = columns.shape(2);
  auto mixed = create<double>({m, 3, d});
  std::copy_n(columns.data(), columns.size(), mixed.data());
  for (std::size_t i = 0; i < m; ++i)
    add_tangential(-1. * vector2(view(direction), i),
                   view(columns).subspan(3 * d * i, 3 * d),
                   view(mixed).subspan(3 * d * i, d));
  return mixed;
}

double longest_in_cones(const Doubles& v, const Doubles& increment)
{
  check("v", v, {any, any});
  check("increment", increment, {v.shape(0), v.shape(1)});
  const std::size_t d = v.shape(1);
  if (d == 0)
    throw nb::value_error("v: expected at least one component a row");
  double longest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < v.size(); i += d)
    longest = std::min(longest, longest_in_cone(view(v).subspan(i, d),
                                                view(increment).subspan(i, d)));
  return longest;
}
} // namespace

void friction(nb::module_& m)
{
  m.def("longest_in_cones", &longest_in_cones, nb::arg("v"),
        nb::arg("increment"),
        "(m, d), (m, d) -> how far all vectors stay in cones of right angles, "
        "in units of increments");
  m.def("slides", &slides_batch, nb::arg("limit"), nb::arg("trial"),
        nb::arg("motion"), nb::arg("heading"), nb::arg("sliding"),
        "(m,), (m, 2), (m, 2), (m, 2), (m,) -> whether each slides (m,)");
  m.def("with_friction", &with_friction_batch, nb::arg("columns"),
        nb::arg("direction"),
        "(m, 3, d), (m, 2) -> columns, the first less those of the tangents "
        "times the direction (m, 3, d)");
  m.def("exact_friction", &exact_batch, nb::arg("limit"), nb::arg("by_p"),
        nb::arg("by_slip"), nb::arg("t"), nb::arg("slip"), nb::arg("p"),
        nb::arg("c"), nb::arg("heading"), nb::arg("sliding"),
        "limit and its derivatives (m,), (m, 2), (m, 2), (m,), (m,), (m, 2), "
        "(m,) -> what does not scale with p (m, 2), direction (m, 2), "
        "stiffness (m, 2, 2)");
  m.def("balance", &balance_batch, nb::arg("normal"), nb::arg("force"),
        nb::arg("columns"), nb::arg("rank"), nb::arg("known"),
        nb::arg("direction"),
        "(m, 3), (m, 3), (m, 3, d) of which [:, :, :3] count, (m,), (m, 2), "
        "(m, 2) -> multipliers (m, 3), of which rank count");
}
} // namespace nts::bindings
