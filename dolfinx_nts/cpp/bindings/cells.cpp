#include "array.h"
#include "nts/fem/cell_integral.h"

#include <nanobind/stl/vector.h>

namespace nts::bindings
{
namespace
{
using Ints = In<std::int32_t>;

/// @brief An integral over cells, and the arrays that hold what it reads.
class CellIntegral
{
public:
  CellIntegral(std::uintptr_t kernel, bool takes_data, Doubles X, Ints vertices,
               Ints nodes, std::vector<Doubles> functions,
               const std::vector<std::size_t>& first, std::size_t width)
      : _kernel(kernel, takes_data), _X(std::move(X)),
        _vertices(std::move(vertices)), _nodes(std::move(nodes)),
        _functions(std::move(functions)), _width(width)
  {
    if (kernel == 0)
      throw nb::value_error("kernel: expected an address, given 0");
    check("X", _X, {any, 3});
    check("vertices", _vertices, {any, any});
    check_rows("vertices: expected rows of X", _vertices, _X.shape(0));
    check("nodes", _nodes, {_vertices.shape(0), any});
    for (const std::int32_t node : view(_nodes))
    {
      if (node < 0)
        throw nb::value_error("nodes: expected no negative entry");
      _num_nodes = std::max(_num_nodes, static_cast<std::size_t>(node) + 1);
    }
    if (first.size() != _functions.size())
      throw nb::value_error("first: expected a place for each function");
    const std::size_t values = 3 * _nodes.shape(1);
    for (std::size_t i = 0; i < first.size(); ++i)
    {
      check_values("functions", _functions[i]);
      if (first[i] > width || values > width - first[i])
        throw nb::value_error("first: expected places for three values a node");
      _gathered.push_back({view(_functions[i]), first[i]});
    }
  }

  void add(const Ints& cells, const Doubles& packed, const Doubles& constants,
           const Out<double>& b) const
  {
    check("cells", cells, {any});
    check_rows("cells: expected numbers of cells", cells, _nodes.shape(0));
    if (packed.size())
      check("packed", packed, {_nodes.shape(0), _width});
    check_values("b", b);
    const CellNodes mesh{view(_X), view(_vertices), _vertices.shape(1),
                         view(_nodes), _nodes.shape(1)};
    add_cells(_kernel, mesh, view(cells), _gathered, view(packed), _width,
              view(constants), view(b));
  }

private:
  template <class T>
  void check_values(const char* name, const Array<T>& values) const
  {
    check(name, values, {any});
    if (values.size() < 3 * _num_nodes)
      throw nb::value_error(
          (std::string(name) + ": expected three values at each node").c_str());
  }

  ElementKernel _kernel;
  Doubles _X;
  Ints _vertices, _nodes;
  std::vector<Doubles> _functions;
  std::vector<Gathered> _gathered; // views of them
  std::size_t _width, _num_nodes = 0;
};
} // namespace

void cells(nb::module_& m)
{
  nb::class_<CellIntegral>(
      m, "CellIntegral",
      "Integral of a linear form over cells with FFCx's kernel; the arrays are "
      "read at each call, not copied")
      .def(nb::init<std::uintptr_t, bool, Doubles, Ints, Ints,
                    std::vector<Doubles>, const std::vector<std::size_t>&,
                    std::size_t>(),
           nb::arg("kernel"), nb::arg("takes_data"), nb::arg("X").noconvert(),
           nb::arg("vertices").noconvert(), nb::arg("nodes").noconvert(),
           nb::arg("functions").noconvert(), nb::arg("first"), nb::arg("width"),
           "-, -, (g, 3), (c, v), (c, k), each (3 l,), place of each, number "
           "of values that the kernel reads")
      .def("add", &CellIntegral::add, nb::arg("cells"), nb::arg("packed"),
           nb::arg("constants"), nb::arg("b").noconvert(),
           "(m,) of which cells, (c, width) values of other functions or "
           "nothing, (n,); adds to b (3 l,)");
}
} // namespace nts::bindings
