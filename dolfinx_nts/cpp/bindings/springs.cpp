#include "nts/contact/springs.h"
#include "array.h"
#include "nts/geometry/rows.h"

#include <nanobind/stl/array.h>
#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;
using Keys = In<std::int64_t>;

/// @brief Springs of nodes at one state, with arrays that Python may change.
class Springs
{
public:
  Springs(Ints node, Keys key, Ints dofs, Out<double> force, Out<double> energy)
      : _node(std::move(node)), _key(std::move(key)), _dofs(std::move(dofs)),
        _force(std::move(force)), _energy(std::move(energy))
  {
    const std::size_t m = _node.size();
    check("node", _node, {m});
    check("key", _key, {m});
    check("dofs", _dofs, {m, any});
    check("force", _force, {m, _dofs.shape(1), 3});
    check("energy", _energy, {m});
  }

  MovedSprings moved(const Doubles& du) const
  {
    check("du", du, {any, 3});
    check_rows("dofs: expected row numbers of du", _dofs, du.shape(0));
    return {view(_node),  view(_key),    view(_dofs),
            view(_force), view(_energy), view(du)};
  }

  const Ints& node() const noexcept { return _node; }

  std::size_t num_nodes() const noexcept
  {
    std::size_t sum = 0;
    for (std::size_t i = 0; i < _node.size(); ++i)
      sum += i == 0 || _node.data()[i] != _node.data()[i - 1];
    return sum;
  }

  const Keys& key() const noexcept { return _key; }
  const Ints& dofs() const noexcept { return _dofs; }
  const Out<double>& force() const noexcept { return _force; }
  const Out<double>& energy() const noexcept { return _energy; }

private:
  Ints _node;
  Keys _key;
  Ints _dofs;
  Out<double> _force, _energy;
};

Springs penalty_forces_of_pairs(const Ints& number, const Ints& node,
                                const Ints& segment, const Doubles& xi,
                                const Doubles& gap, const Doubles& normal,
                                const Ints& segments, const Keys& key,
                                const Doubles& stiffness)
{
  const std::size_t c = node.size();
  check("number", number, {c});
  check("node", node, {c});
  check("segment", segment, {c});
  check("xi", xi, {c, 2});
  check("gap", gap, {c});
  check("normal", normal, {c, 3});
  check("segments", segments, {any, any});
  check("key", key, {segments.shape(0)});
  check("stiffness", stiffness, {c});
  const Paired pairs{view(node), view(segment), view(xi), view(gap),
                     view(normal)};
  const std::vector<std::int32_t> chosen = inside(pairs);
  const std::size_t m = chosen.size(), k = segments.shape(1);
  auto numbers = create<std::int32_t>({m});
  auto keys = create<std::int64_t>({m});
  for (std::size_t i = 0; i < m; ++i)
  {
    const auto row = static_cast<std::size_t>(pairs.segment[chosen[i]]);
    if (row >= key.size())
      throw nb::value_error(
          "segment: expected indices of key where gaps are < 0");
    numbers.data()[i] = number.data()[chosen[i]];
    keys.data()[i] = key.data()[row];
  }
  auto dofs = create<std::int32_t>({m, 1 + k});
  auto force = create<double>({m, 1 + k, 3});
  auto energy = create<double>({m});
  dispatch(k,
           [&]<class S>()
           {
             penalty_forces<S>(pairs, chosen, view(segments), view(stiffness),
                               view(dofs), view(force), view(energy));
           });
  return {numbers, keys, dofs, force, energy};
}

