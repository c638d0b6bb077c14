#include "array.h"
#include "nts/contact/batch.h"
#include "nts/search/trajectory.h"

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

/// @brief Facets around the nodes of a surface, by arrays that are not copied.
class NodeFacets
{
public:
  NodeFacets(Ints vertices, Doubles orientation, Ints first, Ints facets,
             Doubles angle)
      : _vertices(std::move(vertices)), _orientation(std::move(orientation)),
        _first(std::move(first)), _facets(std::move(facets)),
        _angle(std::move(angle))
  {
    dispatch(_vertices.shape(1), []<class S>() {});
    check("orientation", _orientation, {_vertices.shape(0)});
    check("first", _first, {any});
    check("facets", _facets, {any});
    check("angle", _angle, {_facets.shape(0)});
  }

  /// @brief The facets at positions x, for nodes by these numbers.
  FacetsAroundNodes at(const Doubles& x, const Ints& numbers) const
  {
    check("x_facets", x, {any, 3});
    for (const std::int32_t number : view(numbers))
      if (number < 0 || static_cast<std::size_t>(number) + 1 >= _first.shape(0))
        throw nb::value_error("numbers: expected those of nodes");
    return {view(_vertices), view(_orientation), _vertices.shape(1),
            view(_first),    view(_facets),      view(_angle),
            view(x)};
  }

private:
  Ints _vertices;
  Doubles _orientation;
  Ints _first, _facets;
  Doubles _angle;
};

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
              double reach, const Doubles& x, const NodeFacets& facets,
              const Doubles& x_facets, const Ints& numbers,
              const Doubles& thickness)
  {
    check("numbers", numbers, {current.shape(0)});
    check("thickness", thickness, {_vertices.shape(0)});
    const FacetsAroundNodes around = facets.at(x_facets, numbers);
    return pair_with(x_node, current, slack, reach, x,
                     [&]<class S>(const Tree* tree)
                     {
                       const SegmentSurface<S> segments = surface<S>(x);
                       return [&, segments,
                               normals
                               = NormalBounds<S>(segments, tree)](std::size_t i)
                       {
                         return Facing<S>(around, view(numbers)[i], segments,
                                          normals, view(thickness));
                       };
                     });
  }

  auto follow(const Doubles& x_node_n, const Doubles& x_node, const Ints& row,
              const Ints& inside, const Doubles& x_n, const Doubles& x,
              const NodeFacets& facets, const Doubles& x_facets,
              const Ints& numbers) const
  {
    check("x_node_n", x_node_n, {any, 3});
    const std::size_t n = x_node_n.shape(0);
    check("x_node", x_node, {n, 3});
    check("row", row, {n});
    check_segments("inside", inside, n);
    check_positions("x_n", x_n);
    check("x", x, {x_n.shape(0), 3});
    check("numbers", numbers, {n});
    const FacetsAroundNodes around = facets.at(x_facets, numbers);
    auto entered = create<std::int32_t>({n});
    auto leaves = create<bool>({n});
    auto begin = create<double>({n}), way = create<double>({n}),
         cosine = create<double>({n}), gap = create<double>({n});
    const MovingSurface surface{view(x_n), view(x), view(_vertices),
                                view(_orientation), _vertices.shape(1)};
    Trajectories trajectories(surface);
    for (std::size_t i = 0; i < n; ++i)
    {
      const Trajectory t = trajectories.follow(
          vector(view(x_node_n), i), vector(view(x_node), i), view(row)[i],
          view(inside)[i], Directions(around, view(numbers)[i]));
      entered.data()[i] = t.entered;
      leaves.data()[i] = t.leaves;
      begin.data()[i] = t.begin;
      way.data()[i] = t.way;
      cosine.data()[i] = t.cosine;
      gap.data()[i] = t.gap;
    }
    return std::tuple(entered, leaves, begin, way, cosine, gap);
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
        [&]<class S>(const Tree*)
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

  void check_segments(const char* name, const Ints& numbers,
                      std::size_t n) const
  {
    check(name, numbers, {n});
    for (const std::int32_t i : view(numbers))
      if (i < -1 || i >= static_cast<std::int32_t>(_vertices.shape(0)))
        throw nb::value_error(
            (std::string(name) + ": expected -1 or a segment index").c_str());
  }

  /// @brief Find the segments of nodes that may touch what `get_may_touch`
  /// returns, given the tree of looks at any distance.
  template <class GetMayTouch>
  Result pair_with(const Doubles& x_node, const Ints& current, double slack,
                   double reach, const Doubles& x,
                   const GetMayTouch& get_may_touch)
  {
    check("x_node", x_node, {any, 3});
    const std::size_t n = x_node.shape(0);
    check_segments("current", current, n);
    check_positions("x", x);
    auto segment = create<std::int32_t>({n});
    auto xi = create<double>({n, 2});
    auto gap = create<double>({n});
    auto normal = create<double>({n, 3});
    dispatch(_vertices.shape(1),
             [&]<class S>()
             {
               const nb::gil_scoped_release release;
               const Tree* exact
                   = std::isinf(reach) ? &_tree.exactly_at(view(x)) : nullptr;
               const auto tree = [&]() -> const Tree&
               { return exact ? *exact : _tree.at(view(x)); };
               pair_nodes(view(x_node), view(current), slack, reach,
                          surface<S>(x), tree,
                          get_may_touch.template operator()<S>(exact),
                          view(segment), view(xi), view(gap), view(normal));
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
  return farthest(view(x), view(before),
                  std::views::iota(std::size_t{0}, x.shape(0)));
}

auto lost_nodes(const Ints& before, const Ints& after)
{
  const auto then = view(before), now = view(after);
  check("after", after, {then.size()});
  std::vector<std::int32_t> found;
  for (std::size_t i = 0; i < then.size(); ++i)
    if (then[i] >= 0 && now[i] < 0)
      found.push_back(static_cast<std::int32_t>(i));
  auto numbers = create<std::int32_t>({found.size()});
  std::ranges::copy(found, numbers.data());
  return numbers;
}
} // namespace

void local_search(nb::module_& m)
{
  m.attr("HYSTERESIS") = LocalSearchRule::hysteresis;
  m.attr("OVERHANG") = LocalSearchRule::overhang;
  m.attr("DEEPEST") = LocalSearchRule::depth;
  m.attr("WALL") = FacingRule::wall;
  nb::class_<NodeFacets>(m, "NodeFacets",
                         "Facets around the nodes of a surface; the arrays are "
                         "read, not copied")
      .def(nb::init<Ints, Doubles, Ints, Ints, Doubles>(), nb::arg("vertices"),
           nb::arg("orientation"), nb::arg("first"), nb::arg("facets"),
           nb::arg("angle"),
           "(f, k) rows of positions, (f,), (n + 1,) first entry of each node, "
           "(e,) facets around it and (e,) their angles there");
  nb::class_<SegmentsAndTree>(
      m, "Segments",
      "Segments and a tree over them, which is built anew only if a vertex has "
      "moved far; the arrays are read, not copied")
      .def(nb::init<Ints, Doubles, Keys>(), nb::arg("vertices"),
           nb::arg("orientation"), nb::arg("key"),
           "(s, k) rows of positions, (s,), (s,) ascending")
      .def("find", &SegmentsAndTree::find, nb::arg("keys"),
           "(n,) -> segment of each key or -1 (n,)")
      .def(
          "pair", &SegmentsAndTree::pair, nb::arg("x_node"), nb::arg("current"),
          nb::arg("slack"), nb::arg("reach"), nb::arg("x"), nb::arg("facets"),
          nb::arg("x_facets"), nb::arg("numbers"), nb::arg("thickness"),
          "(n, 3), (n,), -, -, (l, 3), NodeFacets, (f, 3), (n,) their numbers, "
          "(s,) -> segment (n,) or -1, xi (n, 2), gap (n,), normal (n, 3), see "
          "nts/search/facing.h")
      .def("follow", &SegmentsAndTree::follow, nb::arg("x_node_n"),
           nb::arg("x_node"), nb::arg("row"), nb::arg("inside"), nb::arg("x_n"),
           nb::arg("x"), nb::arg("facets"), nb::arg("x_facets"),
           nb::arg("numbers"),
           "(n, 3), (n, 3), (n,), (n,), (l, 3), (l, 3), NodeFacets, (f, 3), "
           "(n,) -> entered, leaves, begin, way, cosine, gap, each (n,), see "
           "nts/search/trajectory.h")
      .def(
          "pair_own", &SegmentsAndTree::pair_own, nb::arg("x_node"),
          nb::arg("current"), nb::arg("slack"), nb::arg("reach"), nb::arg("x"),
          nb::arg("normal"), nb::arg("X_node"), nb::arg("N_node"), nb::arg("X"),
          nb::arg("thickness"),
          "(n, 3), (n,), -, -, (l, 3), (n, 3), (n, 3), (n, 3), (l, 3), (s,) -> "
          "as pair for nodes of the surface itself, see "
          "nts/search/self_contact.h")
      .def("near", &SegmentsAndTree::near, nb::arg("x_node"), nb::arg("reach"),
           nb::arg("x"),
           "(n, 3), -, (l, 3) -> numbers of the nodes within reach of the box "
           "of a segment (m,)")
      .def_prop_ro("num_trees", &SegmentsAndTree::num_trees,
                   "How often a tree was built");
  m.def("farthest", &farthest_point, nb::arg("x"), nb::arg("before"),
        "(n, 3), (n, 3) -> largest distance between rows, NaN if one is");
  m.def("lost", &lost_nodes, nb::arg("before"), nb::arg("after"),
        "(n,), (n,) segments of nodes or -1 -> numbers of the nodes that have "
        "one before, and none after (m,)");
}
} // namespace nts::bindings
