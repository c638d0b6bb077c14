#include "array.h"
#include "nts/contact/batch.h"
#include "nts/search/trajectory.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;
using Keys = In<std::int64_t>;
/// Segment, xi, gap and normal of nodes, see `Found`.
using Result
    = std::tuple<Out<std::int32_t>, Out<double>, Out<double>, Out<double>>;
/// Search radius [m], of all nodes or of each group.
using Reach = std::variant<double, Doubles>;

/// @brief Facets around the nodes of a surface, as views of arrays.
class NodeFacets
{
public:
  NodeFacets(Ints vertices, Doubles orientation, Ints first, Ints facets,
             Ints corner, Doubles angle, std::optional<Ints> group)
      : _vertices(std::move(vertices)), _orientation(std::move(orientation)),
        _first(std::move(first)), _facets(std::move(facets)),
        _corner(std::move(corner)), _angle(std::move(angle)),
        _group(std::move(group))
  {
    dispatch(_vertices.shape(1), []<class S>() {});
    check("orientation", _orientation, {_vertices.shape(0)});
    check("first", _first, {any});
    check("facets", _facets, {any});
    check("corner", _corner, {_facets.shape(0)});
    check("angle", _angle, {_facets.shape(0)});
    if (_group)
      check("group", *_group, {_first.shape(0) - 1});
  }

  /// @brief The facets at positions x, for nodes with these numbers.
  FacetsAroundNodes at(const Doubles& x, const Ints& numbers) const
  {
    check("x_facets", x, {any, 3});
    for (const std::int32_t number : view(numbers))
      if (number < 0 || static_cast<std::size_t>(number) + 1 >= _first.shape(0))
        throw nb::value_error("numbers: expected node numbers");
    return {
        view(_vertices), view(_orientation), _vertices.shape(1), view(_first),
        view(_facets),   view(_corner),      view(_angle),       view(x)};
  }

  /// @brief Group of segments that each of these nodes may touch.
  auto groups(const Ints& numbers) const
  {
    return [this, own = view(numbers)](std::size_t i)
    { return _group ? view(*_group)[own[i]] : 0; };
  }

private:
  Ints _vertices;
  Doubles _orientation;
  Ints _first, _facets, _corner;
  Doubles _angle;
  std::optional<Ints> _group;
};

/// @brief Moving segments in groups, with a tree for each group and without
/// copies of arrays: a node searches one group only.
class SegmentsAndTrees
{
public:
  SegmentsAndTrees(Ints vertices, Doubles orientation, Keys key,
                   std::optional<Ints> first)
      : _vertices(std::move(vertices)), _orientation(std::move(orientation)),
        _key(std::move(key))
  {
    check("vertices", _vertices, {any, any});
    dispatch(_vertices.shape(1), []<class S>() {});
    const auto num_segments = static_cast<std::int32_t>(_vertices.shape(0));
    if (first)
      _first.assign(view(*first).begin(), view(*first).end());
    else
      _first = {0, num_segments};
    if (_first.size() < 2 || _first.front() != 0
        || _first.back() != num_segments || !std::ranges::is_sorted(_first))
      throw nb::value_error("first: expected ascending offsets of the "
                            "groups of segments");
    _sunk.resize(_first.size() - 1);
    _trees.reserve(_first.size() - 1);
    for (std::size_t g = 0; g + 1 < _first.size(); ++g)
      _trees.emplace_back(part(_vertices, g, _vertices.shape(1)),
                          _vertices.shape(1));
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
              const Reach& reach, const Doubles& x, const NodeFacets& facets,
              const Doubles& x_facets, const Ints& numbers,
              const Doubles& thickness)
  {
    check("numbers", numbers, {current.shape(0)});
    check("thickness", thickness, {_vertices.shape(0)});
    const FacetsAroundNodes around = facets.at(x_facets, numbers);
    return pair_with(
        x_node, current, slack, reach, x, facets.groups(numbers), view(numbers),
        [&]<class S>(std::size_t group, std::size_t begin, const Tree* tree)
        {
          const SegmentSurface<S> segments = surface<S>(x, group);
          return [&, segments, own = view(numbers).subspan(begin),
                  thick = part(thickness, group),
                  normals = NormalBounds<S>(segments, tree)](std::size_t i)
          { return Facing<S>(around, own[i], segments, normals, thick); };
        });
  }

