#include "array.h"
#include "nts/batch.h"

#include <nanobind/stl/tuple.h>

#include <array>

namespace nts::bindings
{
namespace
{
/// @brief Number of pairs and of vertices of a segment, after a check that the
/// shapes agree.
std::array<std::size_t, 2> pairs_and_vertices(const Doubles& x_pair_n,
                                              const Doubles& x_pair,
                                              const Doubles& orientation)
{
  const std::size_t k = segment_vertices("x_pair", x_pair);
  const std::size_t m = x_pair.shape(0);
  check("x_pair_n", x_pair_n, {m, 1 + k, 3});
  check("orientation", orientation, {m});
  return {m, k};
}

template <Scheme scheme>
auto contact_batch(const Doubles& x_pair_n, const Doubles& x_pair,
                   const Doubles& orientation)
{
  const auto [m, k] = pairs_and_vertices(x_pair_n, x_pair, orientation);
  const std::size_t n = 3 * (1 + k);
  auto gap_n = create<double>({m});
  auto gap = create<double>({m});
  auto force = create<double>({m, n});
  auto gradient = create<double>({m, n});
  auto tangent = create<double>({m, n, n});
  auto turn = create<double>({m});
  auto status = create<std::int8_t>({m});
  const ContactArrays out{view(gap_n),    view(gap),     view(force),
                          view(gradient), view(tangent), view(turn),
                          view(status)};
  dispatch(k,
           [&]<class S>()
           {
             const nb::gil_scoped_release release;
             nts::contact<S, scheme>(view(x_pair_n), view(x_pair),
                                     view(orientation), out);
           });
  return std::tuple(gap_n, gap, force, gradient, tangent, turn, status);
}

auto slip_batch(const Doubles& x_pair_n, const Doubles& x_pair,
                const Doubles& orientation)
{
  const auto [m, k] = pairs_and_vertices(x_pair_n, x_pair, orientation);
  const std::size_t n = 3 * (1 + k);
  auto value = create<double>({m, 2});
  auto force = create<double>({m, 2, n});
  auto gradient = create<double>({m, 2, n});
  auto w = create<double>({m, 1 + k});
  auto b = create<double>({m, 2, 1 + k});
  auto frame_n = create<double>({m, 2, 3});
  auto frame = create<double>({m, 2, 3});
  const SlipArrays out{view(value), view(force),   view(gradient), view(w),
                       view(b),     view(frame_n), view(frame)};
  dispatch(k,
           [&]<class S>()
           {
             const nb::gil_scoped_release release;
             slips<S>(view(x_pair_n), view(x_pair), view(orientation), out);
           });
  return std::tuple(value, force, gradient, w, b, frame_n, frame);
}

auto convective_slip_batch(const Doubles& x_pair_n, const Doubles& x_pair,
                           const Doubles& orientation)
{
  const auto [m, k] = pairs_and_vertices(x_pair_n, x_pair, orientation);
  const std::size_t n = 3 * (1 + k);
  auto value = create<double>({m, 2});
  auto force = create<double>({m, 2, n});
  auto gradient = create<double>({m, 2, n});
  auto hessian = create<double>({m, 2, n, n});
  auto frame_n = create<double>({m, 2, 3});
  auto frame = create<double>({m, 2, 3});
  const ConvectiveSlipArrays out{view(value),   view(force),   view(gradient),
                                 view(hessian), view(frame_n), view(frame)};
  dispatch(k,
           [&]<class S>()
           {
             const nb::gil_scoped_release release;
             convective_slips<S>(view(x_pair_n), view(x_pair),
                                 view(orientation), out);
           });
  return std::tuple(value, force, gradient, hessian, frame_n, frame);
}

/// @brief Pairing of nodes that may touch what `MayTouch` says.
template <class GetMayTouch>
auto pair_with(const Doubles& x_node, const In<std::int32_t>& current,
               double reach, const Doubles& x_segment,
               const Doubles& orientation, const In<std::int64_t>& key,
               const GetMayTouch& get_may_touch)
{
  check("x_node", x_node, {any, 3});
  check("x_segment", x_segment, {any, any, 3});
  const std::size_t n = x_node.shape(0), segments = x_segment.shape(0);
  check("current", current, {n});
  check("orientation", orientation, {segments});
  check("key", key, {segments});
  for (const std::int32_t c : view(current))
    if (c < -1 || c >= static_cast<std::int32_t>(segments))
      throw nb::value_error("current: expected -1 or a segment index");
  auto segment = create<std::int32_t>({n});
  auto xi = create<double>({n, 2});
  auto gap = create<double>({n});
  auto normal = create<double>({n, 3});
  dispatch(x_segment.shape(1),
           [&]<class S>()
           {
             const nb::gil_scoped_release release;
             pair_nodes<S>(view(x_node), view(current), reach,
                           {view(x_segment), view(orientation), view(key), {}},
                           get_may_touch.template operator()<S>(),
                           view(segment), view(xi), view(gap), view(normal));
           });
  return std::tuple(segment, xi, gap, normal);
}

auto pair_nodes_batch(const Doubles& x_node, const In<std::int32_t>& current,
                      double reach, const Doubles& x_segment,
                      const Doubles& orientation, const In<std::int64_t>& key)
{
  return pair_with(x_node, current, reach, x_segment, orientation, key,
                   []<class S>() { return any_segment; });
}

auto pair_own_nodes_batch(const Doubles& x_node,
                          const In<std::int32_t>& current, double reach,
                          const Doubles& x_segment, const Doubles& orientation,
                          const In<std::int64_t>& key, const Doubles& normal,
                          const Doubles& X_node, const Doubles& N_node,
                          const Doubles& X_segment, const Doubles& thickness)
{
  check("x_node", x_node, {any, 3});
  check("x_segment", x_segment, {any, any, 3});
  const std::size_t n = x_node.shape(0), segments = x_segment.shape(0);
  check("normal", normal, {n, 3});
  check("X_node", X_node, {n, 3});
  check("N_node", N_node, {n, 3});
  check("X_segment", X_segment, {segments, x_segment.shape(1), 3});
  check("thickness", thickness, {segments});
  return pair_with(x_node, current, reach, x_segment, orientation, key,
                   [&]<class S>()
                   {
                     const SegmentSurface<S> rest{
                         view(X_segment), view(orientation), view(key), {}};
                     const OwnSurface<S> own{view(normal), view(X_node),
                                             view(N_node), rest,
                                             view(thickness)};
                     return [own](std::size_t i) noexcept { return own.of(i); };
                   });
}
} // namespace

void contact(nb::module_& m)
{
  constexpr const char* doc
      = "(m, 1+k, 3), (m, 1+k, 3), (m,) -> gap_n (m,), gap (m,), force and "
        "gradient (m, 3(1+k)), tangent (m, 3(1+k), 3(1+k)), turn (m,), status "
        "(m,): 0 valid, 1 not (NaN)";
  m.def("contact_midpoint", &contact_batch<Scheme::midpoint>,
        nb::arg("x_pair_n"), nb::arg("x_pair"), nb::arg("orientation"), doc);
  m.def("contact_conserving", &contact_batch<Scheme::conserving>,
        nb::arg("x_pair_n"), nb::arg("x_pair"), nb::arg("orientation"), doc);
  m.def("contact_static", &contact_batch<Scheme::statics>, nb::arg("x_pair_n"),
        nb::arg("x_pair"), nb::arg("orientation"), doc);
  m.def("slip", &slip_batch, nb::arg("x_pair_n"), nb::arg("x_pair"),
        nb::arg("orientation"),
        "(m, 1+k, 3), (m, 1+k, 3), (m,) -> value (m, 2), force and gradient "
        "(m, 2, 3(1+k)), w (m, 1+k), b (m, 2, 1+k), frame_n and frame "
        "(m, 2, 3)");
  m.def("convective_slip", &convective_slip_batch, nb::arg("x_pair_n"),
        nb::arg("x_pair"), nb::arg("orientation"),
        "(m, 1+k, 3), (m, 1+k, 3), (m,) -> value (m, 2), force and gradient "
        "(m, 2, 3(1+k)), hessian (m, 2, 3(1+k), 3(1+k)), frame_n and frame "
        "(m, 2, 3)");
  // Depth, of a segment, at which a node has none any more.
  m.attr("DEEPEST") = PairingRule::depth;
  m.def("pair_nodes", &pair_nodes_batch, nb::arg("x_node"), nb::arg("current"),
        nb::arg("reach"), nb::arg("x_segment"), nb::arg("orientation"),
        nb::arg("key"),
        "(n, 3), (n,), -, (s, k, 3), (s,), (s,) -> segment (n,) or -1, xi "
        "(n, 2), gap (n,), normal (n, 3)");
  m.def("pair_own_nodes", &pair_own_nodes_batch, nb::arg("x_node"),
        nb::arg("current"), nb::arg("reach"), nb::arg("x_segment"),
        nb::arg("orientation"), nb::arg("key"), nb::arg("normal"),
        nb::arg("X_node"), nb::arg("N_node"), nb::arg("X_segment"),
        nb::arg("thickness"),
        "as pair_nodes and (n, 3), (n, 3), (n, 3), (s, k, 3), (s,) -> the same "
        "for nodes of the surface itself");
}
} // namespace nts::bindings