auto contact_of(const Springs& springs, std::size_t num_own, std::size_t n,
                const Ints& number, const Ints& segment, const Doubles& gap,
                const Keys& key, const Doubles& stiffness)
{
  const std::size_t c = number.size(), width = springs.dofs().shape(1);
  check("number", number, {c});
  check_rows("number: expected numbers of nodes", number, n);
  check("segment", segment, {c});
  check("gap", gap, {c});
  check("key", key, {any});
  check("stiffness", stiffness, {c});
  if (num_own > width)
    throw nb::value_error(
        "num_own: expected at most the number of nodes of a spring");
  auto keys = create<std::int64_t>({n});
  auto active = create<bool>({n});
  auto multiplier = create<double>({n}), gaps = create<double>({n}),
       energy = create<double>({n});
  auto force = create<double>({n, 3}), normal = create<double>({n, 3});
  std::fill_n(keys.data(), n, -1);
  std::fill_n(active.data(), n, false);
  std::fill_n(gaps.data(), n, NAN);
  for (Out<double>* of_all : {&multiplier, &energy, &force, &normal})
    std::ranges::fill(view(*of_all), 0.);
  std::size_t m = 0;
  // A node that is equally near to several segments has consecutive springs.
  for (std::size_t i = 0, first = 0; i < c; ++i)
  {
    const auto node = static_cast<std::size_t>(number.data()[i]);
    if (number.data()[i] != number.data()[first])
      first = i;
    const std::int32_t row = segment.data()[i];
    if (row >= static_cast<std::ptrdiff_t>(key.size()))
      throw nb::value_error("segment: expected -1 or indices of key");
    if (row >= 0 && i == first)
      keys.data()[node] = key.data()[row];
    gaps.data()[node] = gap.data()[i];
    if (!std::isless(gap.data()[i], 0.))
      continue;
    if (m >= springs.node().size())
      throw nb::value_error("springs: expected a spring for each gap < 0");
    active.data()[node] = true;
    energy.data()[node] += springs.energy().data()[m];
    multiplier.data()[node] += stiffness.data()[i] * gap.data()[i];
    Vec3 sum = vector(view(std::as_const(force)), node);
    for (std::size_t a = 0; a < num_own; ++a)
      sum += vector(view(springs.force()), width * m + a);
    for (std::size_t j = 0; j < 3; ++j)
      force.data()[3 * node + j] = sum[j];
    // The mean of several normals is shorter than a unit vector.
    const double size
        = i == first ? -multiplier.data()[node] : std::sqrt(dot(sum, sum));
    for (std::size_t j = 0; j < 3; ++j)
      normal.data()[3 * node + j] = size > 0 ? sum[j] / size : 0.;
    ++m;
  }
  return std::tuple(keys, active, multiplier, force, gaps, normal, energy);
}

auto contact_sums_of(const Doubles& x, const Ints& nodes, const Doubles& force,
                     const Doubles& energy, const In<bool>& active,
                     const Doubles& acts_on, const Doubles& area)
{
  const std::size_t n = nodes.size();
  check("x", x, {any, 3});
  check_rows("nodes: expected row numbers of x", nodes, x.shape(0));
  check("force", force, {n, 3});
  check("energy", energy, {n});
  check("active", active, {n});
  check("acts_on", acts_on, {n});
  check("area", area, {n});
  auto sums = create<double>({9});
  std::ranges::fill(view(sums), 0.);
  for (std::size_t i = 0; i < n; ++i)
  {
    sums.data()[0] += energy.data()[i];
    if (active.data()[i])
    {
      sums.data()[1] += 1;
      sums.data()[2]
          += acts_on.data()[i] > 0 ? acts_on.data()[i] : area.data()[i];
    }
  }
  const Resultant total = resultant(view(x), view(nodes), view(force));
  std::ranges::copy(total.sum, sums.data() + 3);
  std::ranges::copy(total.moment, sums.data() + 6);
  return sums;
}

std::array<double, 5> work_of(const Springs& before, const Springs& after,
                              const Doubles& du_before, const Doubles& du_after,
                              const Doubles& dissipation)
{
  if (dissipation.size())
    for (const Springs* springs : {&before, &after})
      check_rows("node: expected row numbers of dissipation", springs->node(),
                 dissipation.size());
  return work_by_cause(before.moved(du_before), after.moved(du_after),
                       view(dissipation));
}

