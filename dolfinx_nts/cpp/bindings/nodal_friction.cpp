#include "nts/contact/nodal_friction.h"
#include "array.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
using Flags = In<bool>;
using Nodes = In<std::int32_t>;

/// @brief `nts::NodalFriction` with arrays that are shared with Python.
class NodalFriction
{
public:
  NodalFriction(bool has_springs, Flags on_axis, Doubles rounding,
                Out<bool> sliding, Out<std::int32_t> flips,
                Out<double> traction, Out<double> fixed, Out<double> direction,
                Out<double> stiffness, Out<double> heading, Doubles present,
                Out<double> modelled, Out<double> frame)
      : _n(on_axis.size()), _friction{has_springs,
                                      keep("on_axis", on_axis, {_n}),
                                      keep("rounding", rounding, {_n}),
                                      keep("sliding", sliding, {_n}),
                                      keep("flips", flips, {_n}),
                                      keep("traction", traction, {_n, 2}),
                                      keep("explicit", fixed, {_n, 2}),
                                      keep("direction", direction, {_n, 2}),
                                      keep("stiffness", stiffness, {_n, 2, 2}),
                                      keep("heading", heading, {_n, 2}),
                                      keep("present", present, {_n, 2}),
                                      keep("modelled", modelled, {_n, 2}),
                                      keep("frame", frame, {_n, 2, 3})}
  {
  }

  void turn(const Nodes& node, const Doubles& frame)
  {
    check_nodes(node);
    check("frame", frame, {node.size(), 2, 3});
    for (std::size_t i = 0; i < node.size(); ++i)
      _friction.turn(row(node, i), frame.data() + 6 * i);
  }

  auto sticks(const Nodes& node, const Flags& active) const
  {
    const std::size_t m = check_pairs(node, active);
    auto flags = create<bool>({m});
    for (std::size_t i = 0; i < m; ++i)
      flags.data()[i] = _friction.is_held(row(node, i), active.data()[i]);
    return flags;
  }

  auto judge(const Nodes& node, const Flags& is_new, const Doubles& limit,
             const Doubles& trial, const Doubles& motion) const
  {
    const std::size_t m = check_pairs(node, is_new);
    check("limit", limit, {m});
    check("trial", trial, {m, 2});
    check("motion", motion, {m, 2});
    auto heading = create<double>({m, 2});
    auto sliding = create<bool>({m});
    for (std::size_t i = 0; i < m; ++i)
    {
      const auto [slides, along]
          = _friction.judge(row(node, i), is_new.data()[i], limit.data()[i],
                            vector2(view(trial), i), vector2(view(motion), i));
      sliding.data()[i] = slides;
      store(along, view(heading), i);
    }
    return std::tuple(heading, sliding);
  }

  void accept(const Nodes& node, const Flags& active, const Flags& sliding,
              const Doubles& p, const Doubles& slip, const Doubles& fixed,
              const Doubles& direction, const Doubles& stiffness,
              const std::optional<Flags>& lags, const Doubles& limiting)
  {
    const std::size_t m = check_pairs(node, active);
    check("sliding", sliding, {m});
    check("p", p, {m});
    check("slip", slip, {m, 2});
    check("explicit", fixed, {m, 2});
    check("direction", direction, {m, 2});
    check("stiffness", stiffness, {m, 2, 2});
    if (lags)
      check("lags", *lags, {m});
    check("limiting", limiting, {m});
    for (std::size_t i = 0; i < m; ++i)
    {
      const std::span<const double> K = view(stiffness);
      const TractionModel model = {vector2(view(fixed), i),
                                   vector2(view(direction), i),
                                   {vector2(K, 2 * i), vector2(K, 2 * i + 1)}};
      std::optional<double> lagging;
      if (lags && lags->data()[i])
        lagging = limiting.data()[i];
      _friction.accept(row(node, i), active.data()[i], sliding.data()[i],
                       p.data()[i], vector2(view(slip), i), model, lagging);
    }
  }

  auto known(const Nodes& node, const Flags& active, const Flags& not_own,
             std::int32_t dim) const
  {
    const std::size_t m = check_pairs(node, active);
    check("not_own", not_own, {m});
    auto rank = create<std::int32_t>({m});
    auto known = create<double>({m, 2}), direction = create<double>({m, 2});
    for (std::size_t i = 0; i < m; ++i)
    {
      const std::size_t j = row(node, i);
      const bool holds = active.data()[i] && !not_own.data()[i];
      const bool is_held = _friction.is_held(j, holds);
      rank.data()[i] = is_held ? dim : holds;
      store(_friction.known(j, is_held), view(known), i);
      store(vector2(_friction.direction, j), view(direction), i);
    }
    return std::tuple(rank, known, direction);
  }

  void balance(const Nodes& node, const Flags& active, const Nodes& rank,
               const Doubles& multipliers, const Doubles& known)
  {
    const std::size_t m = check_pairs(node, active);
    check("rank", rank, {m});
    check("multipliers", multipliers, {m, 3});
    check("known", known, {m, 2});
    for (std::size_t i = 0; i < m; ++i)
      _friction.balance(row(node, i), active.data()[i], rank.data()[i],
                        vector(view(multipliers), i), vector2(view(known), i));
  }