  auto follow(const Doubles& x_node_n, const Doubles& x_node, const Ints& row,
              const Ints& inside, const Doubles& x_n, const Doubles& x,
              const NodeFacets& facets, const Doubles& x_facets,
              const Ints& numbers)
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
    auto begin = create<double>({n}), length = create<double>({n}),
         cosine = create<double>({n}), gap = create<double>({n});
    const auto follow_group
        = [&]<class S>(std::size_t group, std::size_t from, std::size_t to)
    {
      const SegmentSurface<S> segments = surface<S>(x_n, group);
      const NormalBounds<S> without(segments, nullptr);
      // Thickness limits the depth of nodes behind a segment, but at its entry
      // a node has no depth.
      const std::vector<double> thickness(segments.orientation.size(), 0.);
      const MovingSurface surface{view(x_n), view(x),
                                  part(_vertices, group, S::vertices),
                                  part(_orientation, group), S::vertices};
      Trajectories trajectories(surface);
      for (std::size_t i = from; i < to; ++i)
      {
        const Trajectory t = trajectories.follow(
            vector(view(x_node_n), i), vector(view(x_node), i), view(row)[i],
            in_group(view(inside)[i], group),
            Facing<S>(around, view(numbers)[i], segments, without, thickness),
            [&]() -> const Tree& { return _trees[group].at(view(x_n)); });
        entered.data()[i] = among_all(t.entered, group);
        leaves.data()[i] = t.leaves;
        begin.data()[i] = t.begin;
        length.data()[i] = t.length;
        cosine.data()[i] = t.cosine;
        gap.data()[i] = t.gap;
      }
    };
    dispatch(_vertices.shape(1),
             [&]<class S>()
             {
               each_run(
                   n, facets.groups(numbers),
                   [&](std::size_t group, std::size_t from, std::size_t to)
                   { follow_group.template operator()<S>(group, from, to); });
             });
    return std::tuple(entered, leaves, begin, length, cosine, gap);
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
        x_node, current, slack, reach, x, [](std::size_t) { return 0; }, {},
        [&]<class S>(std::size_t group, std::size_t, const Tree*)
        {
          const SelfContact<S> own{view(normal), view(X_node), view(N_node),
                                   surface<S>(X, group), view(thickness)};
          return [own](std::size_t i) noexcept { return own.of(i); };
        });
  }

  auto near(const Doubles& x_node, double reach, const Doubles& x,
            const std::optional<Ints>& group)
  {
    check("x_node", x_node, {any, 3});
    const std::size_t n = x_node.shape(0);
    if (group)
      check("group", *group, {n});
    check_positions("x", x);
    std::vector<std::int32_t> found;
    each_run(
        n, [&](std::size_t i) { return group ? view(*group)[i] : 0; },
        [&](std::size_t g, std::size_t begin, std::size_t end)
        { _trees[g].near(view(x_node), begin, end, reach, view(x), found); });
    auto numbers = create<std::int32_t>({found.size()});
    std::ranges::copy(found, numbers.data());
    return numbers;
  }

  auto find(const Keys& keys, const std::optional<Ints>& group) const
  {
    if (group)
      check("group", *group, {keys.size()});
    auto found = create<std::int32_t>({keys.size()});
    each_run(
        keys.size(), [&](std::size_t i) { return group ? view(*group)[i] : 0; },
        [&](std::size_t g, std::size_t begin, std::size_t end)
        {
          const auto own = part(_key, g);
          for (std::size_t i = begin; i < end; ++i)
          {
            const std::int64_t key = view(keys)[i];
            const auto at = std::ranges::lower_bound(own, key);
            const bool exists = at != own.end() && *at == key;
            found.data()[i] = among_all(exists ? at - own.begin() : -1, g);
          }
        });
    return found;
  }

  /// @brief Set the depth of initially penetrating nodes in each group [m].
  void sink(const Doubles& depth)
  {
    check("depth", depth, {_trees.size()});
    std::ranges::copy(view(depth), _sunk.begin());
  }

  /// @brief Set whether nodes below concave edges keep a segment.
  void hold_in_dents(bool held) noexcept { _in_dents = held; }

  std::size_t num_trees() const noexcept
  {
    std::size_t total = 0;
    for (const CachedTree& tree : _trees)
      total += tree.num_built();
    return total;
  }

