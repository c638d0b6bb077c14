#pragma once

#include <cmath>

/// @file
/// Numbers of a batch of cells, one SIMD lane per cell, with the functions of
/// UFL. It is compiled at run time with the kernels of `batched_source.py`,
/// which are written as for one cell.

#ifdef NTS_SINGLE
using Real = float;
#else
using Real = double;
#endif

// As wide as the registers of the machine [bytes].
#if defined(__AVX512F__)
#define NTS_WIDTH 64
#elif defined(__AVX__)
#define NTS_WIDTH 32
#else
#define NTS_WIDTH 16
#endif
typedef Real Lanes __attribute__((vector_size(NTS_WIDTH)));
extern "C" const int num_lanes = NTS_WIDTH / sizeof(Real);

// The compiler replaces such a loop by one call of a vector function, if the
// library has one.
#define NTS_LANEWISE(name)                                                     \
  inline Lanes name(Lanes x)                                                   \
  {                                                                            \
    Lanes y;                                                                   \
    for (int l = 0; l < num_lanes; ++l)                                        \
      y[l] = std::name(x[l]);                                                  \
    return y;                                                                  \
  }
#define NTS_LANEWISE_OF_TWO(name)                                              \
  inline Lanes name(Lanes x, Lanes y)                                          \
  {                                                                            \
    Lanes z;                                                                   \
    for (int l = 0; l < num_lanes; ++l)                                        \
      z[l] = std::name(x[l], y[l]);                                            \
    return z;                                                                  \
  }                                                                            \
  inline Lanes name(Lanes x, double y) { return name(x, Lanes{} + Real(y)); }  \
  inline Lanes name(double x, Lanes y) { return name(Lanes{} + Real(x), y); }

namespace nts
{
using std::acos;
using std::acosh;
using std::asin;
using std::asinh;
using std::atan;
using std::atan2;
using std::atanh;
using std::cos;
using std::cosh;
using std::erf;
using std::exp;
using std::fmax;
using std::fmin;
using std::log;
using std::sin;
using std::sinh;
using std::sqrt;
using std::tan;
using std::tanh;

NTS_LANEWISE(acos)
NTS_LANEWISE(acosh)
NTS_LANEWISE(asin)
NTS_LANEWISE(asinh)
NTS_LANEWISE(atan)
NTS_LANEWISE(atanh)
NTS_LANEWISE(cos)
NTS_LANEWISE(cosh)
NTS_LANEWISE(erf)
NTS_LANEWISE(exp)
NTS_LANEWISE(log)
NTS_LANEWISE(sin)
NTS_LANEWISE(sinh)
NTS_LANEWISE(sqrt)
NTS_LANEWISE(tan)
NTS_LANEWISE(tanh)
NTS_LANEWISE_OF_TWO(atan2)
NTS_LANEWISE_OF_TWO(fmax)
NTS_LANEWISE_OF_TWO(fmin)

inline Real fabs(Real x) { return std::fabs(x); }
inline Lanes fabs(Lanes x) { return x < 0 ? -x : x; }

// For constants, which are scalars.
inline Real pow(Real x, Real y) { return std::pow(x, y); }
inline Lanes pow(Lanes x, Lanes y)
{
  Lanes z;
  for (int l = 0; l < num_lanes; ++l)
    z[l] = std::pow(x[l], y[l]);
  return z;
}
// Exponents, and therefore the branch, are known when the kernel is compiled.
__attribute__((always_inline)) inline Lanes pow(Lanes x, double y)
{
  if (y == 2)
    return x * x;
  if (y == 3)
    return x * x * x;
  if (y == 4)
    return (x * x) * (x * x);
  if (y == -1)
    return 1 / x;
  if (y == -2)
    return 1 / (x * x);
  if (y == 0.5)
    return sqrt(x);
  if (y == -0.5)
    return 1 / sqrt(x);
  return pow(x, Lanes{} + Real(y));
}
} // namespace nts
