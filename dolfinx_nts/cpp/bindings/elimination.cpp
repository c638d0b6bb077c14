#include "elimination.h"
#include "nts/solvers/contact_changes.h"

#include <bit>
#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
void close_gaps_batch(const In<std::int32_t>& nodes, const In<bool>& moves,
                      const Doubles& gap, const Doubles& normal,
                      const Doubles& gradients, const Doubles& farthest,
                      Out<double> x)
{
  const std::size_t m = nodes.size();
  check("nodes", nodes, {m});
  check("moves", moves, {m});
  check("gap", gap, {m});
  check("farthest", farthest, {m});
  check("x", x, {any, any});
  const std::size_t components = x.shape(1);
  check("normal", normal, {m, components});
  check("gradients", gradients, {m, any, any});
  check_rows("nodes: expected row numbers of x", nodes, x.shape(0));
  if (gradients.shape(1) == 0 || gradients.shape(2) < components)
    throw nb::value_error(
        "gradients: expected at least the components of one node");
  dispatch_components(components,
                      [&]<std::size_t B>()
                      {
                        close_gaps<B>(view(nodes), view(moves), view(gap),
                                      view(normal), view(gradients),
                                      gradients.shape(1) * gradients.shape(2),
                                      view(farthest), view(x));
                      });
}

/// @brief Largest absolute value, NaN where there is one.
template <class Value>
double largest(std::size_t n, Value&& value) noexcept
{
  // Bit patterns of absolute values are ordered as the values, with NaN last.
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < n; ++i)
    bits = std::max(bits, std::bit_cast<std::uint64_t>(std::abs(value(i))));
  return std::bit_cast<double>(bits);
}

double largest_size(const Doubles& a)
{
  return largest(a.size(), [x = a.data()](std::size_t i) { return x[i]; });
}

double largest_difference(const Doubles& a, const Doubles& b)
{
  if (a.size() != b.size())
    throw nb::value_error("expected two arrays of equal size");
  return largest(a.size(), [x = a.data(), y = b.data()](std::size_t i)
                 { return x[i] - y[i]; });
}

double largest_violation(const Doubles& excess, const In<std::int32_t>& rank)
{
  check("excess", excess, {rank.shape(0), 3});
  return largest(excess.size(),
                 [x = excess.data(), r = rank.data()](std::size_t i)
                 { return static_cast<int>(i % 3) < r[i / 3] ? x[i] : 0.0; });
}

/// @brief Constraints of nodes with B components, as arrays of these sizes.
template <std::size_t B>
ConstraintLists<B>
constraint_lists(const In<std::int64_t>& start, const Doubles& gradients,
                 const Doubles& columns, const Doubles& slopes)
{
  check("start", start, {slopes.shape(0) + 1});
  check("slopes", slopes, {any, B, B});
  const auto begin = view(start);
  if (begin.front() != 0 || !std::ranges::is_sorted(begin))
    throw nb::value_error("start: expected ascending offsets of the lists");
  for (const Doubles* rows : {&gradients, &columns})
    if (rows->size() != B * B * static_cast<std::size_t>(begin.back()))
      throw nb::value_error(
          "gradients and columns: expected a block for each node of the lists");
  return {begin, view(gradients), view(columns), view(slopes)};
}

Out<double> slopes_at_nodes_batch(const In<std::int64_t>& start,
                                  const Doubles& gradients,
                                  const Doubles& columns, const Doubles& slopes)
{
  check("slopes", slopes, {any, any, any});
  const std::size_t m = slopes.shape(0), components = slopes.shape(1);
  auto parts = create<double>({m, components, components});
  dispatch_components(components,
                      [&]<std::size_t B>()
                      {
                        slopes_at_nodes<B>(constraint_lists<B>(start, gradients,
                                                               columns, slopes),
                                           view(parts));
                      });
  return parts;
}

