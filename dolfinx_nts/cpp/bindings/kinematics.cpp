#include "array.h"
#include "nts/contact/batch.h"
#include "nts/geometry/patch_projection.h"

#include <nanobind/stl/tuple.h>

namespace nts::bindings
{
namespace
{
/// @brief Projection of pair i; NaN where it fails.
template <class S>
Projection<S> project_pair(const Doubles& x_pair, const Doubles& orientation,
                           std::size_t i) noexcept
{
  const Vec3 origin = node_of<S>(view(x_pair), i);
  Projection<S> p
      = project(load<S>(view(x_pair), i, origin), orientation.data()[i]);
  if (!p.converged)
  {
    p.xi = {NAN, NAN};
    p.gap = NAN;
    p.normal = {NAN, NAN, NAN};
  }
  return p;
}

/// @brief Number of segment vertices for a number of invariants.
std::size_t vertices_of(const char* name, const Doubles& invariants)
{
  check(name, invariants, {any, any});
  if (invariants.shape(1) == Invariants<Tri3>::count)
    return 3;
  check(name, invariants, {any, Invariants<Quad4>::count});
  return 4;
}

template <class S>
typename Invariants<S>::Values load_invariants(const Doubles& pi,
                                               std::size_t i) noexcept
{
  typename Invariants<S>::Values values;
  std::copy_n(pi.data() + values.size() * i, values.size(), values.begin());
  return values;
}

template <class Kind>
auto project_batch(const Doubles& x_pair, const Doubles& orientation)
{
  const std::size_t k = segment_vertices("x_pair", x_pair);
  const std::size_t m = x_pair.shape(0);
  check("orientation", orientation, {m});
  auto xi = create<double>({m, 2});
  auto gap = create<double>({m});
  auto normal = create<double>({m, 3});
  auto status = create<std::int8_t>({m});
  Kind::dispatch(k,
                 [&]<class S>()
                 {
                   for (std::size_t i = 0; i < m; ++i)
                   {
                     const Projection<S> p
                         = project_pair<S>(x_pair, orientation, i);
                     store(p.xi, view(xi), i);
                     gap.data()[i] = p.gap;
                     store(p.normal, view(normal), i);
                     status.data()[i] = p.converged ? 0 : 1;
                   }
                 });
  return std::tuple(xi, gap, normal, status);
}

auto patch_functions_batch(const Doubles& xi, std::size_t points)
{
  check("xi", xi, {any, 2});
  const std::size_t m = xi.shape(0);
  auto values = create<double>({m, points});
  Patches::dispatch(points,
                    [&]<class S>()
                    {
                      for (std::size_t i = 0; i < m; ++i)
                        store(S::phi({xi.data()[2 * i], xi.data()[2 * i + 1]}),
                              view(values), i);
                    });
  return values;
}

auto gap_gradient_batch(const Doubles& x_pair, const Doubles& orientation)
{
  const std::size_t k = segment_vertices("x_pair", x_pair);
  const std::size_t m = x_pair.shape(0);
  check("orientation", orientation, {m});
  auto gradient = create<double>({m, 3 * (1 + k)});
  dispatch(k,
           [&]<class S>()
           {
             for (std::size_t i = 0; i < m; ++i)
               store(gap_gradient(project_pair<S>(x_pair, orientation, i)),
                     view(gradient), i);
           });
  return gradient;
}

auto gap_hessian_batch(const Doubles& x_pair, const Doubles& orientation)
{
  const std::size_t k = segment_vertices("x_pair", x_pair);
  const std::size_t m = x_pair.shape(0), n = 3 * (1 + k);
  check("orientation", orientation, {m});
  auto hessian = create<double>({m, n, n});
  std::fill_n(hessian.data(), hessian.size(), NAN);
  dispatch(k,
           [&]<class S>()
           {
             for (std::size_t i = 0; i < m; ++i)
             {
               const Projection<S> p = project_pair<S>(x_pair, orientation, i);
               Sensitivity<S> s;
               if (p.converged && sensitivity(p, s))
                 store(gap_hessian<S>(s), view(hessian), i);
             }
           });
  return hessian;
}

auto invariants_batch(const Doubles& x_pair, const Doubles& normal,
                      const Doubles& xi, const Doubles& slack)
{
  const std::size_t k = segment_vertices("x_pair", x_pair);
  const std::size_t m = x_pair.shape(0);
  check("normal", normal, {m, 3});
  check("xi", xi, {m, 2});
  check("slack", slack, {m});
  return dispatch_facets(
      k,
      [&]<class S>()
      {
        auto pi = create<double>({m, Invariants<S>::count});
        for (std::size_t i = 0; i < m; ++i)
        {
          const double* n = normal.data() + 3 * i;
          const double* c = xi.data() + 2 * i;
          const Vec3 origin = node_of<S>(view(x_pair), i);
          store(invariants(augment(load<S>(view(x_pair), i, origin),
                                   {n[0], n[1], n[2]}, {c[0], c[1]},
                                   slack.data()[i])),
                view(pi), i);
        }
        return pi;
      });
}

auto constraints_batch(const Doubles& invariants)
{
  const std::size_t k = vertices_of("invariants", invariants);
  auto g = create<double>({invariants.shape(0), 6});
  dispatch_facets(k,
                  [&]<class S>()
                  {
                    for (std::size_t i = 0; i < invariants.shape(0); ++i)
                      store(constraints<S>(load_invariants<S>(invariants, i)),
                            view(g), i);
                  });
  return g;
}

auto constraints_gradient_batch(const Doubles& invariants)
{
  const std::size_t k = vertices_of("invariants", invariants);
  auto D = create<double>({invariants.shape(0), 6, invariants.shape(1)});
  dispatch_facets(
      k,
      [&]<class S>()
      {
        for (std::size_t i = 0; i < invariants.shape(0); ++i)
          store(constraints_gradient<S>(load_invariants<S>(invariants, i)),
                view(D), i);
      });
  return D;
}

auto average_gradient_batch(const Doubles& invariants_n,
                            const Doubles& invariants)
{
  const std::size_t k = vertices_of("invariants", invariants);
  check("invariants_n", invariants_n,
        {invariants.shape(0), invariants.shape(1)});
  auto W = create<double>({invariants.shape(0), 6, invariants.shape(1)});
  dispatch_facets(
      k,
      [&]<class S>()
      {
        for (std::size_t i = 0; i < invariants.shape(0); ++i)
          store(average_gradient<S>(load_invariants<S>(invariants_n, i),
                                    load_invariants<S>(invariants, i)),
                view(W), i);
      });
  return W;
}

auto with_vertices(const Doubles& points, const Doubles& x,
                   const In<std::int32_t>& vertices,
                   const In<std::int32_t>& segment)
{
  const std::size_t m = segment.size();
  check("segment", segment, {m});
  check("points", points, {m, 3});
  check("x", x, {any, 3});
  check("vertices", vertices, {any, any});
  const std::size_t k = vertices.shape(1);
  check_rows("segment: expected row numbers of vertices", segment,
             vertices.shape(0));
  auto pairs = create<double>({m, 1 + k, 3});
  double* out = pairs.data();
  for (std::size_t i = 0; i < m; ++i)
  {
    out = std::copy_n(points.data() + 3 * i, 3, out);
    for (const std::int32_t row : view(vertices).subspan(
             k * static_cast<std::size_t>(segment.data()[i]), k))
    {
      if (row < 0 || static_cast<std::size_t>(row) >= x.shape(0))
        throw nb::value_error("vertices: expected row numbers of x");
      out = std::copy_n(x.data() + 3 * row, 3, out);
    }
  }
  return pairs;
}

auto unit_vectors(const Doubles& rows)
{
  check("rows", rows, {any, any});
  const std::size_t m = rows.shape(0), d = rows.shape(1);
  if (d < 3)
    throw nb::value_error("rows: expected at least 3 columns");
  auto unit = create<double>({m, 3});
  for (std::size_t i = 0; i < m; ++i)
  {
    const double* v = rows.data() + d * i;
    const double length = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (std::size_t c = 0; c < 3; ++c)
      unit.data()[3 * i + c] = v[c] / (length > 0 ? length : 1);
  }
  return unit;
}

auto slip_hessian_batch(const Doubles& w, const Doubles& b, const Doubles& t)
{
  check("w", w, {any, any});
  const std::size_t m = w.shape(0), k = w.shape(1);
  check("b", b, {m, 2, k});
  check("t", t, {m, 2});
  auto hessian = create<double>({m, 3 * k, 3 * k});
  std::fill_n(hessian.data(), hessian.size(), 0.0);
  std::vector<double> along(k);
  for (std::size_t i = 0; i < m; ++i)
  {
    const double* weight = w.data() + k * i;
    for (std::size_t K = 0; K < k; ++K)
      along[K] = t.data()[2 * i] * b.data()[2 * k * i + K]
                 + t.data()[2 * i + 1] * b.data()[2 * k * i + k + K];
    for (std::size_t K = 0; K < k; ++K)
      for (std::size_t L = 0; L < k; ++L)
        for (std::size_t c = 0; c < 3; ++c)
          hessian.data()[3 * k * (3 * (k * i + K) + c) + 3 * L + c]
              = weight[K] * along[L] + weight[L] * along[K];
  }
  return hessian;
}
} // namespace

void kinematics(nb::module_& m)
{
  m.def("with_vertices", &with_vertices, nb::arg("points"), nb::arg("x"),
        nb::arg("vertices"), nb::arg("segment"),
        "(m, 3), (l, 3), (s, k) rows of x, (m,) -> points and the vertices of "
        "their segments (m, 1+k, 3)");
  m.def("unit_vectors", &unit_vectors, nb::arg("rows"),
        "(m, d), of which three count -> of unit length, or zero (m, 3)");
  m.def("slip_hessian", &slip_hessian_batch, nb::arg("w"), nb::arg("b"),
        nb::arg("t"),
        "(m, k), (m, 2, k), (m, 2) -> second derivative of t . slip by the "
        "coordinates (m, 3k, 3k), see nts/contact/slip.h");
  constexpr const char* project_doc
      = "(m, 1+k, 3), (m,) -> xi (m, 2), gap (m,), normal (m, 3), status (m,): "
        "0 converged, 1 not (NaN)";
  m.def("project", &project_batch<FlatSegments>, nb::arg("x_pair"),
        nb::arg("orientation"), project_doc);
  m.def("patch_project", &project_batch<Patches>, nb::arg("x_pair"),
        nb::arg("orientation"), project_doc);
  m.def("patch_functions", &patch_functions_batch, nb::arg("xi"),
        nb::arg("points"), "(m, 2), c -> weights of control points (m, c)");
  m.def("gap_gradient", &gap_gradient_batch, nb::arg("x_pair"),
        nb::arg("orientation"), "(m, 1+k, 3), (m,) -> (m, 3(1+k))");
  m.def("gap_hessian", &gap_hessian_batch, nb::arg("x_pair"),
        nb::arg("orientation"), "(m, 1+k, 3), (m,) -> (m, 3(1+k), 3(1+k))");
  m.def("invariants", &invariants_batch, nb::arg("x_pair"), nb::arg("normal"),
        nb::arg("xi"), nb::arg("slack"),
        "(m, 1+k, 3), (m, 3), (m, 2), (m,) -> (m, 17), triangles (m, 12)");
  m.def("constraints", &constraints_batch, nb::arg("invariants"),
        "(m, 17 or 12) -> (m, 6)");
  m.def("constraints_gradient", &constraints_gradient_batch,
        nb::arg("invariants"), "(m, n) -> (m, 6, n), n = 17 or 12");
  m.def("average_gradient", &average_gradient_batch, nb::arg("invariants_n"),
        nb::arg("invariants"), "(m, n), (m, n) -> (m, 6, n), n = 17 or 12");
}
} // namespace nts::bindings
