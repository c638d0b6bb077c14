#define NTS_IMPORT_NUMPY
#include "numpy.h"

#include <nanobind/nanobind.h>

namespace nts::bindings
{
void boundary(nanobind::module_& m);
void cells(nanobind::module_& m);
void kinematics(nanobind::module_& m);
void local_search(nanobind::module_& m);
void contact(nanobind::module_& m);
void elimination(nanobind::module_& m);
void factors(nanobind::module_& m);
void flexible_gmres(nanobind::module_& m);
void contact_schwarz(nanobind::module_& m);
void friction(nanobind::module_& m);
void leapfrog(nanobind::module_& m);
void overlapping_boxes(nanobind::module_& m);
void mortar(nanobind::module_& m);
void mortar_slip(nanobind::module_& m);
void nodal_friction(nanobind::module_& m);
void rows(nanobind::module_& m);
void springs(nanobind::module_& m);
void volume_ratio(nanobind::module_& m);
void paths(nanobind::module_& m);
} // namespace nts::bindings

NB_MODULE(_kernels, m)
{
  if (_import_array() < 0)
    throw nanobind::python_error();
  m.doc() = "Kernels of node-to-segment contact; used by dolfinx_nts only";
  nts::bindings::boundary(m);
  nts::bindings::cells(m);
  nts::bindings::kinematics(m);
  nts::bindings::local_search(m);
  nts::bindings::contact(m);
  nts::bindings::elimination(m);
  nts::bindings::factors(m);
  nts::bindings::flexible_gmres(m);
  nts::bindings::contact_schwarz(m);
  nts::bindings::friction(m);
  nts::bindings::leapfrog(m);
  nts::bindings::overlapping_boxes(m);
  nts::bindings::mortar(m);
  nts::bindings::mortar_slip(m);
  nts::bindings::nodal_friction(m);
  nts::bindings::rows(m);
  nts::bindings::springs(m);
  nts::bindings::volume_ratio(m);
  nts::bindings::paths(m);
}
