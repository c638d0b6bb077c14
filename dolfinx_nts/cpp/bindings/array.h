#pragma once

#include "nts/segment.h"

#include <cstdint>
#include <initializer_list>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <span>
#include <string>

/// @brief NumPy arrays in and out of the kernels.
namespace nts::bindings
{
namespace nb = nanobind;

template <class T>
using In = nb::ndarray<const T, nb::numpy, nb::c_contig, nb::device::cpu>;
template <class T>
using Out = nb::ndarray<T, nb::numpy, nb::c_contig, nb::device::cpu>;
using Doubles = In<double>;

template <class T>
std::span<const T> view(const In<T>& array) noexcept
{
  return {array.data(), array.size()};
}

template <class T>
std::span<T> view(const Out<T>& array) noexcept
{
  return {array.data(), array.size()};
}

/// @brief A new array that owns its memory.
template <class T>
Out<T> create(std::initializer_list<std::size_t> shape)
{
  std::size_t size = 1;
  for (const std::size_t extent : shape)
    size *= extent;
  T* data = new T[size];
  nb::capsule owner(data,
                    [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return Out<T>(data, shape, owner);
}

/// Extent that any number satisfies in `check`.
inline constexpr std::size_t any = static_cast<std::size_t>(-1);

/// @brief Raise ValueError unless the array has this shape.
template <class Array>
void check(const char* name, const Array& array,
           std::initializer_list<std::size_t> shape)
{
  bool same = array.ndim() == shape.size();
  std::string expected, given;
  std::size_t axis = 0;
  for (const std::size_t extent : shape)
  {
    same = same && (extent == any || array.shape(axis) == extent);
    expected += (axis ? ", " : "")
                + (extent == any ? std::string("any") : std::to_string(extent));
    ++axis;
  }
  if (same)
    return;
  for (std::size_t i = 0; i < array.ndim(); ++i)
    given += (i ? ", " : "") + std::to_string(array.shape(i));
  throw nb::value_error((std::string(name) + ": expected shape (" + expected
                         + "), given (" + given + ")")
                            .c_str());
}

/// @brief Call function.template operator()<S>() for the segment type with
/// this number of vertices.
template <class Function>
auto dispatch(std::size_t vertices, Function&& function)
{
  switch (vertices)
  {
  case 3:
    return function.template operator()<Tri3>();
  case 4:
    return function.template operator()<Quad4>();
  default:
    throw nb::value_error(("expected segments of 3 or 4 vertices, given "
                           + std::to_string(vertices))
                              .c_str());
  }
}

/// @brief Dispatch on segment vertices, 0 for rigid obstacles.
template <class Function>
void dispatch_pairs(std::size_t vertices, Function&& function)
{
  if (vertices == 0)
    function.template operator()<NoSegment>();
  else
    dispatch(vertices, function);
}

/// @brief Number of segment vertices of pairs x, shape (m, 1 + k, 3).
inline std::size_t segment_vertices(const char* name, const Doubles& x_pair)
{
  check(name, x_pair, {any, any, 3});
  return x_pair.shape(1) - 1;
}
} // namespace nts::bindings
