#pragma once

#include "nts/fem/cell_integral.h"
#include "nts/fem/lane_rows.h"

#include <array>
#include <concepts>
#include <memory>
#include <new>

/// @brief Linear forms over cells, with kernels for a batch of cells.
namespace nts
{
/// @brief Element vectors of a batch of cells, one SIMD lane per cell: entry i
/// of the cell in lane l is at i * lanes + l.
class BatchKernel
{
public:
  /// @param[in] address Of a function of the arguments (b, w, c, X) of
  /// ElementKernel; c has no lanes.
  /// @param[in] lanes Number of cells of a batch: 2, 4, 8 or 16.
  /// @param[in] is_single Whether numbers have single precision.
  BatchKernel(std::uintptr_t address, std::size_t lanes, bool is_single)
      : _address(address), _lanes(lanes), _is_single(is_single)
  {
    if (address == 0)
      throw std::invalid_argument("address: expected a function, given 0");
    if (lanes != 2 && lanes != 4 && lanes != 8 && lanes != 16)
      throw std::invalid_argument("lanes: expected 2, 4, 8 or 16");
  }

  std::size_t lanes() const noexcept { return _lanes; }
  bool is_single() const noexcept { return _is_single; }

  template <class T>
  void operator()(T* b, const T* w, const T* c, const T* X) const noexcept
  {
    using Function = void (*)(T*, const T*, const T*, const T*);
    reinterpret_cast<Function>(_address)(b, w, c, X);
  }

private:
  std::uintptr_t _address;
  std::size_t _lanes;
  bool _is_single;
};

/// @brief Numbers at an address aligned for the widest SIMD vectors.
template <class T>
class AlignedArray
{
public:
  explicit AlignedArray(std::size_t size)
      : _values(static_cast<T*>(::operator new(size * sizeof(T), alignment))),
        _size(size)
  {
    std::fill_n(_values.get(), size, T(0));
  }

  T* data() const noexcept { return _values.get(); }
  void clear() const noexcept { std::fill_n(_values.get(), _size, T(0)); }

private:
  static constexpr std::align_val_t alignment{64};
  struct Delete
  {
    void operator()(T* values) const { ::operator delete(values, alignment); }
  };
  std::unique_ptr<T, Delete> _values;
  std::size_t _size;
};

/// @brief Offsets of the rows of node i of L cells in arrays with S numbers per
/// row.
/// @param[in] nodes Rows of the k nodes of all cells, (c, k).
template <std::size_t S, std::size_t L>
std::array<std::size_t, L> rows_of(std::span<const std::int32_t> nodes,
                                   std::size_t k, std::size_t i,
                                   const std::array<std::size_t, L>& cells)
{
  std::array<std::size_t, L> begin;
  for (std::size_t l = 0; l < L; ++l)
    begin[l] = S * static_cast<std::size_t>(nodes[k * cells[l] + i]);
  return begin;
}

/// @brief Values in single precision, by array; their memory is reused, as its
/// allocation takes longer than the rounding.
using Rounded = std::vector<std::vector<float>>;

/// @brief Values in the precision of a kernel. Rounding all of them first is
/// faster than rounding cell by cell.
template <class T>
std::span<const T> in_precision(std::span<const double> values,
                                std::vector<float>& memory)
{
  if constexpr (std::same_as<T, double>)
    return values;
  else
  {
    memory.assign(values.begin(), values.end());
    return memory;
  }
}

/// @brief `add_cells` with batches of L cells, numbers of type T, and D values
/// at a node.
template <class T, std::size_t L, std::size_t D>
void add_batches(std::span<const BatchKernel> kernels, const CellNodes& mesh,
                 std::span<const std::int32_t> cells, const KernelInput& input,
                 const CellRows& out, Rounded& rounded)
{
  const auto [all_X, all_vertices, v, all_nodes, k, d] = mesh;
  const auto [functions, packed, places, width, constants] = input;
  AlignedArray<T> X(3 * v * L), w(width * L), element(out.size() * L);
  const std::vector<T> c(constants.begin(), constants.end());
  rounded.resize(functions.size() + 1);
  const std::span<const T> x = in_precision<T>(all_X, rounded.back());
  std::vector<std::span<const T>> values;
  for (std::size_t i = 0; i < functions.size(); ++i)
    values.push_back(in_precision<T>(functions[i].values, rounded[i]));
  const bool is_plain = out.d == D && out.sums.empty();
  for (std::size_t begin = 0; begin < cells.size(); begin += L)
  {
    const std::size_t many = std::min(L, cells.size() - begin);
    // Lanes without a cell repeat the first one, so that none has a NaN.
    std::array<std::size_t, L> batch;
    for (std::size_t l = 0; l < L; ++l)
      batch[l] = static_cast<std::size_t>(cells[begin + (l < many ? l : 0)]);
    for (std::size_t i = 0; i < v; ++i)
      rows_to_lanes<D>(x.data(), rows_of<3>(all_vertices, v, i, batch),
                       X.data() + 3 * L * i);
    for (std::size_t i = 0; i < places.size(); ++i)
      for (std::size_t l = 0; l < L; ++l)
        w.data()[places[i] * L + l]
            = static_cast<T>(packed[places.size() * batch[l] + i]);
    for (std::size_t i = 0; i < k; ++i)
    {
      const auto rows = rows_of<D>(all_nodes, k, i, batch);
      for (std::size_t f = 0; f < functions.size(); ++f)
        rows_to_lanes<D>(values[f].data(), rows,
                         w.data() + (functions[f].first + D * i) * L);
    }
    element.clear();
    for (const BatchKernel& kernel : kernels)
      kernel(element.data(), w.data(), c.data(), X.data());
    if (is_plain && many == L)
      for (std::size_t i = 0; i < out.k; ++i)
        add_lanes_to_rows<D>(element.data() + D * L * i,
                             rows_of<D>(out.rows, out.k, i, batch),
                             out.b.data());
    else
      for (std::size_t l = 0; l < many; ++l)
        out.add(batch[l], element.data() + l, L);
  }
}

/// @brief Add integrals over the same cells to a vector, batch by batch.
/// @param[in] kernels Kernels with the same number of lanes and precision.
/// @param[in] mesh The mesh.
/// @param[in] cells Cells of the integrals.
/// @param[in] input Input of the kernels.
/// @param[in] out Output to which the integrals are added.
/// @param[in,out] rounded Work arrays for values in single precision.
inline void add_cells(std::span<const BatchKernel> kernels,
                      const CellNodes& mesh,
                      std::span<const std::int32_t> cells,
                      const KernelInput& input, const CellRows& out,
                      Rounded& rounded)
{
  const auto add_values = [&]<std::size_t L, std::size_t D>()
  {
    if (kernels.front().is_single())
      add_batches<float, L, D>(kernels, mesh, cells, input, out, rounded);
    else
      add_batches<double, L, D>(kernels, mesh, cells, input, out, rounded);
  };
  const auto add = [&]<std::size_t L>()
  {
    if (mesh.d == 2)
      add_values.template operator()<L, 2>();
    else
      add_values.template operator()<L, 3>();
  };
  switch (kernels.front().lanes())
  {
  case 2:
    return add.operator()<2>();
  case 4:
    return add.operator()<4>();
  case 8:
    return add.operator()<8>();
  default:
    return add.operator()<16>();
  }
}
} // namespace nts