void add_to_rows(Out<double> total, Out<double> ghosts, const Ints& rows,
                 const Doubles& values)
{
  check("total", total, {any, any});
  const std::size_t components = total.shape(1);
  check("ghosts", ghosts, {any, components});
  if (values.size() != components * rows.size())
    throw nb::value_error("values: expected one row for each entry of rows");
  check_rows("rows: expected row numbers of total, and then of ghosts", rows,
             total.shape(0) + ghosts.shape(0));
  dispatch_components(components,
                      [&]<std::size_t B>()
                      {
                        add_rows<B>(ChangedValues{view(total), view(ghosts)},
                                    view(rows), view(values));
                      });
}
} // namespace

void springs(nb::module_& m)
{
  nb::class_<Springs>(m, "Springs", "Springs of some nodes at one state")
      .def(nb::init<Ints, Keys, Ints, Out<double>, Out<double>>(),
           nb::arg("node"), nb::arg("key"), nb::arg("dofs"),
           nb::arg("force").noconvert(), nb::arg("energy").noconvert(),
           "(m,), (m,), (m, 1+k), (m, 1+k, 3), (m,)")
      .def_prop_ro("node", &Springs::node,
                   "Numbers of the nodes, ascending, (m,); a node on several "
                   "segments has a spring on each")
      .def_prop_ro("num_nodes", &Springs::num_nodes, "Number of nodes")
      .def_prop_ro("key", &Springs::key, "Keys of their segments, (m,)")
      .def_prop_ro("dofs", &Springs::dofs,
                   "Nodes and vertices of the pairs, (m, 1+k)")
      .def_prop_ro("force", &Springs::force,
                   "Forces on the dofs, (m, 1+k, 3) [N]")
      .def_prop_ro("energy", &Springs::energy, "Energies, (m,) [J]");
  m.def("penalty_forces", &penalty_forces_of_pairs, nb::arg("number"),
        nb::arg("node"), nb::arg("segment"), nb::arg("xi"), nb::arg("gap"),
        nb::arg("normal"), nb::arg("segments"), nb::arg("key"),
        nb::arg("stiffness"),
        "(c,), (c,), (c,), (c, 2), (c,), (c, 3), (s, k), (s,), (c,) -> springs "
        "of gaps < 0");
  m.def("contact_of_springs", &contact_of, nb::arg("springs"),
        nb::arg("num_own"), nb::arg("n"), nb::arg("number"), nb::arg("segment"),
        nb::arg("gap"), nb::arg("key"), nb::arg("stiffness"),
        "springs of gaps < 0, their nodes on the surface, nodes of that, (c,), "
        "(c,) or -1, (c,), (s,), (c,) -> key (n,), active (n,), lambda_N (n,), "
        "force (n, 3), gap (n,), normal (n, 3), energy (n,)");
  m.def("contact_sums", &contact_sums_of, nb::arg("x"), nb::arg("nodes"),
        nb::arg("force"), nb::arg("energy"), nb::arg("active"),
        nb::arg("acts_on"), nb::arg("area"),
        "(l, 3), (n,) rows of x, (n, 3), (n,), (n,), areas (n,) that are those "
        "of nodes (n,) where 0 -> energy, number and area of active nodes, "
        "force, torque about the origin (9,)");
  m.def("work_by_cause", &work_of, nb::arg("before"), nb::arg("after"),
        nb::arg("du_before"), nb::arg("du_after"), nb::arg("dissipation"),
        "springs, springs, (l, 3), (l, 3), (n,) or (0,) -> work of nodes that "
        "stayed, that came, that changed the segment, of springs, of friction");
  m.def("add_rows", &add_to_rows, nb::arg("total").noconvert(),
        nb::arg("ghosts").noconvert(), nb::arg("rows"), nb::arg("values"),
        "adds values (..., b) to rows (...) of (n, b), and then of (g, b)");
}
} // namespace nts::bindings
