#include "array.h"
#include "nts/contact/batch.h"
#include "nts/contact/friction.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
using Flags = In<bool>;
using Nodes = In<std::int32_t>;

/// @brief Friction of n nodes in one attempt at a step, by arrays that are not
/// copied: what it is, and its linear model in the last iteration.
class Tractions
{
public:
  /// @param[in] present, modelled Slips now and where the model was made.
  /// @param[in] heading Direction of the model also where a limit lags.
  /// @param[in] frame Tangents of what has two components, 0 where none is.
  Tractions(double mu, bool has_springs, Flags on_axis, Doubles rounding,
            Out<bool> sliding, Out<std::int32_t> flips, Out<double> traction,
            Out<double> fixed, Out<double> direction, Out<double> stiffness,
            Out<double> heading, Doubles present, Out<double> modelled,
            Out<double> frame)
      : _mu(mu), _has_springs(has_springs), _on_axis(std::move(on_axis)),
        _rounding(std::move(rounding)), _sliding(std::move(sliding)),
        _flips(std::move(flips)), _traction(std::move(traction)),
        _fixed(std::move(fixed)), _direction(std::move(direction)),
        _stiffness(std::move(stiffness)), _heading(std::move(heading)),
        _present(std::move(present)), _modelled(std::move(modelled)),
        _frame(std::move(frame))
  {
    const std::size_t n = _on_axis.size();
    check("on_axis", _on_axis, {n});
    check("rounding", _rounding, {n});
    check("sliding", _sliding, {n});
    check("flips", _flips, {n});
    check("traction", _traction, {n, 2});
    check("explicit", _fixed, {n, 2});
    check("direction", _direction, {n, 2});
    check("stiffness", _stiffness, {n, 2, 2});
    check("heading", _heading, {n, 2});
    check("present", _present, {n, 2});
    check("modelled", _modelled, {n, 2});
    check("frame", _frame, {n, 2, 3});
  }

  void turn(const Nodes& node, const Doubles& frame)
  {
    const std::size_t m = check_nodes(node);
    check("frame", frame, {m, 2, 3});
    for (std::size_t i = 0; i < m; ++i)
    {
      const std::size_t j = row(node, i);
      const double* to = frame.data() + 6 * i;
      double* from = _frame.data() + 6 * j;
      if (std::equal(to, to + 6, from))
        continue;
      if (std::any_of(from, from + 6, [](double x) { return x != 0; }))
        turn_row(between_frames(to, from), j);
      std::copy_n(to, 6, from);
    }
  }

  auto sticks(const Nodes& node, const Flags& active) const
  {
    const std::size_t m = check_pairs(node, active);
    auto flags = create<bool>({m});
    for (std::size_t i = 0; i < m; ++i)
      flags.data()[i] = is_held(row(node, i), active.data()[i]);
    return flags;
  }

  auto judge(const Nodes& node, const Flags& active, const Doubles& p,
             const Doubles& limiting, const Doubles& trial,
             const Doubles& way) const
  {
    const std::size_t m = check_pairs(node, active);
    check("p", p, {m});
    check("limiting", limiting, {m});
    check("trial", trial, {m, 2});
    check("way", way, {m, 2});
    auto heading = create<double>({m, 2});
    auto sliding = create<bool>({m});
    for (std::size_t i = 0; i < m; ++i)
    {
      const std::size_t j = row(node, i);
      const bool slid = _sliding.data()[j];
      const Vec2 t = pair(trial, i), s = pair(way, i);
      const double limit = limiting.data()[i];
      // With p < 0, which may pass, a traction points backwards.
      const Vec2 along
          = first_direction(pair(slid ? _heading : _traction, j), s);
      // At the limit, as where loads rest after sliding, round-off must not
      // decide, nor where it is not known yet how much a node presses that has
      // just arrived.
      const bool is_open = is_at_limit(_mu, t, limit, _rounding.data()[j])
                           || (active.data()[i] && p.data()[i] == 0);
      sliding.data()[i]
          = (is_open ? slid : slides(_mu, t, s, limit, along, slid))
            || _on_axis.data()[j];
      store(along, view(heading), i);
    }
    return std::tuple(heading, sliding);
  }