Out<bool> essential_nodes_batch(const In<std::int64_t>& start,
                                const In<std::int32_t>& rank,
                                const Doubles& gradients,
                                const Doubles& columns, const Doubles& slopes,
                                double size, double stiffness)
{
  check("slopes", slopes, {rank.size(), any, any});
  const std::size_t components = slopes.shape(1);
  for (const std::int32_t constraints : view(rank))
    if (constraints < 0 || static_cast<std::size_t>(constraints) > components)
      throw nb::value_error(
          "rank: expected numbers from 0 to the number of components");
  Out<bool> keeps
      = create<bool>({gradients.size() / (components * components)});
  dispatch_components(components,
                      [&]<std::size_t B>()
                      {
                        essential_nodes<B>(constraint_lists<B>(start, gradients,
                                                               columns, slopes),
                                           view(rank), size, stiffness,
                                           view(keeps));
                      });
  return keeps;
}

/// @brief Entries of constraints for selected nodes of their node lists.
auto at_nodes_batch(const In<std::int64_t>& start, const In<bool>& keeps,
                    const Doubles& gradients, const Doubles& columns,
                    std::size_t components)
{
  check("keeps", keeps, {any});
  check("start", start, {any});
  const auto begin = view(start);
  const auto keep = view(keeps);
  if (begin.empty() || begin.front() != 0 || !std::ranges::is_sorted(begin)
      || static_cast<std::size_t>(begin.back()) != keep.size())
    throw nb::value_error("start: expected ascending offsets of the lists");
  const std::size_t B = components, block = B * B;
  if (gradients.size() != block * keep.size()
      || columns.size() != gradients.size())
    throw nb::value_error(
        "gradients and columns: expected a block for each node of the lists");
  const std::size_t kept = std::ranges::count(keep, true);
  auto first = create<std::int64_t>({begin.size()});
  std::array<Out<double>, 2> parts
      = {create<double>({block * kept}), create<double>({block * kept})};
  first.data()[0] = 0;
  for (std::size_t i = 0, place = 0; i + 1 < begin.size(); ++i)
  {
    const auto from = static_cast<std::size_t>(begin[i]);
    const auto list = keep.subspan(from, begin[i + 1] - from);
    for (std::size_t a = 0; a < B; ++a)
      for (std::size_t K = 0; K < list.size(); ++K)
        if (list[K])
        {
          const std::size_t e = block * from + B * (a * list.size() + K);
          std::copy_n(gradients.data() + e, B, parts[0].data() + place);
          std::copy_n(columns.data() + e, B, parts[1].data() + place);
          place += B;
        }
    first.data()[i + 1] = first.data()[i] + std::ranges::count(list, true);
  }
  return std::tuple(first, parts[0], parts[1]);
}

auto large_blocks(const Doubles& blocks, double size)
{
  check("blocks", blocks, {any, any, any});
  const std::size_t p = blocks.shape(0), n = blocks.shape(1) * blocks.shape(2);
  auto flags = create<bool>({p});
  for (std::size_t i = 0; i < p; ++i)
    flags.data()[i]
        = std::ranges::any_of(view(blocks).subspan(n * i, n),
                              [&](double x) { return std::abs(x) > size; });
  return flags;
}

std::size_t num_moved_batch(std::size_t m, const In<bool>& same,
                            const Doubles& now, const Doubles& before,
                            double limit)
{
  if (m == 0 || same.size() % m || now.size() % m
      || now.size() != before.size())
    throw nb::value_error("expected multiples of m as sizes of same and now, "
                          "and before as long as now");
  return num_moved(m, view(same), view(now), view(before), limit);
}
} // namespace

