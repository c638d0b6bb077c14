#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <type_traits>
#include <vector>

/// @brief Linear forms over cells, with the element kernels of FFCx.
namespace nts
{
/// @brief Element vector of a cell, FFCx's `tabulate_tensor`.
///
/// Since FFCx 0.10 it has a pointer to user data as an argument, which is null
/// here.
class ElementKernel
{
public:
  /// @param[in] address Of the function.
  /// @param[in] takes_data Whether a pointer to user data is its last argument.
  ElementKernel(std::uintptr_t address, bool takes_data)
      : _address(address), _takes_data(takes_data)
  {
    if (address == 0)
      throw std::invalid_argument("address: expected a function, given 0");
  }

  /// @param[in,out] b Element vector, incremented.
  /// @param[in] w Values of the functions.
  /// @param[in] c Values of the constants.
  /// @param[in] X Vertices of the cell, (v, 3).
  void operator()(double* b, const double* w, const double* c,
                  const double* X) const noexcept
  {
    if (_takes_data)
      reinterpret_cast<WithData>(_address)(b, w, c, X, nullptr, nullptr,
                                           nullptr);
    else
      reinterpret_cast<Plain>(_address)(b, w, c, X, nullptr, nullptr);
  }

private:
  using Plain = void (*)(double*, const double*, const double*, const double*,
                         const int*, const std::uint8_t*);
  using WithData
      = void (*)(double*, const double*, const double*, const double*,
                 const int*, const std::uint8_t*, void*);
  std::uintptr_t _address;
  bool _takes_data;
};

/// @brief Values of a function of the space, as the input of a kernel.
struct Gathered
{
  std::span<const double> values; ///< values at the nodes, (l, d)
  std::size_t first;              ///< index of its first value in the input
};

/// @brief A mesh and its space of vectors with as many components as positions
/// have; in the plane the third coordinate is ignored.
struct CellNodes
{
  std::span<const double> X;              ///< vertices, (g, 3) [m]
  std::span<const std::int32_t> vertices; ///< rows of X, (c, v)
  std::size_t v;                          ///< vertices of a cell
  std::span<const std::int32_t> nodes;    ///< nodes of the space, (c, k)
  std::size_t k;                          ///< nodes of a cell
  std::size_t d;                          ///< values of the space at a node
};

/// @brief Copy rows of d numbers.
/// @param[in] x (l, d)
/// @param[in] d Numbers of a row.
/// @param[in] rows (n,)
/// @param[out] out (n, d)
inline void gather(std::span<const double> x, std::size_t d,
                   std::span<const std::int32_t> rows, double* out) noexcept
{
  for (const std::int32_t row : rows)
    out = std::copy_n(x.data() + d * static_cast<std::size_t>(row), d, out);
}

/// @brief Input of a kernel, cell by cell.
struct KernelInput
{
  std::span<const Gathered> functions; ///< functions of the space
  std::span<const double> packed;      ///< values of other functions, (c, n)
  /// index in the input of each column of `packed`, (n,)
  std::span<const std::int32_t> places;
  std::size_t width;                 ///< number of input values of a cell
  std::span<const double> constants; ///< values of the constants
};

/// @brief Output of integrals over cells: a nodal vector, and sums over cells.
struct CellRows
{
  std::span<double> b;                ///< (l, d)
  std::span<const std::int32_t> rows; ///< rows of b for each cell, (c, k)
  std::size_t k;                      ///< rows of a cell
  std::size_t d;                      ///< values of a row
  std::span<double> sums; ///< sums of the additional numbers of each cell

  /// @brief Size of the element vector of a cell.
  std::size_t size() const noexcept { return d * k + sums.size(); }

  /// @brief Add the element vector of a cell, whose values have the given
  /// stride.
  template <class T>
  void add(std::size_t cell, const T* values, std::size_t apart) const noexcept
  {
    // Loops of a known length are unrolled.
    switch (d)
    {
    case 2:
      return add(cell, values, apart, std::integral_constant<std::size_t, 2>());
    case 3:
      return add(cell, values, apart, std::integral_constant<std::size_t, 3>());
    default:
      return add(cell, values, apart, d);
    }
  }

private:
  template <class T>
  void add(std::size_t cell, const T* values, std::size_t apart,
           auto length) const noexcept
  {
    for (const std::int32_t row : rows.subspan(k * cell, k))
    {
      double* const at = b.data() + length * static_cast<std::size_t>(row);
      for (std::size_t j = 0; j < length; ++j, values += apart)
        at[j] += *values;
    }
    for (double& sum : sums)
    {
      sum += *values;
      values += apart;
    }
  }
};

/// @brief Add integrals over the same cells to a vector.
/// @param[in] kernels Kernels of the integrals.
/// @param[in] mesh The mesh.
/// @param[in] cells Cells of the integrals.
/// @param[in] input Input of the kernels.
/// @param[in] out Output to which the integrals are added.
inline void add_cells(std::span<const ElementKernel> kernels,
                      const CellNodes& mesh,
                      std::span<const std::int32_t> cells,
                      const KernelInput& input, const CellRows& out)
{
  const auto [all_X, all_vertices, v, all_nodes, k, d] = mesh;
  const auto [functions, packed, places, width, constants] = input;
  std::vector<double> X(3 * v), w(width), element(out.size());
  for (const std::int32_t cell : cells)
  {
    const auto c = static_cast<std::size_t>(cell);
    gather(all_X, 3, all_vertices.subspan(v * c, v), X.data());
    for (std::size_t i = 0; i < places.size(); ++i)
      w[places[i]] = packed[places.size() * c + i];
    for (const auto& [values, first] : functions)
      gather(values, d, all_nodes.subspan(k * c, k), w.data() + first);
    std::ranges::fill(element, 0.0);
    for (const ElementKernel& kernel : kernels)
      kernel(element.data(), w.data(), constants.data(), X.data());
    out.add(c, element.data(), 1);
  }
}
} // namespace nts
