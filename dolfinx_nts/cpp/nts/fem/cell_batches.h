#pragma once

#include "nts/fem/cell_integral.h"

#include <array>
#include <concepts>
#include <memory>
#include <new>

/// @brief Linear forms over cells, with kernels for a batch of cells.
namespace nts
{
/// @brief Element vectors of a batch of cells, one lane a cell: what an element
/// kernel has at i stands at i * lanes + l for the cell in lane l.
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

/// @brief Numbers at an address that suits the widest vectors.
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

/// @brief Copy rows of D numbers into lanes: those of the k nodes of L cells.
/// @param[in] x (l, D)
/// @param[in] nodes Rows of x of the nodes of all cells, (c, k).
/// @param[in] cells (L,)
/// @param[out] out (k, D, L)
template <std::size_t D, class T, std::size_t L>
void gather_lanes(std::span<const T> x, std::span<const std::int32_t> nodes,
                  std::size_t k, const std::array<std::size_t, L>& cells,
                  T* out)
{
  for (std::size_t i = 0; i < k; ++i)
  {
    std::array<const T*, L> row;
    for (std::size_t l = 0; l < L; ++l)
      row[l] = x.data() + D * static_cast<std::size_t>(nodes[k * cells[l] + i]);
    for (std::size_t j = 0; j < D; ++j, out += L)
      for (std::size_t l = 0; l < L; ++l)
        out[l] = row[l][j];
  }
}

/// @brief Values in the precision of a kernel, which are copied if it is
/// another one: to convert them all is faster than to do so at each cell.
template <class T>
class Converted
{
public:
  explicit Converted(std::span<const double> values)
  {
    if constexpr (std::same_as<T, double>)
      _values = values;
    else
    {
      _copy.assign(values.begin(), values.end());
      _values = _copy;
    }
  }

  operator std::span<const T>() const noexcept { return _values; }

private:
  std::vector<T> _copy;
  std::span<const T> _values;
};

/// @brief The same as `add_cells` by batches of L cells, in numbers of type T,
/// with D values at a node.
template <class T, std::size_t L, std::size_t D>
void add_batches(std::span<const BatchKernel> kernels, const CellNodes& mesh,
                 std::span<const std::int32_t> cells, const KernelInput& input,
                 const CellRows& out)
{
  const auto [all_X, all_vertices, v, all_nodes, k, d] = mesh;
  const auto [functions, packed, places, width, constants] = input;
  AlignedArray<T> X(3 * v * L), w(width * L), element(out.size() * L);
  const std::vector<T> c(constants.begin(), constants.end());
  const Converted<T> x(all_X);
  std::vector<Converted<T>> values;
  for (const Gathered& function : functions)
    values.emplace_back(function.values);
  for (std::size_t begin = 0; begin < cells.size(); begin += L)
  {
    const std::size_t many = std::min(L, cells.size() - begin);
    // Lanes without a cell repeat the first one, so that none has a NaN.
    std::array<std::size_t, L> batch;
    for (std::size_t l = 0; l < L; ++l)
      batch[l] = static_cast<std::size_t>(cells[begin + (l < many ? l : 0)]);
    gather_lanes<3, T, L>(x, all_vertices, v, batch, X.data());
    for (std::size_t i = 0; i < places.size(); ++i)
      for (std::size_t l = 0; l < L; ++l)
        w.data()[places[i] * L + l]
            = static_cast<T>(packed[places.size() * batch[l] + i]);
    for (std::size_t i = 0; i < functions.size(); ++i)
      gather_lanes<D, T, L>(values[i], all_nodes, k, batch,
                            w.data() + functions[i].first * L);
    element.clear();
    for (const BatchKernel& kernel : kernels)
      kernel(element.data(), w.data(), c.data(), X.data());
    for (std::size_t l = 0; l < many; ++l)
      out.add(batch[l], element.data() + l, L);
  }
}

/// @brief Add integrals over the same cells to a vector, batch by batch.
/// @param[in] kernels Of the integrals, all alike in lanes and precision.
/// @param[in] mesh Its cells.
/// @param[in] cells Those to integrate over.
/// @param[in] input What the kernel reads.
/// @param[in] out Where the integrals are added.
inline void add_cells(std::span<const BatchKernel> kernels,
                      const CellNodes& mesh,
                      std::span<const std::int32_t> cells,
                      const KernelInput& input, const CellRows& out)
{
  const auto add_values = [&]<std::size_t L, std::size_t D>()
  {
    if (kernels.front().is_single())
      add_batches<float, L, D>(kernels, mesh, cells, input, out);
    else
      add_batches<double, L, D>(kernels, mesh, cells, input, out);
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
