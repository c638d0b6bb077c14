#pragma once

#include "nts/geometry/facet.h"
#include "numpy.h"

#include <concepts>
#include <cstdint>
#include <initializer_list>
#include <nanobind/nanobind.h>
#include <span>
#include <string>
#include <vector>

/// @brief Conversion of NumPy arrays for the kernels.
///
/// A step makes a few hundred small calls, so that the conversion of arrays
/// takes a relevant time. With NumPy's own interface it takes a tenth of the
/// time of an `nb::ndarray`.
namespace nts::bindings
{
namespace nb = nanobind;

/// @brief NumPy's number of a type.
template <class T>
constexpr int type_number()
{
  if constexpr (std::same_as<T, double>)
    return NPY_DOUBLE;
  else if constexpr (std::same_as<T, std::int8_t>)
    return NPY_INT8;
  else if constexpr (std::same_as<T, std::int32_t>)
    return NPY_INT32;
  else if constexpr (std::same_as<T, std::int64_t>)
    return NPY_INT64;
  else
  {
    static_assert(std::same_as<T, bool>);
    return NPY_BOOL;
  }
}

/// @brief A contiguous NumPy array, kept alive; of const T if it is only read.
template <class T>
class Array
{
public:
  Array() = default;

  /// @brief Take an array of this type.
  explicit Array(nb::object array) : _array(std::move(array)) {}

  /// @brief Read-only view of the same array.
  operator Array<const T>() const
    requires(!std::is_const_v<T>)
  {
    return Array<const T>(_array);
  }

  T* data() const noexcept { return static_cast<T*>(PyArray_DATA(get())); }
  std::size_t size() const noexcept { return PyArray_SIZE(get()); }
  std::size_t ndim() const noexcept { return PyArray_NDIM(get()); }
  std::size_t shape(std::size_t axis) const noexcept
  {
    return PyArray_DIM(get(), static_cast<int>(axis));
  }
  nb::handle object() const noexcept { return _array; }

private:
  PyArrayObject* get() const noexcept
  {
    return reinterpret_cast<PyArrayObject*>(_array.ptr());
  }