void elimination(nb::module_& m)
{
  nb::class_<BoundElimination>(
      m, "Elimination",
      "Constraints and contact tangent, and the projections on the former, see "
      "nts/solvers/elimination.h; the arrays are read, not copied")
      .def(nb::init<In<std::int64_t>, In<std::int32_t>, In<std::int32_t>,
                    Doubles, Doubles, Doubles, Doubles, In<std::int32_t>,
                    Doubles>(),
           nb::arg("start"), nb::arg("nodes"), nb::arg("rank"),
           nb::arg("normal"), nb::arg("gradients"), nb::arg("columns"),
           nb::arg("slopes"), nb::arg("tangent_nodes"), nb::arg("tangent"),
           "(m + 1,), (l,), (m,) of 0, 1, B, (m, B), B B l numbers, the same, "
           "(m, B, B), (p, k), (p, B k, B k), with B = 2 or 3")
      .def("constrain", &BoundElimination::constrain, nb::arg("values"),
           nb::arg("x").noconvert(), nb::arg("ghosts").noconvert(),
           "x <- Z x + E (G^T E)^-1 values: (m, B) or (0,); x at the owned "
           "nodes (n, B), and at ghosts (g, B)")
      .def("act", &BoundElimination::act, nb::arg("x"), nb::arg("x_ghosts"),
           nb::arg("y").noconvert(), nb::arg("y_ghosts").noconvert(),
           "y <- Z~^T (y + C x): (n, B), (g, B), (n, B), (g, B); the "
           "multipliers of the forces that this removes, (m, B)")
      .def("missing", &BoundElimination::missing, nb::arg("values"),
           nb::arg("x"), nb::arg("ghosts"),
           "values - G^T x: (m, B) or (0,), (n, B), (g, B) -> (m, B), 0 where "
           "there is no constraint")
      .def("remove", &BoundElimination::remove, nb::arg("multipliers"),
           nb::arg("y").noconvert(), nb::arg("ghosts").noconvert(),
           "y <- y - F lambda: (m, B), (n, B), (g, B)")
      .def("add_tangent", &BoundElimination::add_tangent, nb::arg("x"),
           nb::arg("x_ghosts"), nb::arg("y").noconvert(),
           nb::arg("y_ghosts").noconvert(),
           "y <- y + C x: (n, B), (g, B), (n, B), (g, B)");
  m.def("largest_size", &largest_size, nb::arg("a"),
        "Largest absolute value, NaN where there is one, 0 of none");
  m.def("largest_difference", &largest_difference, nb::arg("a"), nb::arg("b"),
        "Largest absolute difference of the values of two arrays of one size, "
        "NaN where there is one");
  m.def("largest_violation", &largest_violation, nb::arg("excess"),
        nb::arg("rank"),
        "(m, 3), (m,) -> largest absolute value of the first rank columns, NaN "
        "where there is one");
  m.def("slopes_at_nodes", &slopes_at_nodes_batch, nb::arg("start"),
        nb::arg("gradients"), nb::arg("columns"), nb::arg("slopes"),
        "(m + 1,), B B l numbers, the same, (m, B, B) -> F^T S G at the "
        "constrained nodes, (m, B, B)");
  m.def("essential_nodes", &essential_nodes_batch, nb::arg("start"),
        nb::arg("rank"), nb::arg("gradients"), nb::arg("columns"),
        nb::arg("slopes"), nb::arg("size"), nb::arg("stiffness"),
        "(m + 1,), (m,), B B l numbers, the same, (m, B, B), -, - -> whether "
        "nodes of lists have a part above a size, or with slopes above a "
        "stiffness, or are constrained, (l,)");
  m.def("at_nodes", &at_nodes_batch, nb::arg("start"), nb::arg("keeps"),
        nb::arg("gradients"), nb::arg("columns"), nb::arg("components"),
        "(m + 1,), (l,) which nodes of lists are kept, B B l numbers, the "
        "same, B -> the lists of these nodes (m + 1,), B B l' numbers, the "
        "same");
  m.def("large_blocks", &large_blocks, nb::arg("blocks"), nb::arg("size"),
        "(p, n, n), - -> whether blocks have an entry above a size (p,)");
  m.def("num_moved", &num_moved_batch, nb::arg("m"), nb::arg("same"),
        nb::arg("now"), nb::arg("before"), nb::arg("limit"),
        "-, (l,) whether nodes are those of before, gradients, the same -> "
        "number of m constraints of which a node is another or an entry "
        "differs by more than a limit");
  m.def("close_gaps", &close_gaps_batch, nb::arg("nodes"), nb::arg("moves"),
        nb::arg("gap"), nb::arg("normal"), nb::arg("gradients"),
        nb::arg("farthest"), nb::arg("x").noconvert(),
        "Move nodes along their normals to zero gap, unless that is farther: "
        "(m,), (m,), (m,), (m, B), (m, c, d) of which [:, 0, :B] count, (m,), "
        "(n, B), B = 2 or 3");
}
} // namespace nts::bindings
