"""Users are warned of elements that lock."""

import logging

import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.model.checks.locking import warn_of_locking
from helpers import scenes
from helpers.models import box_meshes

pytestmark = pytest.mark.at_most_two_ranks


def body(comm, cell, degree, nu, material=None):
    mesh, cells, _, tag = box_meshes.distribute(
        comm, box_meshes.boxes([(1, 1, 3)], [(1.0,) * 3], cell)
    )
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    return nts.Body(V, cells, tag["body 0"], material or nts.NeoHookean(1e5, nu, 1e3))


@pytest.mark.parametrize(
    ("cell", "degree", "nu"),
    [("tetrahedron", 1, 0.44), ("tetrahedron", 2, 0.49), ("hexahedron", 1, 0.49)],
)
def test_other_elements_and_materials_are_fine(comm, cell, degree, nu, caplog):
    warn_of_locking([body(comm, cell, degree, nu)])
    assert not caplog.records


def test_stepper_warns_of_tetrahedra_that_lock(comm, caplog):
    nts.EnergyMomentum([body(comm, "tetrahedron", 1, 0.45)], dt=0.01)
    messages = [(record.levelno, record.getMessage()) for record in caplog.records]
    text = (
        "tetrahedra of degree 1 lock at Poisson's ratios of 0.45 and more, in body 0: "
        "energy is conserved, but bodies are far too stiff in bending and impact; "
        "use degree 2, or hexahedra"
    )
    assert messages == ([(logging.WARNING, text)] if comm.rank == 0 else [])


def test_tetrahedra_of_a_material_with_fields_lock_too(comm, caplog):
    def psi(C, stiffness):
        x, ln_J = ufl.SpatialCoordinate(scene.V.mesh), ufl.ln(ufl.det(C)) / 2
        nu = 0.44 + 0.03 * x[0]
        return stiffness * ((ufl.tr(C) - 3) / 2 - ln_J + nu / (1 - 2 * nu) * ln_J**2)

    scene = body(comm, "tetrahedron", 1, 0.2)
    other = scenes.of_material(scene, nts.Hyperelastic(psi, rho=1e3, stiffness=1e4))
    warn_of_locking([other])
    assert ("0.45 and more, in body 0" in caplog.text) == (comm.rank == 0)


def test_plastic_tetrahedra_lock_at_any_poisson_ratio(comm, caplog):
    metal = nts.J2Plasticity(1e5, 0.2, 1e3, yield_stress=1e2)
    warn_of_locking([body(comm, "hexahedron", 1, 0.2, metal)])
    assert not caplog.records
    warn_of_locking([body(comm, "tetrahedron", 1, 0.2, metal)])
    text = "in body 0: energy is conserved, but bodies are far too stiff; use"
    assert (text in caplog.text) == (comm.rank == 0)
    assert ("use hexahedra of degree 1" in caplog.text) == (comm.rank == 0)