  void model(const Nodes& node, const Flags& active, const Flags& sliding,
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
      const std::size_t j = row(node, i);
      const bool slides = sliding.data()[i];
      Vec2 known = {}, s = {};
      Matrix<2, 2> K = {};
      if (!_on_axis.data()[j])
      {
        known = pair(fixed, i), s = pair(direction, i);
        K = matrix(stiffness, i);
      }
      store(s, view(_heading), j);
      if (lags && lags->data()[i])
      {
        known = known + limiting.data()[i] * s;
        s = {};
      }
      _flips.data()[j] += slides != _sliding.data()[j];
      _sliding.data()[j] = slides;
      store(pair(slip, i), view(_modelled), j);
      store(known, view(_fixed), j);
      store(s, view(_direction), j);
      store(K, view(_stiffness), j);
      if (!active.data()[i])
        store(Vec2{}, view(_traction), j);
      else if (slides || _has_springs)
        store(known + p.data()[i] * s, view(_traction), j);
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
      const bool own = !not_own.data()[i], holds = active.data()[i] && own;
      const bool is_stuck = own && is_held(j, active.data()[i]);
      rank.data()[i] = is_stuck ? dim : holds;
      store(is_stuck ? Vec2{} : model_at(j), view(known), i);
      store(pair(_direction, j), view(direction), i);
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
    {
      const std::size_t j = row(node, i);
      const double* l = multipliers.data() + 3 * i;
      Vec2 t = {};
      if (active.data()[i])
        t = rank.data()[i] > 1 ? Vec2{l[1], l[2]}
                               : pair(known, i) + -l[0] * pair(_direction, j);
      store(t, view(_traction), j);
    }
  }

  auto add_to(const Nodes& node, const Flags& active, const Doubles& rows,
              const Doubles& columns, Out<double> force) const
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
      add_rows(pair(_traction, j), rows.data() + 3 * d * i,
               force.data() + d * i, d);
      if (!active.data()[i] || is_held(j, true))
        continue;
      add_rows(-1. * pair(_direction, j), columns.data() + 3 * d * i,
               mixed.data() + 3 * d * i, d);
      for (std::size_t a = 0; a < 2; ++a)
        std::copy_n(_stiffness.data() + 4 * j + 2 * a, 2,
                    slopes.data() + 9 * i + 3 * a + 4);
    }
    return std::tuple(mixed, slopes);
  }

private:
  static Vec2 pair(const Doubles& x, std::size_t i) noexcept
  {
    return {x.data()[2 * i], x.data()[2 * i + 1]};
  }

  static Matrix<2, 2> matrix(const Doubles& x, std::size_t i) noexcept
  {
    return {pair(x, 2 * i), pair(x, 2 * i + 1)};
  }

  static std::size_t row(const Nodes& node, std::size_t i) noexcept
  {
    return static_cast<std::size_t>(node.data()[i]);
  }

  /// @brief sum += t[0] times the second of three rows + t[1] times the third.
  static void add_rows(const Vec2& t, const double* rows, double* sum,
                       std::size_t d) noexcept
  {
    for (std::size_t e = 0; e < d; ++e)
      sum[e] += t[0] * rows[d + e] + t[1] * rows[2 * d + e];
  }

  std::size_t check_nodes(const Nodes& node) const
  {
    check("node", node, {node.size()});
    check_rows("node: expected rows of the other arrays", node,
               _on_axis.size());
    return node.size();
  }

  std::size_t check_pairs(const Nodes& node, const Flags& active) const
  {
    const std::size_t m = check_nodes(node);
    check("active", active, {m});
    return m;
  }

  /// @brief Take over the components of a node in another frame.
  void turn_row(const Matrix<2, 2>& turn, std::size_t j)
  {
    for (auto* part : {&_traction, &_fixed, &_direction, &_heading, &_modelled})
      store(turn * pair(*part, j), view(*part), j);
    const Matrix<2, 2> K = matrix(_stiffness, j);
    Matrix<2, 2> turned;
    // K turns in its rows and in its columns.
    for (std::size_t a = 0; a < 2; ++a)
      turned[a] = turn
                  * Vec2{turn[a][0] * K[0][0] + turn[a][1] * K[1][0],
                         turn[a][0] * K[0][1] + turn[a][1] * K[1][1]};
    store(turned, view(_stiffness), j);
  }

  /// @brief Whether multipliers hold an active node in the tangent plane.
  bool is_held(std::size_t j, bool active) const noexcept
  {
    return active && !_sliding.data()[j] && !_has_springs;
  }

  /// @brief Traction of a node that does not scale with the pressing force.
  Vec2 model_at(std::size_t j) const noexcept
  {
    Vec2 t = pair(_fixed, j);
    if (_has_springs)
      return t;
    const Vec2 change = pair(_present, j) + -1. * pair(_modelled, j);
    return t + matrix(_stiffness, j) * change;
  }

  double _mu;
  bool _has_springs;
  Flags _on_axis;
  Doubles _rounding;
  Out<bool> _sliding;
  Out<std::int32_t> _flips;
  Out<double> _traction, _fixed, _direction, _stiffness, _heading;
  Doubles _present;
  Out<double> _modelled, _frame;
};
} // namespace

