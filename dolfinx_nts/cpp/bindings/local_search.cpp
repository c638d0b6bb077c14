#include "array.h"
#include "nts/contact/batch.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;
using Keys = In<std::int64_t>;
/// Segment, xi, gap and normal of nodes, see `Found`.
using Result
    = std::tuple<Out<std::int32_t>, Out<double>, Out<double>, Out<double>>;

/// @brief Segments that move, by arrays that are not copied, with a tree over
/// them.
class SegmentsAndTree
{
public:
  SegmentsAndTree(Ints vertices, Doubles orientation, Keys key)
      : _vertices(std::move(vertices)), _orientation(std::move(orientation)),
        _key(std::move(key)), _tree(rows(_vertices))
  {
    dispatch(_vertices.shape(1), []<class S>() {});
    check("orientation", _orientation, {_vertices.shape(0)});
    check("key", _key, {_vertices.shape(0)});
    for (const std::int32_t row : view(_vertices))
    {
      if (row < 0)
        throw nb::value_error("vertices: expected no negative entry");
      _num_rows = std::max(_num_rows, static_cast<std::size_t>(row) + 1);
    }
  }

  Result pair(const Doubles& x_node, const Ints& current, double slack,
              double reach, const Doubles& x)
  {
    return pair_with(x_node, current, slack, reach, x,
                     []<class S>() { return any_segment; });
  }

  Result pair_own(const Doubles& x_node, const Ints& current, double slack,
                  double reach, const Doubles& x, const Doubles& normal,
                  const Doubles& X_node, const Doubles& N_node,
                  const Doubles& X, const Doubles& thickness)
  {
    check("x_node", x_node, {any, 3});
    const std::size_t n = x_node.shape(0);
    check("normal", normal, {n, 3});
    check("X_node", X_node, {n, 3});
    check("N_node", N_node, {n, 3});
    check_positions("X", X);
    check("thickness", thickness, {_vertices.shape(0)});
    return pair_with(
        x_node, current, slack, reach, x,
        [&]<class S>()
        {
          const SelfContact<S> own{view(normal), view(X_node), view(N_node),
                                   surface<S>(X), view(thickness)};
          return [own](std::size_t i) noexcept { return own.of(i); };
        });
  }

  auto near(const Doubles& x_node, double reach, const Doubles& x)
  {
    check("x_node", x_node, {any, 3});
    check_positions("x", x);
    const auto found = _tree.near(view(x_node), reach, view(x));
    auto numbers = create<std::int32_t>({found.size()});
    std::ranges::copy(found, numbers.data());
    return numbers;
  }

  auto find(const Keys& keys) const
  {
    const auto own = view(_key);
    auto found = create<std::int32_t>({keys.size()});
    std::ranges::transform(
        view(keys), found.data(),
        [&](std::int64_t key)
        {
          const auto at = std::ranges::lower_bound(own, key);
          const bool exists = at != own.end() && *at == key;
          return exists ? static_cast<std::int32_t>(at - own.begin()) : -1;
        });
    return found;
  }

  std::size_t num_trees() const noexcept { return _tree.num_built(); }

private:
  static CachedTree rows(const Ints& vertices)
  {
    check("vertices", vertices, {any, any});
    return {view(vertices), vertices.shape(1)};
  }

  template <class S>
  SegmentSurface<S> surface(const Doubles& x) const noexcept
  {
    return {view(x), view(_vertices), view(_orientation), view(_key)};
  }

  void check_positions(const char* name, const Doubles& x) const
  {
    check(name, x, {any, 3});
    if (x.shape(0) < _num_rows)
      throw nb::value_error(
          (std::string(name) + ": expected a row for each of the vertices")
              .c_str());
  }

  /// @brief Find the segments of nodes that may touch what `MayTouch` says.
  template <class GetMayTouch>
  Result pair_with(const Doubles& x_node, const Ints& current, double slack,
                   double reach, const Doubles& x,
                   const GetMayTouch& get_may_touch)
  {
    check("x_node", x_node, {any, 3});
    const std::size_t n = x_node.shape(0);
    check("current", current, {n});
    check_positions("x", x);
    for (const std::int32_t c : view(current))
      if (c < -1 || c >= static_cast<std::int32_t>(_vertices.shape(0)))
        throw nb::value_error("current: expected -1 or a segment index");
    auto segment = create<std::int32_t>({n});
    auto xi = create<double>({n, 2});
    auto gap = create<double>({n});
    auto normal = create<double>({n, 3});
    dispatch(_vertices.shape(1),
             [&]<class S>()
             {
               const nb::gil_scoped_release release;
               pair_nodes(view(x_node), view(current), slack, reach,
                          surface<S>(x), _tree,
                          get_may_touch.template operator()<S>(), view(segment),
                          view(xi), view(gap), view(normal));
             });
    return {segment, xi, gap, normal};
  }

  Ints _vertices;
  Doubles _orientation;
  Keys _key;
  CachedTree _tree;
  std::size_t _num_rows = 0;
};

double farthest_point(const Doubles& x, const Doubles& before)
{
  check("x", x, {any, 3});
  check("before", before, {x.shape(0), 3});
  return farthest(view(x), view(before));
}
} // namespace

void local_search(nb::module_& m)
{
  m.attr("HYSTERESIS") = LocalSearchRule::hysteresis;
  m.attr("OVERHANG") = LocalSearchRule::overhang;
  m.attr("DEEPEST") = LocalSearchRule::depth;
  nb::class_<SegmentsAndTree>(
      m, "Segments",
      "Segments and a tree over them, which is built anew only if a vertex has "
      "moved far; the arrays are read, not copied")
      .def(nb::init<Ints, Doubles, Keys>(), nb::arg("vertices"),
           nb::arg("orientation"), nb::arg("key"),
           "(s, k) rows of positions, (s,), (s,) ascending")
      .def("find", &SegmentsAndTree::find, nb::arg("keys"),
           "(n,) -> segment of each key or -1 (n,)")
      .def("pair", &SegmentsAndTree::pair, nb::arg("x_node"),
           nb::arg("current"), nb::arg("slack"), nb::arg("reach"), nb::arg("x"),
           "(n, 3), (n,), -, -, (l, 3) -> segment (n,) or -1, xi (n, 2), gap "
           "(n,), normal (n, 3), see nts/search/local_search.h")
      .def("pair_own", &SegmentsAndTree::pair_own, nb::arg("x_node"),
           nb::arg("current"), nb::arg("slack"), nb::arg("reach"), nb::arg("x"),
           nb::arg("normal"), nb::arg("X_node"), nb::arg("N_node"),
           nb::arg("X"), nb::arg("thickness"),
           "as pair and (n, 3), (n, 3), (n, 3), (l, 3), (s,) -> the same for "
           "nodes of the surface itself, see nts/search/self_contact.h")
      .def("near", &SegmentsAndTree::near, nb::arg("x_node"), nb::arg("reach"),
           nb::arg("x"),
           "(n, 3), -, (l, 3) -> numbers of the nodes within reach of the box "
           "of a segment (m,)")
      .def_prop_ro("num_trees", &SegmentsAndTree::num_trees,
                   "How often a tree was built");
  m.def("farthest", &farthest_point, nb::arg("x"), nb::arg("before"),
        "(n, 3), (n, 3) -> largest distance between rows, NaN if one is");
}
} // namespace nts::bindings
