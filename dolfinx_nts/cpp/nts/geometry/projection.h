#pragma once

#include "nts/geometry/segment.h"

/// @brief Closest-point projection of a node onto the (extended) surface of a
/// segment.
namespace nts
{
/// @brief Current positions of a contact node and the vertices of a segment.
template <class S>
struct Pair
{
  Vec3 node;
  std::array<Vec3, S::vertices> segment;
};

/// @brief Geometry of the segment's surface at the projection point.
///
/// The projection is not clamped: `xi` may lie outside the reference cell.
template <class S>
struct Projection
{
  Vec2 xi = S::centre;               ///< convective coordinates
  double gap = 0;                    ///< (x_s - x_bar) . normal, > 0 open
  Vec3 normal = {};                  ///< unit normal, outward
  std::array<Vec3, 2> tangents = {}; ///< a_alpha = x_bar,alpha
  Matrix<2, 2> metric = {};          ///< a_alpha . a_beta
  double twist = 0;                  ///< n . x_bar,12 (the curvature)
  bool converged = false;            ///< false: all other members are invalid
};

/// @brief Longest distance between two vertices, squared [m^2].
template <class S>
double squared_diameter(const std::array<Vec3, S::vertices>& segment) noexcept
{
  double square = 0;
  for (std::size_t i = 0; i < S::vertices; ++i)
    for (std::size_t j = 0; j < i; ++j)
    {
      const Vec3 edge = segment[i] - segment[j];
      square = std::max(square, dot(edge, edge));
    }
  return square;
}

/// @brief Longest distance between two vertices [m].
template <class S>
double diameter(const std::array<Vec3, S::vertices>& segment) noexcept
{
  return std::sqrt(squared_diameter<S>(segment));
}

/// @brief Solve (x_s - x_bar(xi)) . a_alpha(xi) = 0 by Newton's method from
/// the segment's centre.
///
/// Newton's matrix m_ab - (x_s - x_bar) . x_bar,ab is replaced by the metric
/// m_ab if it is not safely positive definite (a node far from a twisted
/// segment). Franke, Hesch, Betsch (2011), eq. (24).
/// @param[in] pair Node and segment.
/// @param[in] orientation +1 where a_1 x a_2 points outward, otherwise -1.
template <class S>
Projection<S> project(const Pair<S>& pair, double orientation) noexcept
{
  constexpr int max_iterations = 30;
  constexpr double degenerate
      = 1e-20; // least |n|^2 of a segment relative to (tr m)^2
  constexpr double convex
      = 0.1; // least det A of Newton's matrix relative to det m
  constexpr double round_off = 1e-12; // of xi, for a node on the segment
  constexpr double unit = 1e-15;      // round-off of numbers of size 1
  // x_bar = x_0 + xi_1 edge_1 + xi_2 edge_2 + xi_1 xi_2 mixed.
  const auto& x = pair.segment;
  const Vec3 from = pair.node - x[0], mixed = combine(S::d2phi(), x);
  const std::array<Vec3, 2> edge = S::directions(x);

  Projection<S> p;
  const auto finished = [&](const Vec3& r, const Vec3& n) noexcept
  {
    p.normal = (orientation / norm(n)) * n;
    p.gap = dot(r, p.normal);
    p.twist = dot(mixed, p.normal);
    p.converged = true;
    return p;
  };
  for (int iteration = 0; iteration < max_iterations; ++iteration)
  {
    p.tangents = {edge[0] + p.xi[1] * mixed, edge[1] + p.xi[0] * mixed};
    const Vec3 r = from - p.xi[0] * edge[0] - p.xi[1] * p.tangents[1];
    for (std::size_t a = 0; a < 2; ++a)
      for (std::size_t b = 0; b < 2; ++b)
        p.metric[a][b] = dot(p.tangents[a], p.tangents[b]);
    const double trace = p.metric[0][0] + p.metric[1][1];
    const double area = det(p.metric);
    // det m = |n|^2 up to round-off, also on a degenerate segment.
    const Vec3 n = cross(p.tangents[0], p.tangents[1]);
    if (!(std::min(area, dot(n, n)) > degenerate * trace * trace))
      return {};

    // The last pass only evaluates the geometry at the converged xi.
    if (p.converged)
      return finished(r, n);

    Matrix<2, 2> A = p.metric;
    A[0][1] -= dot(r, mixed);
    A[1][0] = A[0][1];
    if (!(det(A) > convex * area))
      A = p.metric;
    const Vec2 f = {dot(r, p.tangents[0]), dot(r, p.tangents[1])};
    const Vec2 dxi = inverse(A) * f;
    const double change = std::max(std::abs(dxi[0]), std::abs(dxi[1]));
    if (change <= unit) // converged, in flat segments in the second pass
      return finished(r, n);
    p.xi = {p.xi[0] + dxi[0], p.xi[1] + dxi[1]};
    // Round-off in xi grows with the distance of the node.
    const double excess = change - round_off;
    p.converged
        = excess <= 0
          || excess * excess * trace <= round_off * round_off * dot(r, r);
  }
  return {};
}

/// @brief Point of the edges of a segment that is nearest to a node [m].
template <class S>
Vec3 nearest_of_edges(const Pair<S>& pair) noexcept
{
  Vec3 found = pair.segment[0];
  double nearest = INFINITY;
  for (const auto& [begin, end] : S::edges)
  {
    const Vec3 edge = pair.segment[end] - pair.segment[begin];
    const Vec3 r = pair.node - pair.segment[begin];
    const double square = dot(edge, edge);
    const double part
        = square > 0 ? std::clamp(dot(r, edge) / square, 0., 1.) : 0;
    const double away = norm(r - part * edge);
    if (away < nearest)
    {
      nearest = away;
      found = pair.segment[begin] + part * edge;
    }
  }
  return found;
}

/// @brief Distance of a node to a segment that ends at its edges [m].
/// @param[in] pair Node and segment.
/// @param[in] p Their projection, converged.
template <class S>
double distance(const Pair<S>& pair, const Projection<S>& p) noexcept
{
  return S::outside(p.xi) <= 0 ? std::abs(p.gap)
                               : norm(pair.node - nearest_of_edges(pair));
}
} // namespace nts
