#include "nts/springs.h"
#include "array.h"

#include <nanobind/stl/array.h>
#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;
using Keys = In<std::int64_t>;

auto press_pairs(const Ints& node, const Ints& segment, const Doubles& xi,
                 const Doubles& gap, const Doubles& normal,
                 const Ints& segments, const Doubles& stiffness)
{
  const std::size_t c = node.size();
  check("node", node, {c});
  check("segment", segment, {c});
  check("xi", xi, {c, 2});
  check("gap", gap, {c});
  check("normal", normal, {c, 3});
  check("segments", segments, {any, any});
  check("stiffness", stiffness, {c});
  const Paired pairs{view(node), view(segment), view(xi), view(gap),
                     view(normal)};
  const std::vector<std::int32_t> chosen = inside(pairs);
  const std::size_t m = chosen.size(), k = segments.shape(1);
  for (const std::int32_t i : chosen)
    if (pairs.segment[i] < 0
        || static_cast<std::size_t>(pairs.segment[i]) >= segments.shape(0))
      throw nb::value_error("segment: expected rows of segments at gaps < 0");
  auto positions = create<std::int32_t>({m});
  std::copy(chosen.begin(), chosen.end(), positions.data());
  auto dofs = create<std::int32_t>({m, 1 + k});
  auto force = create<double>({m, 1 + k, 3});
  auto energy = create<double>({m});
  dispatch(k,
           [&]<class S>()
           {
             press<S>(pairs, chosen, view(segments), view(stiffness),
                      view(dofs), view(force), view(energy));
           });
  return std::tuple(positions, dofs, force, energy);
}

PressedNodes pressed_nodes(const Ints& node, const Keys& key, const Ints& dofs,
                           const Doubles& force, const Doubles& energy,
                           const Doubles& du)
{
  const std::size_t m = node.size();
  check("node", node, {m});
  check("key", key, {m});
  check("dofs", dofs, {m, any});
  check("force", force, {m, dofs.shape(1), 3});
  check("energy", energy, {m});
  check("du", du, {any, 3});
  check_rows("dofs: expected rows of du", dofs, du.shape(0));
  return {view(node),  view(key),    view(dofs),
          view(force), view(energy), view(du)};
}

using State = std::tuple<Ints, Keys, Ints, Doubles, Doubles, Doubles>;

std::array<double, 5> work_of(const State& before, const State& after,
                              const Doubles& lost)
{
  const PressedNodes a = std::apply(pressed_nodes, before);
  const PressedNodes b = std::apply(pressed_nodes, after);
  if (lost.size())
  {
    check_rows("node: expected rows of lost", std::get<0>(before), lost.size());
    check_rows("node: expected rows of lost", std::get<0>(after), lost.size());
  }
  return work_by_cause(a, b, view(lost));
}

void add_to_rows(Out<double> total, const Ints& rows, const Doubles& values)
{
  check("total", total, {any, 3});
  if (values.size() != 3 * rows.size())
    throw nb::value_error("values: expected three for each of rows");
  check_rows("rows: expected rows of total", rows, total.shape(0));
  add_rows(view(total), view(rows), view(values));
}
} // namespace

void springs(nb::module_& m)
{
  m.def("press", &press_pairs, nb::arg("node"), nb::arg("segment"),
        nb::arg("xi"), nb::arg("gap"), nb::arg("normal"), nb::arg("segments"),
        nb::arg("stiffness"),
        "(c,), (c,), (c, 2), (c,), (c, 3), (s, k), (c,) -> of gaps < 0: "
        "position (m,), dofs (m, 1+k), force (m, 1+k, 3), energy (m,)");
  m.def("work_by_cause", &work_of, nb::arg("before"), nb::arg("after"),
        nb::arg("lost"),
        "twice (node (m,), key (m,), dofs (m, 1+k), force (m, 1+k, 3), energy "
        "(m,), du (l, 3)), (n,) or (0,) -> work of nodes that stayed, that "
        "came, that changed the segment, of springs, of friction");
  m.def("add_rows", &add_to_rows, nb::arg("total").noconvert(), nb::arg("rows"),
        nb::arg("values"), "adds values (..., 3) to rows (...) of (n, 3)");
}
} // namespace nts::bindings