  auto add_to(const Nodes& node, const Flags& active, const Doubles& rows,
              const Doubles& columns, const Out<double>& force) const
  {
    const std::size_t m = check_pairs(node, active);
    check("rows", rows, {m, 3, any});
    const std::size_t d = rows.shape(2);
    check("columns", columns, {m, 3, d});
    check("force", force, {m, d});
    auto mixed = create<double>({m, 3, d}), slopes = create<double>({m, 3, 3});
    std::copy_n(columns.data(), columns.size(), mixed.data());
    std::fill_n(slopes.data(), slopes.size(), 0.);
    for (std::size_t i = 0; i < m; ++i)
    {
      const std::size_t j = row(node, i);
      add_tangential(vector2(_friction.traction, j),
                     view(rows).subspan(3 * d * i, 3 * d),
                     view(force).subspan(d * i, d));
      if (!active.data()[i] || _friction.is_held(j, true))
        continue;
      add_tangential(-1. * vector2(_friction.direction, j),
                     view(columns).subspan(3 * d * i, 3 * d),
                     view(mixed).subspan(3 * d * i, d));
      const Matrix<2, 2> K = _friction.stiffness_of(j);
      for (std::size_t a = 0; a < 2; ++a)
        std::ranges::copy(K[a], slopes.data() + 9 * i + 3 * a + 4);
    }
    return std::tuple(mixed, slopes);
  }

private:
  /// @brief Check an array and keep it alive.
  template <class T>
  std::span<T> keep(const char* name, const Array<T>& array,
                    std::initializer_list<std::size_t> shape)
  {
    check(name, array, shape);
    _arrays.push_back(nb::borrow(array.object()));
    return view(array);
  }

  static std::size_t row(const Nodes& node, std::size_t i) noexcept
  {
    return static_cast<std::size_t>(node.data()[i]);
  }

  void check_nodes(const Nodes& node) const
  {
    check("node", node, {any});
    check_rows("node: expected row numbers of the other arrays", node, _n);
  }

  std::size_t check_pairs(const Nodes& node, const Flags& active) const
  {
    check_nodes(node);
    check("active", active, {node.size()});
    return node.size();
  }

  std::vector<nb::object> _arrays;
  std::size_t _n;
  nts::NodalFriction _friction;
};
} // namespace

void nodal_friction(nb::module_& m)
{
  nb::class_<NodalFriction>(
      m, "NodalFriction",
      "Friction of n nodes; the arrays are shared, not "
      "copied. Of m pairs node (m,) are the nodes, and active "
      "(m,) tells which transmit force")
      .def(nb::init<bool, Flags, Doubles, Out<bool>, Out<std::int32_t>,
                    Out<double>, Out<double>, Out<double>, Out<double>,
                    Out<double>, Doubles, Out<double>, Out<double>>(),
           nb::arg("has_springs"), nb::arg("on_axis"), nb::arg("rounding"),
           nb::arg("sliding").noconvert(), nb::arg("flips").noconvert(),
           nb::arg("traction").noconvert(), nb::arg("explicit").noconvert(),
           nb::arg("direction").noconvert(), nb::arg("stiffness").noconvert(),
           nb::arg("heading").noconvert(), nb::arg("present").noconvert(),
           nb::arg("modelled").noconvert(), nb::arg("frame").noconvert(),
           "-, (n,) nodes without friction, (n,) forces that are round-off, "
           "(n,), (n,), (n, 2), and the model explicit + p direction + "
           "stiffness (present - modelled): (n, 2), (n, 2), (n, 2, 2); "
           "direction also where a limit lags, slips now and where it was "
           "made (n, 2); tangents of all these components, 0 of none (n, 2, 3)")
      .def("turn", &NodalFriction::turn, nb::arg("node"), nb::arg("frame"),
           "(m, 2, 3): what is known becomes that in these tangents")
      .def("sticks", &NodalFriction::sticks, nb::arg("node"), nb::arg("active"),
           "-> whether multipliers hold pairs in the tangent plane (m,)")
      .def("judge", &NodalFriction::judge, nb::arg("node"), nb::arg("is_new"),
           nb::arg("limit"), nb::arg("trial"), nb::arg("motion"),
           "(m,), largest tractions (m,), (m, 2), (m, 2) -> directions of the "
           "tractions (m, 2), and whether nodes should slide (m,)")
      .def("accept", &NodalFriction::accept, nb::arg("node"), nb::arg("active"),
           nb::arg("sliding"), nb::arg("p"), nb::arg("slip"),
           nb::arg("explicit"), nb::arg("direction"), nb::arg("stiffness"),
           nb::arg("lags").none(), nb::arg("limiting"),
           "(m,), (m,), (m, 2) and a model (m, 2), (m, 2), (m, 2, 2), whose "
           "limit lags (m,), (m,): take over states, models and tractions of "
           "what slides or has springs")
      .def("known", &NodalFriction::known, nb::arg("node"), nb::arg("active"),
           nb::arg("not_own"), nb::arg("dim"),
           "(m,) whose displacement is not their own, - -> number of "
           "multipliers (m,), tractions that do not scale with the pressing "
           "force, 0 of what they hold (m, 2), and directions (m, 2)")
      .def("balance", &NodalFriction::balance, nb::arg("node"),
           nb::arg("active"), nb::arg("rank"), nb::arg("multipliers"),
           nb::arg("known"),
           "(m,), (m, 3), (m, 2): take over the tractions that go with "
           "multipliers")
      .def("add_to", &NodalFriction::add_to, nb::arg("node"), nb::arg("active"),
           nb::arg("rows"), nb::arg("columns"), nb::arg("force").noconvert(),
           "force (m, d) <- force + traction rows[:, 1:] of (m, 3, d); (m, 3, "
           "d) -> columns, the first less those of the tangents times the "
           "direction of what slides (m, 3, d), and slopes (m, 3, 3)");
}
} // namespace nts::bindings
