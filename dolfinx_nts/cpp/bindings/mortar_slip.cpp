#include "nts/contact/mortar_slip.h"
#include "array.h"
#include "nts/contact/batch.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;
using Keys = In<std::int64_t>;

/// @brief Raise ValueError unless the shares of nodes in p points are complete.
void check_shares(const Keys& start, const Ints& point, std::size_t p)
{
  check("start", start, {any});
  check("point", point, {any});
  check_rows("point: expected numbers of points", point, p);
  const auto begin = view(start);
  if (begin.empty() || begin.front() != 0
      || begin.back() != static_cast<std::int64_t>(point.size())
      || !std::ranges::is_sorted(begin))
    throw nb::value_error(
        "start: expected ascending offsets, from 0 to the number of shares");
}

TurnedShares turned(const Keys& start, const Ints& point, const Doubles& part,
                    std::size_t p)
{
  check_shares(start, point, p);
  check("part", part, {point.size(), 2, 2});
  return {view(start), view(point), view(part)};
}

auto turn_shares_batch(const Keys& start, const Ints& point,
                       const Doubles& value, const Doubles& of_nodes,
                       const Doubles& of_points)
{
  check("of_points", of_points, {any, 2, 3});
  check_shares(start, point, of_points.shape(0));
  check("value", value, {point.size()});
  check("of_nodes", of_nodes, {start.size() - 1, 2, 3});
  auto parts = create<double>({point.size(), 2, 2});
  turn_shares(view(start), view(point), view(value), view(of_nodes),
              view(of_points), view(parts));
  return parts;
}

auto sum_slip_batch(const Keys& start, const Ints& point, const Doubles& part,
                    const Doubles& slip, const Doubles& frame)
{
  check("slip", slip, {any, 2});
  check("frame", frame, {slip.shape(0), 2, 3});
  const TurnedShares shares = turned(start, point, part, slip.shape(0));
  const std::size_t n = start.size() - 1;
  auto slips = create<double>({n, 2}), frames = create<double>({n, 2, 3});
  for (std::size_t i = 0; i < n; ++i)
  {
    const auto [mean, tangents] = sum_slip(shares, i, view(slip), view(frame));
    store(mean, view(slips), i);
    store(tangents, view(frames), i);
  }
  return std::tuple(slips, frames);
}

auto spread_tractions_batch(const Keys& start, const Ints& point,
                            const Doubles& part, const Doubles& traction,
                            std::size_t p)
{
  const TurnedShares shares = turned(start, point, part, p);
  check("traction", traction, {start.size() - 1, 2});
  auto of_points = create<double>({p, 2});
  std::fill_n(of_points.data(), of_points.size(), 0.0);
  spread_tractions(shares, view(traction), view(of_points));
  return of_points;
}

auto sum_slip_blocks_batch(const Doubles& phi, const Ints& block,
                           std::size_t count, const Doubles& w,
                           const Doubles& b, const Doubles& traction)
{
  check("phi", phi, {any, any});
  check("w", w, {phi.shape(0), any});
  const std::size_t p = phi.shape(0), k = phi.shape(1), n = w.shape(1);
  if (n == 0)
    throw nb::value_error(
        "w: expected at least one column, for the weight of the point");
  check("b", b, {p, 2, n});
  check("block", block, {p});
  check_rows("block: expected numbers of blocks", block, count);
  check("traction", traction, {p, 2});
  const std::size_t size = 3 * (k + n - 1);
  auto blocks = create<double>({count, size, size});
  std::fill_n(blocks.data(), blocks.size(), 0.0);
  sum_slip_blocks(view(phi), k, n - 1, view(block), view(w), view(b),
                  view(traction), view(blocks));
  return blocks;
}
} // namespace

void mortar_slip(nb::module_& m)
{
  m.def("turn_shares", &turn_shares_batch, nb::arg("start"), nb::arg("point"),
        nb::arg("value"), nb::arg("of_nodes"), nb::arg("of_points"),
        "(n + 1,), (i,), (i,), frames (n, 2, 3), (p, 2, 3) -> (i, 2, 2), see "
        "nts/contact/mortar_slip.h");
  m.def("sum_slip", &sum_slip_batch, nb::arg("start"), nb::arg("point"),
        nb::arg("part"), nb::arg("slip"), nb::arg("frame"),
        "(n + 1,), (i,), (i, 2, 2), (p, 2), (p, 2, 3) -> slips (n, 2), "
        "orthonormal frames (n, 2, 3)");
  m.def("spread_tractions", &spread_tractions_batch, nb::arg("start"),
        nb::arg("point"), nb::arg("part"), nb::arg("traction"), nb::arg("p"),
        "(n + 1,), (i,), (i, 2, 2), (n, 2), number of points -> (p, 2)");
  m.def("sum_slip_blocks", &sum_slip_blocks_batch, nb::arg("phi"),
        nb::arg("block"), nb::arg("count"), nb::arg("w"), nb::arg("b"),
        nb::arg("traction"),
        "(p, k), (p,), b, (p, 1 + s), (p, 2, 1 + s), (p, 2) -> second "
        "derivatives of t . slip (b, 3 (k + s), 3 (k + s))");
}
} // namespace nts::bindings
