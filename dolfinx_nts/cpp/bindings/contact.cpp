#include "array.h"
#include "nts/contact/batch.h"
#include "nts/contact/patch_gradient.h"

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

template <class Kind, Scheme scheme>
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
  const ContactArrays out{view(gap_n),    view(gap),     view(force),
                          view(gradient), view(tangent), view(turn)};
  Kind::dispatch(k,
                 [&]<class S>()
                 {
                   const nb::gil_scoped_release release;
                   nts::contact<S, scheme>(view(x_pair_n), view(x_pair),
                                           view(orientation), out);
                 });
  return std::tuple(gap_n, gap, force, gradient, tangent, turn);
}

template <class Kind>
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
  Kind::dispatch(k,
                 [&]<class S>()
                 {
                   const nb::gil_scoped_release release;
                   slips<S>(view(x_pair_n), view(x_pair), view(orientation),
                            out);
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
} // namespace

void contact(nb::module_& m)
{
  constexpr const char* doc
      = "(m, 1+k, 3), (m, 1+k, 3), (m,) -> gap_n (m,), gap (m,), force and "
        "gradient (m, 3(1+k)), tangent (m, 3(1+k), 3(1+k)), turn (m,), all NaN "
        "where a pair cannot be evaluated";
  const auto schemes = [&]<class Kind>(const std::string& kind)
  {
    const auto add = [&](const char* scheme, auto* batch)
    {
      m.def((kind + scheme).c_str(), batch, nb::arg("x_pair_n"),
            nb::arg("x_pair"), nb::arg("orientation"), doc);
    };
    add("_midpoint", &contact_batch<Kind, Scheme::midpoint>);
    add("_conserving", &contact_batch<Kind, Scheme::conserving>);
    add("_static", &contact_batch<Kind, Scheme::statics>);
  };
  schemes.operator()<FlatSegments>("contact");
  schemes.operator()<Patches>("patch");
  constexpr const char* slip_doc
      = "(m, 1+k, 3), (m, 1+k, 3), (m,) -> value (m, 2), force and gradient "
        "(m, 2, 3(1+k)), w (m, 1+k), b (m, 2, 1+k), frame_n and frame "
        "(m, 2, 3)";
  m.def("slip", &slip_batch<FlatSegments>, nb::arg("x_pair_n"),
        nb::arg("x_pair"), nb::arg("orientation"), slip_doc);
  m.def("patch_slip", &slip_batch<Patches>, nb::arg("x_pair_n"),
        nb::arg("x_pair"), nb::arg("orientation"), slip_doc);
  m.def("convective_slip", &convective_slip_batch, nb::arg("x_pair_n"),
        nb::arg("x_pair"), nb::arg("orientation"),
        "(m, 1+k, 3), (m, 1+k, 3), (m,) -> value (m, 2), force and gradient "
        "(m, 2, 3(1+k)), hessian (m, 2, 3(1+k), 3(1+k)), frame_n and frame "
        "(m, 2, 3)");
}
} // namespace nts::bindings
