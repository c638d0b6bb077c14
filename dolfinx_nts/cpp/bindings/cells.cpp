#include "array.h"
#include "nts/fem/cell_batches.h"

#include <nanobind/stl/vector.h>
#include <variant>

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;

/// @brief Integrals over the same cells, and the arrays that they read.
class CellIntegral
{
public:
  using Kernels
      = std::variant<std::vector<ElementKernel>, std::vector<BatchKernel>>;

  CellIntegral(const Kernels& kernels, Doubles X, Ints vertices, Ints nodes,
               std::vector<Doubles> functions,
               const std::vector<std::size_t>& first,
               std::vector<Doubles> constants, Ints places, std::size_t width,
               std::size_t components, Ints rows, std::size_t length)
      : _kernels(kernels), _X(std::move(X)), _vertices(std::move(vertices)),
        _nodes(std::move(nodes)), _functions(std::move(functions)),
        _constants(std::move(constants)), _places(std::move(places)),
        _rows(std::move(rows)), _width(width), _components(components),
        _length(length)
  {
    std::visit([](const auto& some) { check_alike(some); }, kernels);
    if (components != 2 && components != 3)
      throw nb::value_error("components: expected 2 or 3 values a node");
    check("X", _X, {any, 3});
    check("vertices", _vertices, {any, any});
    check_rows("vertices: expected row numbers of X", _vertices, _X.shape(0));
    check("nodes", _nodes, {_vertices.shape(0), any});
    check("rows", _rows, {_vertices.shape(0), any});
    _num_nodes = largest("nodes", _nodes);
    _num_rows = largest("rows", _rows);
    if (first.size() != _functions.size())
      throw nb::value_error("first: expected one index for each function");
    const std::size_t values = components * _nodes.shape(1);
    for (std::size_t i = 0; i < first.size(); ++i)
    {
      check_values("functions", _functions[i], components * _num_nodes);
      if (first[i] > width || values > width - first[i])
        throw nb::value_error(
            "first: expected all values of each function within width");
      _gathered.push_back({view(_functions[i]), first[i]});
    }
    check("places", _places, {any});
    check_rows("places: expected less than width", _places, width);
  }

  void add(const Ints& cells, const Doubles& packed, const Out<double>& b,
           const Out<double>& sums)
  {
    check("cells", cells, {any});
    check_rows("cells: expected numbers of cells", cells, _nodes.shape(0));
    check("packed", packed, {_nodes.shape(0), _places.size()});
    check_values("b", b, _length * _num_rows);
    check("sums", sums, {any});
    std::vector<double> constants;
    for (const Doubles& values : _constants)
      constants.insert(constants.end(), values.data(),
                       values.data() + values.size());
    const CellNodes mesh{view(_X),     view(_vertices), _vertices.shape(1),
                         view(_nodes), _nodes.shape(1), _components};
    const KernelInput input{_gathered, view(packed), view(_places), _width,
                            constants};
    const CellRows out{view(b), view(_rows), _rows.shape(1), _length,
                       view(sums)};
    std::visit(
        [&]<class Kernel>(const std::vector<Kernel>& kernels)
        {
          if constexpr (std::same_as<Kernel, BatchKernel>)
            add_cells(kernels, mesh, view(cells), input, out, _rounded);
          else
            add_cells(kernels, mesh, view(cells), input, out);
        },
        _kernels);
  }

private:
  template <class T>
  static void check_values(const char* name, const Array<T>& values,
                           std::size_t number)
  {
    check(name, values, {any});
    if (values.size() < number)
      throw nb::value_error(
          (std::string(name) + ": expected the values of all nodes").c_str());
  }

  /// @brief Largest entry plus 1: the least valid number of rows.
  static std::size_t largest(const char* name, const Ints& numbers)
  {
    std::size_t end = 0;
    for (const std::int32_t number : view(numbers))
    {
      if (number < 0)
        throw nb::value_error(
            (std::string(name) + ": expected no negative entry").c_str());
      end = std::max(end, static_cast<std::size_t>(number) + 1);
    }
    return end;
  }

  template <class Kernel>
  static void check_alike(const std::vector<Kernel>& kernels)
  {
    if (kernels.empty())
      throw nb::value_error("kernels: expected at least one");
    if constexpr (std::same_as<Kernel, BatchKernel>)
      for (const BatchKernel& kernel : kernels)
        if (kernel.lanes() != kernels[0].lanes()
            || kernel.is_single() != kernels[0].is_single())
          throw nb::value_error("kernels: expected equal lanes and precision");
  }

  Kernels _kernels;
  Doubles _X;
  Ints _vertices, _nodes;
  std::vector<Doubles> _functions, _constants;
  std::vector<Gathered> _gathered; // views of _functions
  Rounded _rounded;
  Ints _places, _rows;
  std::size_t _width, _components, _length, _num_nodes = 0, _num_rows = 0;
};
} // namespace

void cells(nb::module_& m)
{
  nb::class_<ElementKernel>(m, "ElementKernel", "FFCx's kernel of one cell")
      .def(nb::init<std::uintptr_t, bool>(), nb::arg("address"),
           nb::arg("takes_data"));
  nb::class_<BatchKernel>(m, "BatchKernel", "Kernel of a batch of cells")
      .def(nb::init<std::uintptr_t, std::size_t, bool>(), nb::arg("address"),
           nb::arg("lanes"), nb::arg("is_single"));
  nb::class_<CellIntegral> integral(
      m, "CellIntegral",
      "Integrals of a linear form over the same cells, with kernels that are "
      "alike; the arrays are read at each call, not copied");
  const auto init = [&]<class Kernel>()
  {
    integral.def(
        nb::init<const std::vector<Kernel>&, Doubles, Ints, Ints,
                 std::vector<Doubles>, const std::vector<std::size_t>&,
                 std::vector<Doubles>, Ints, std::size_t, std::size_t, Ints,
                 std::size_t>(),
        nb::arg("kernels"), nb::arg("X").noconvert(),
        nb::arg("vertices").noconvert(), nb::arg("nodes").noconvert(),
        nb::arg("functions").noconvert(), nb::arg("first"),
        nb::arg("constants").noconvert(), nb::arg("places"), nb::arg("width"),
        nb::arg("components"), nb::arg("rows"), nb::arg("length"),
        "-, (g, 3), (c, v), (c, k), each (d l,), place of each, values of "
        "each constant, places of other values, number of values that the "
        "kernel reads, d; rows of the "
        "vector that are added to, of so many values, (c, r)");
  };
  init.operator()<ElementKernel>();
  init.operator()<BatchKernel>();
  integral.def(
      "add", &CellIntegral::add, nb::arg("cells"), nb::arg("packed"),
      nb::arg("b").noconvert(), nb::arg("sums").noconvert(),
      "(m,) of which cells, (c, n) values of other functions; adds "
      "to the rows of b, one behind the other, and the numbers that cells have "
      "behind their rows to their sums, (s,)");
}
} // namespace nts::bindings