private:
  /// @brief Part of an array for the segments of a group, k entries of each.
  template <class T>
  std::span<const T> part(const In<T>& array, std::size_t group,
                          std::size_t k = 1) const noexcept
  {
    return view(array).subspan(k * _first[group],
                               k * (_first[group + 1] - _first[group]));
  }

  /// @brief Number of a segment within its group; -1 for none.
  std::int32_t in_group(std::int32_t segment, std::size_t group) const
  {
    if (segment < 0)
      return segment;
    if (segment < _first[group] || segment >= _first[group + 1])
      throw nb::value_error("expected a segment of the group of the node");
    return segment - _first[group];
  }

  /// @brief Number of a segment among all segments from its number in a group;
  /// -1 for none.
  std::int32_t among_all(std::ptrdiff_t segment,
                         std::size_t group) const noexcept
  {
    return static_cast<std::int32_t>(segment < 0 ? -1
                                                 : segment + _first[group]);
  }

  /// @brief Call a function with each group of n consecutive nodes, and its
  /// begin and end.
  template <class GroupOf, class Function>
  void each_run(std::size_t n, const GroupOf& group_of,
                Function&& function) const
  {
    for (std::size_t begin = 0, end = 0; begin < n; begin = end)
    {
      const std::int32_t group = group_of(begin);
      if (group < 0 || static_cast<std::size_t>(group) >= _trees.size())
        throw nb::value_error("expected a group of segments for each node");
      while (end < n && group_of(end) == group)
        ++end;
      function(static_cast<std::size_t>(group), begin, end);
    }
  }

  template <class S>
  SegmentSurface<S> surface(const Doubles& x, std::size_t group) const noexcept
  {
    return {view(x),
            part(_vertices, group, S::vertices),
            part(_orientation, group),
            part(_key, group),
            _sunk[group],
            _in_dents};
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

  /// @brief Result of the last search of a node at any distance, as the number
  /// of a segment in its group, or -1.
  std::int32_t last_faced(std::size_t number, std::size_t group) const noexcept
  {
    if (number >= _faced.size() || _faced[number] < _first[group]
        || _faced[number] >= _first[group + 1])
      return -1;
    return _faced[number] - _first[group];
  }

  /// @brief Store the candidate segments of nodes in searches at any distance.
  void remember(std::span<const std::int32_t> numbers,
                std::span<const std::int32_t> segment)
  {
    for (std::size_t i = 0; i < numbers.size(); ++i)
    {
      const auto number = static_cast<std::size_t>(numbers[i]);
      if (number >= _faced.size())
        _faced.resize(number + 1, -1);
      if (segment[i] >= 0)
        _faced[number] = segment[i];
    }
  }

  /// @brief Find the segments of nodes. `get_may_touch` returns the admissible
  /// contact directions for a group, its first node and the tree of searches at
  /// any distance. Numbered nodes start there at the result of the last search.
  template <class GroupOf, class GetMayTouch>
  Result pair_with(const Doubles& x_node, const Ints& current, double slack,
                   const Reach& reach, const Doubles& x,
                   const GroupOf& group_of,
                   std::span<const std::int32_t> numbers,
                   const GetMayTouch& get_may_touch)
  {
    check("x_node", x_node, {any, 3});
    const std::size_t n = x_node.shape(0);
    check_segments("current", current, n);
    check_positions("x", x);
    if (const auto* of_groups = std::get_if<Doubles>(&reach))
      check("reach", *of_groups, {_trees.size()});
    auto segment = create<std::int32_t>({n});
    auto xi = create<double>({n, 2});
    auto gap = create<double>({n});
    auto normal = create<double>({n, 3});
    dispatch(
        _vertices.shape(1),
        [&]<class S>()
        {
          const nb::gil_scoped_release release;
          each_run(
              n, group_of,
              [&](std::size_t group, std::size_t begin, std::size_t end)
              {
                const std::size_t m = end - begin;
                const auto own = view(segment).subspan(begin, m);
                for (std::size_t i = 0; i < m; ++i)
                  own[i] = in_group(view(current)[begin + i], group);
                const auto* of_all = std::get_if<double>(&reach);
                const double farthest
                    = of_all ? *of_all : view(std::get<Doubles>(reach))[group];
                CachedTree& cached = _trees[group];
                const Tree* exact = std::isinf(farthest)
                                        ? &cached.tight_at(view(x))
                                        : nullptr;
                const auto tree = [&]() -> const Tree&
                { return exact ? *exact : cached.at(view(x)); };
                const bool goes_on = exact && !numbers.empty();
                const auto first = [&](std::size_t i)
                {
                  return goes_on ? last_faced(numbers[begin + i], group) : -1;
                };
                // The old segment of a node is read before the new one is
                // written.
                pair_nodes(
                    view(x_node).subspan(3 * begin, 3 * m), own, slack,
                    farthest, surface<S>(x, group), tree,
                    get_may_touch.template operator()<S>(group, begin, exact),
                    first, own, view(xi).subspan(2 * begin, 2 * m),
                    view(gap).subspan(begin, m),
                    view(normal).subspan(3 * begin, 3 * m));
                for (std::int32_t& i : own)
                  i = among_all(i, group);
                if (goes_on)
                  remember(numbers.subspan(begin, m), own);
              });
        });
    return {segment, xi, gap, normal};
  }

  Ints _vertices;
  Doubles _orientation;
  Keys _key;
  std::vector<std::int32_t>
      _first; // first segment of each group, and number of segments
  std::vector<CachedTree> _trees;
  std::vector<double> _sunk; // depth of initially penetrating nodes [m]
  bool _in_dents = false;    // whether nodes below concave edges keep a segment
  std::vector<std::int32_t> _faced; // last segment of each node number, or -1
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
      .def(nb::init<Ints, Doubles, Ints, Ints, Ints, Doubles,
                    std::optional<Ints>>(),
           nb::arg("vertices"), nb::arg("orientation"), nb::arg("first"),
           nb::arg("facets"), nb::arg("corner"), nb::arg("angle"),
           nb::arg("group") = nb::none(),
           "(f, k) rows of positions, (f,), (n + 1,) first entry of each node, "
           "(e,) facets around it, (e,) the vertex of each that it is, and "
           "(e,) their angles there, (n,) group of "
           "the segments that it may touch");
  nb::class_<SegmentsAndTrees>(
      m, "Segments",
      "Segments in groups, among which nodes look, and a tree over each, which "
      "is built again only if a vertex has moved far; the arrays are read, not "
      "copied")
      .def(nb::init<Ints, Doubles, Keys, std::optional<Ints>>(),
           nb::arg("vertices"), nb::arg("orientation"), nb::arg("key"),
           nb::arg("first") = nb::none(),
           "(s, k) rows of positions, (s,), (s,) ascending in each group, "
           "(g + 1,) where groups begin and end, one without")
      .def("find", &SegmentsAndTrees::find, nb::arg("keys"),
           nb::arg("group") = nb::none(),
           "(n,), (n,) groups, the first without -> segment of each key or -1 "
           "(n,)")
      .def("pair", &SegmentsAndTrees::pair, nb::arg("x_node"),
           nb::arg("current"), nb::arg("slack"), nb::arg("reach"), nb::arg("x"),
           nb::arg("facets"), nb::arg("x_facets"), nb::arg("numbers"),
           nb::arg("thickness"),
           "(n, 3), (n,), -, - or (g,), (l, 3), NodeFacets, (f, 3), (n,) their "
           "numbers, (s,) -> segment (n,) or -1, xi (n, 2), gap (n,), normal "
           "(n, 3), see nts/search/facing.h")
      .def(
          "follow", &SegmentsAndTrees::follow, nb::arg("x_node_n"),
          nb::arg("x_node"), nb::arg("row"), nb::arg("inside"), nb::arg("x_n"),
          nb::arg("x"), nb::arg("facets"), nb::arg("x_facets"),
          nb::arg("numbers"),
          "(n, 3), (n, 3), (n,), (n,), (l, 3), (l, 3), NodeFacets, (f, 3), "
          "(n,) -> entered, leaves, begin, length, cosine, gap, each (n,), see "
          "nts/search/trajectory.h")
      .def(
          "pair_own", &SegmentsAndTrees::pair_own, nb::arg("x_node"),
          nb::arg("current"), nb::arg("slack"), nb::arg("reach"), nb::arg("x"),
          nb::arg("normal"), nb::arg("X_node"), nb::arg("N_node"), nb::arg("X"),
          nb::arg("thickness"),
          "(n, 3), (n,), -, -, (l, 3), (n, 3), (n, 3), (n, 3), (l, 3), (s,) -> "
          "as pair for nodes of the surface itself, see "
          "nts/search/self_contact.h")
      .def(
          "near", &SegmentsAndTrees::near, nb::arg("x_node"), nb::arg("reach"),
          nb::arg("x"), nb::arg("group") = nb::none(),
          "(n, 3), -, (l, 3), (n,) -> numbers of the nodes within reach of the "
          "box of a segment of their group (m,)")
      .def("hold_in_dents", &SegmentsAndTrees::hold_in_dents, nb::arg("held"),
           "Set whether nodes below dents keep a segment.")
      .def("sink", &SegmentsAndTrees::sink, nb::arg("depth"),
           "(g,) depth of nodes that started inside each group")
      .def_prop_ro("num_trees", &SegmentsAndTrees::num_trees,
                   "How often a tree was built");
  m.def("farthest", &farthest_point, nb::arg("x"), nb::arg("before"),
        "(n, 3), (n, 3) -> largest distance between rows, NaN if one is");
  m.def("lost", &lost_nodes, nb::arg("before"), nb::arg("after"),
        "(n,), (n,) segments of nodes or -1 -> numbers of the nodes that have "
        "one before, and none after (m,)");
}
} // namespace nts::bindings