  nb::object _array;
};

template <class T>
using In = Array<const T>;
template <class T>
using Out = Array<T>;
using Doubles = In<double>;

template <class T>
std::span<T> view(const Array<T>& array) noexcept
{
  return {array.data(), array.size()};
}

/// @brief A new array; its values are not set.
template <class T>
Out<T> create(std::initializer_list<std::size_t> shape)
{
  const std::vector<npy_intp> extents(shape.begin(), shape.end());
  PyObject* array = PyArray_SimpleNew(static_cast<int>(extents.size()),
                                      extents.data(), type_number<T>());
  if (!array)
    throw nb::python_error();
  return Out<T>(nb::steal(array));
}

/// Wildcard in the shape for `check`: any extent is accepted.
inline constexpr std::size_t any = static_cast<std::size_t>(-1);

/// @brief Raise ValueError that names the expected and the given shape.
template <class T>
[[noreturn]] void refuse(const char* name, const Array<T>& array,
                         std::initializer_list<std::size_t> shape)
{
  std::string expected, given;
  for (const std::size_t extent : shape)
    expected += (expected.empty() ? "" : ", ")
                + (extent == any ? "any" : std::to_string(extent));
  for (std::size_t i = 0; i < array.ndim(); ++i)
    given += (i ? ", " : "") + std::to_string(array.shape(i));
  throw nb::value_error((std::string(name) + ": expected shape (" + expected
                         + "), given (" + given + ")")
                            .c_str());
}

/// @brief Raise ValueError unless the array has this shape.
template <class T>
void check(const char* name, const Array<T>& array,
           std::initializer_list<std::size_t> shape)
{
  bool same = array.ndim() == shape.size();
  std::size_t axis = 0;
  for (const std::size_t extent : shape)
  {
    same = same && (extent == any || array.shape(axis) == extent);
    ++axis;
  }
  if (!same)
    refuse(name, array, shape);
}

/// @brief Raise ValueError unless all are valid row numbers, less than n.
inline void check_rows(const char* message, const In<std::int32_t>& rows,
                       std::size_t n)
{
  for (const std::int32_t row : view(rows))
    if (row < 0 || static_cast<std::size_t>(row) >= n)
      throw nb::value_error(message);
}

/// @brief Call function.template operator()<S>() for the segment type with
/// this number of vertices.
template <class Function>
auto dispatch(std::size_t vertices, Function&& function)
{
  switch (vertices)
  {
  case 2:
    return function.template operator()<Line2>();
  case 3:
    return function.template operator()<Tri3>();
  case 4:
    return function.template operator()<Quad4>();
  default:
    throw nb::value_error(("expected segments of 2, 3 or 4 vertices, given "
                           + std::to_string(vertices))
                              .c_str());
  }
}

/// @brief Chooses the type of flat segments from their number of vertices.
struct FlatSegments
{
  template <class Function>
  static auto dispatch(std::size_t vertices, Function&& function)
  {
    return bindings::dispatch(vertices, std::forward<Function>(function));
  }
};

/// @brief Smooth segments as kinds of segments, by their control points.
struct Patches
{
  template <class Function>
  static auto dispatch(std::size_t points, Function&& function)
  {
    switch (points)
    {
    case Line3::vertices:
      return function.template operator()<Line3>();
    case Tri6::vertices:
      return function.template operator()<Tri6>();
    case Quad9::vertices:
      return function.template operator()<Quad9>();
    case CubicEdge::vertices:
      return function.template operator()<CubicEdge>();
    case CubicTriangle::vertices:
      return function.template operator()<CubicTriangle>();
    case BicubicQuad::vertices:
      return function.template operator()<BicubicQuad>();
    default:
      throw nb::value_error(("expected patches of 3, 6 or 9 nodes, or of 4, 10 "
                             "or 16 control points, given "
                             + std::to_string(points))
                                .c_str());
    }
  }
};

/// @brief Call function.template operator()<S>() for segments in space.
template <class Function>
auto dispatch_facets(std::size_t vertices, Function&& function)
{
  if (vertices == 3)
    return function.template operator()<Tri3>();
  if (vertices == 4)
    return function.template operator()<Quad4>();
  throw nb::value_error(("expected segments of 3 or 4 vertices, given "
                         + std::to_string(vertices))
                            .c_str());
}

/// @brief Call function.template operator()<B>() for this number of components
/// of a node.
template <class Function>
auto dispatch_components(std::size_t components, Function&& function)
{
  switch (components)
  {
  case 2:
    return function.template operator()<2>();
  case 3:
    return function.template operator()<3>();
  default:
    throw nb::value_error(("expected 2 or 3 components of a node, given "
                           + std::to_string(components))
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

template <class T>
struct nanobind::detail::type_caster<nts::bindings::Array<T>>
{
  NB_TYPE_CASTER(nts::bindings::Array<T>, const_name("numpy.ndarray"))

  bool from_python(handle source, std::uint8_t flags, cleanup_list*) noexcept
  {
    using namespace nts::bindings;
    constexpr int type = type_number<std::remove_const_t<T>>();
    if (!PyArray_Check(source.ptr()))
      return false;
    auto* array = reinterpret_cast<PyArrayObject*>(source.ptr());
    const bool fits = std::is_const_v<T> ? PyArray_ISCARRAY_RO(array)
                                         : PyArray_ISCARRAY(array);
    if (PyArray_TYPE(array) == type && fits)
    {
      value = Array<T>(borrow(source));
      return true;
    }
    if (!std::is_const_v<T>
        || !(flags & static_cast<std::uint8_t>(cast_flags::convert)))
      return false;
    PyObject* copy = PyArray_FROM_OTF(source.ptr(), type, NPY_ARRAY_IN_ARRAY);
    if (!copy)
    {
      PyErr_Clear();
      return false;
    }
    value = Array<T>(steal(copy));
    return true;
  }

  static handle from_cpp(const nts::bindings::Array<T>& array, rv_policy,
                         cleanup_list*) noexcept
  {
    return array.object().inc_ref();
  }
};