void tractions(nb::module_& m)
{
  nb::class_<Tractions>(
      m, "Tractions",
      "Friction of n nodes; the arrays are shared, not "
      "copied. Of m pairs node (m,) are the nodes, and active "
      "(m,) tells which transmit force")
      .def(nb::init<double, bool, Flags, Doubles, Out<bool>, Out<std::int32_t>,
                    Out<double>, Out<double>, Out<double>, Out<double>,
                    Out<double>, Doubles, Out<double>, Out<double>>(),
           nb::arg("mu"), nb::arg("has_springs"), nb::arg("on_axis"),
           nb::arg("rounding"), nb::arg("sliding").noconvert(),
           nb::arg("flips").noconvert(), nb::arg("traction").noconvert(),
           nb::arg("explicit").noconvert(), nb::arg("direction").noconvert(),
           nb::arg("stiffness").noconvert(), nb::arg("heading").noconvert(),
           nb::arg("present").noconvert(), nb::arg("modelled").noconvert(),
           nb::arg("frame").noconvert(),
           "-, -, (n,) nodes without friction, (n,) forces that are round-off, "
           "(n,), (n,), (n, 2), and the model explicit + p direction + "
           "stiffness (present - modelled): (n, 2), (n, 2), (n, 2, 2); "
           "direction also where a limit lags, slips now and where it was "
           "made (n, 2); tangents of all these components, 0 of none (n, 2, 3)")
      .def("turn", &Tractions::turn, nb::arg("node"), nb::arg("frame"),
           "(m, 2, 3): what is known becomes that in these tangents")
      .def("sticks", &Tractions::sticks, nb::arg("node"), nb::arg("active"),
           "-> whether multipliers hold pairs in the tangent plane (m,)")
      .def("judge", &Tractions::judge, nb::arg("node"), nb::arg("active"),
           nb::arg("p"), nb::arg("limiting"), nb::arg("trial"), nb::arg("way"),
           "pressing forces (m,), those of the limit (m,), (m, 2), (m, 2) -> "
           "directions of the tractions (m, 2), and whether nodes should slide "
           "(m,)")
      .def("model", &Tractions::model, nb::arg("node"), nb::arg("active"),
           nb::arg("sliding"), nb::arg("p"), nb::arg("slip"),
           nb::arg("explicit"), nb::arg("direction"), nb::arg("stiffness"),
           nb::arg("lags").none(), nb::arg("limiting"),
           "(m,), (m,), (m, 2) and a model (m, 2), (m, 2), (m, 2, 2), whose "
           "limit lags (m,), (m,): take over states, models and tractions of "
           "what slides or has springs")
      .def("known", &Tractions::known, nb::arg("node"), nb::arg("active"),
           nb::arg("not_own"), nb::arg("dim"),
           "(m,) whose displacement is not their own, - -> number of "
           "multipliers (m,), tractions that do not scale with the pressing "
           "force, 0 of what they hold (m, 2), and directions (m, 2)")
      .def("balance", &Tractions::balance, nb::arg("node"), nb::arg("active"),
           nb::arg("rank"), nb::arg("multipliers"), nb::arg("known"),
           "(m,), (m, 3), (m, 2): take over the tractions that go with "
           "multipliers")
      .def("add_to", &Tractions::add_to, nb::arg("node"), nb::arg("active"),
           nb::arg("rows"), nb::arg("columns"), nb::arg("force").noconvert(),
           "force (m, d) <- force + traction rows[:, 1:] of (m, 3, d); (m, 3, "
           "d) -> columns, the first less those of the tangents times the "
           "direction of what slides (m, 3, d), and slopes (m, 3, 3)");
}
} // namespace nts::bindings
