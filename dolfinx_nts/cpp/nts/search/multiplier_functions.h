#pragma once

#include "nts/geometry/facet.h"

#include <algorithm>
#include <array>

/// @brief Shape functions of the multipliers on a facet that may be partly
/// covered.
///
/// With linear functions N of the facet, M = int N N^T and D = diag(int N) on
/// the covered part, the dual functions are D M^-1 N: the mean gap of a vertex
/// is the gap at the vertex for a linear gap. At a vertex outside of that part
/// the gap would be extrapolated. The functions are
///
///     psi = T D M^-1 N,   sum_A T_AB = 1,
///     T_AB D_B = (1 - s_A) (M_AB + t_B s_B M_AB^2 / M_AA)   (A != B),
///
/// with s_A = 1 at vertices of the covered part, which have dual functions, and
/// less outside; s = 0 for all gives psi = N. The second term transfers so much
/// from an inside vertex to an outside one that the ratio of both is that of N,
/// and nothing is extrapolated; t_B <= 1 leaves a part to the inside vertex.
/// The sum of psi is 1, integrals are positive, and psi depends continuously on
/// the covered part, so that mean gaps do not jump between steps as facets
/// slide over a free edge.
///
/// s_A depends on the distance m_A of the vertex from the centroid of the
/// covered part, relative to the covariance of this part. In d dimensions
/// m_A <= d (d + 2) for all points of a convex part of any shape (Kannan,
/// Lovasz and Simonovits 1995).
namespace nts
{
/// @brief Numbers of the shape functions of multipliers.
struct MultiplierRule
{
  /// Distances m relative to d (d + 2) [-]: up to the first one a vertex
  /// belongs to the covered part (up to quadrature errors), from the second one
  /// on it is outside.
  static constexpr double inside = 1.2, outside = 2;
  /// Covered fractions of a facet [-]: below the first one all vertices are
  /// outside, since slivers have no accurate dual functions.
  static constexpr double sliver = 1e-3, wide = 1e-2;
  /// Largest fraction that the function of an inside vertex transfers to
  /// outside vertices [-].
  static constexpr double given = 0.9;
};

/// @brief Shape functions of multipliers on a facet of type S.
template <class S>
class MultiplierFunctions
{
public:
  static constexpr std::size_t k = S::vertices, d = k == 2 ? 1 : 2;

  /// @brief Add a point of the covered part.
  void add(const Vec2& xi, double weight) noexcept
  {
    const std::array<double, k> N = S::phi(xi);
    for (std::size_t a = 0; a < k; ++a)
    {
      for (std::size_t b = 0; b < k; ++b)
        _M[a][b] += weight * N[a] * N[b];
      _D[a] += weight * N[a];
    }
    _area += weight;
    for (std::size_t i = 0; i < d; ++i)
    {
      _first[i] += weight * xi[i];
      for (std::size_t j = 0; j < d; ++j)
        _second[i][j] += weight * xi[i] * xi[j];
    }
  }

  /// @brief Compute the coefficients.
  /// @param[in] covered Covered part of the facet [-].
  void finish(double covered) noexcept
  {
    for (std::size_t a = 0; a < k; ++a)
      _psi[a][a] = 1;
    const std::array<double, k> s = insides(covered);
    // Coefficients of the dual functions, transposed: M^-1 D.
    Matrix<k, k> M = _M, dual = {};
    for (std::size_t a = 0; a < k; ++a)
      dual[a][a] = _D[a];
    if (std::ranges::max(s) == 0 || !solve(M, dual))
      return;
    Matrix<k, k> T = {};
    for (std::size_t b = 0; b < k; ++b)
    {
      std::array<double, k> more = {};
      double rest = _D[b], sum = 0;
      for (std::size_t a = 0; a < k; ++a)
        if (a != b)
        {
          T[a][b] = (1 - s[a]) * _M[a][b];
          more[a] = s[b] * T[a][b] * _M[a][b] / _M[a][a];
          rest -= T[a][b];
          sum += more[a];
        }
      const double most = MultiplierRule::given * rest;
      const double t = sum > most ? most / sum : 1;
      T[b][b] = rest - t * sum;
      for (std::size_t a = 0; a < k; ++a)
        T[a][b] = (T[a][b] + t * more[a]) / _D[b];
    }
    _psi = {};
    for (std::size_t a = 0; a < k; ++a)
      for (std::size_t b = 0; b < k; ++b)
        for (std::size_t c = 0; c < k; ++c)
          _psi[a][b] += T[a][c] * dual[b][c];
  }

  /// @brief Evaluate them at a point of the reference cell.
  std::array<double, k> operator()(const Vec2& xi) const noexcept
  {
    const std::array<double, k> N = S::phi(xi);
    std::array<double, k> psi = {};
    for (std::size_t a = 0; a < k; ++a)
      for (std::size_t b = 0; b < k; ++b)
        psi[a] += _psi[a][b] * N[b];
    return psi;
  }

private:
  /// @brief Degree to which each vertex belongs to the covered part, 0 to 1.
  std::array<double, k> insides(double covered) const noexcept
  {
    static constexpr std::array<Vec2, 4> corners
        = {{{0, 0}, {1, 0}, {0, 1}, {1, 1}}};
    using Rule = MultiplierRule;
    const double wide = ramp(covered, Rule::sliver, Rule::wide);
    std::array<double, k> s = {};
    if (wide == 0)
      return s;
    Matrix<d, d> C = {};
    Matrix<d, k> from = {};
    for (std::size_t i = 0; i < d; ++i)
    {
      const double mean = _first[i] / _area;
      for (std::size_t j = 0; j < d; ++j)
        C[i][j] = _second[i][j] / _area - mean * _first[j] / _area;
      for (std::size_t a = 0; a < k; ++a)
        from[i][a] = corners[a][i] - mean;
    }
    Matrix<d, k> turned = from;
    if (!solve(C, turned))
      return s;
    for (std::size_t a = 0; a < k; ++a)
    {
      double m = 0;
      for (std::size_t i = 0; i < d; ++i)
        m += from[i][a] * turned[i][a];
      m /= d * (d + 2);
      s[a] = wide * ramp(m, Rule::outside, Rule::inside);
    }
    return s;
  }

  /// @brief 0 at one end, 1 at the other, linear between, constant beyond.
  static double ramp(double value, double none, double all) noexcept
  {
    return std::clamp((value - none) / (all - none), 0., 1.);
  }

  Matrix<k, k> _M = {}, _psi = {};
  std::array<double, k> _D = {};
  double _area = 0;
  Vec2 _first = {};
  Matrix<d, d> _second = {};
};
} // namespace nts
