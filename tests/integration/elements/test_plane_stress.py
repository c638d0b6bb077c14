"""Sheets in plane stress: comparison with thin blocks with free faces, conservation."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from helpers.models.plane import RUBBER, blocks, throw
from helpers.models.rings import round_block
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

LAWS = [
    nts.SaintVenantKirchhoff(**RUBBER),
    nts.NeoHookean(**{**RUBBER, "nu": 0.45}, volumetric="quadratic"),
]
laws = pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)


@pytest.mark.serial
@laws
def test_energy_of_a_sheet_is_the_least_one_of_all_thicknesses(law):
    rng = np.random.default_rng(3)
    sheet = nts.PlaneStress(law)
    for _ in range(5):
        A = np.eye(2) + 0.3 * rng.uniform(-1, 1, (2, 2))
        C = np.zeros((3, 3))
        C[:2, :2] = A.T @ A

        def energy(square, C=C, law=law):
            C[2, 2] = square
            return law.value(ufl.as_matrix(C.tolist()))

        squares = np.linspace(0.3, 2.5, 23)
        for _ in range(12):
            best = squares[np.argmin([energy(s) for s in squares])]
            step = squares[1] - squares[0]
            squares = np.linspace(best - step, best + step, 11)
        C[2, 2] = 1.0
        found = sheet.value(ufl.as_matrix(C.tolist()))
        assert found == pytest.approx(energy(best), rel=1e-9)
        stretch = float(ufl.as_ufl(sheet.thickness_stretch(ufl.as_matrix(C.tolist())))(()))
        assert stretch == pytest.approx(np.sqrt(best), abs=1e-5)


def side(law, stretch):
    """Lateral stretch of a block in tension, and its force per undeformed area."""
    E, nu = RUBBER["E"], law_nu(law)
    if isinstance(law, nts.SaintVenantKirchhoff):
        strain = (stretch**2 - 1) / 2
        return np.sqrt(1 - 2 * nu * strain), stretch * E * strain
    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))

    def force(along, J):
        return mu * (along - 1 / along) + lmbda * (J - 1) * J / along

    low, high = 0.5, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if force(middle, stretch * middle**2) > 0 else (middle, high)
    return middle, force(stretch, stretch * middle**2)


def law_nu(law):
    """Poisson's ratio of a law."""
    return RUBBER["nu"] if isinstance(law, nts.SaintVenantKirchhoff) else 0.45


@pytest.mark.serial
@laws
def test_sheet_is_pulled_as_a_block_with_free_faces(law):
    stretch = 1.3

    def build(model):
        meshing.add_rectangle(model, "block", corner=(0, 0), size=(1, 1), cells=(1, 1))

    data = nts.read_mesh(build, MPI.COMM_SELF)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    body = nts.Body(V, data.cells, data.tag["block"], nts.PlaneStress(law))

    def held(axis, name, value=0.0):
        facets = data.facets.find(data.tag[f"block_{name}"])
        return fem.dirichletbc(
            value, fem.locate_dofs_topological(V.sub(axis), 1, facets), V.sub(axis)
        )

    bcs = [held(0, "left"), held(1, "bottom"), held(0, "right", stretch - 1)]
    stepper = nts.QuasiStatic([body], dt=1.0, bcs=bcs)
    force = stepper.advance().reactions[-1].force[0]
    width, expected = side(law, stretch)
    assert force == pytest.approx(expected, rel=1e-8)
    assert stepper.x[:, 1].max() == pytest.approx(width, rel=1e-8)
    stress = nts.Fields(stepper).cauchy_stress().x.array.reshape(3, 3)
    # The thickness shrinks as the width does.
    assert np.abs(stress - np.diag([expected / width**2, 0, 0])).max() < 1e-7 * expected


@pytest.mark.parametrize("cell", ["quadrilateral", once("triangle")])
@laws
def test_impact_of_sheets_conserves_energy_and_momenta(law, cell):
    scene = blocks(cell, angle=0.4, material=nts.PlaneStress(law))
    pair = nts.ContactPair(
        scene.nodes, scene.segments, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    throw(scene, stepper)
    diagnostics = nts.Diagnostics(stepper)
    first, touched = diagnostics.balance(), 0
    for _ in range(12):
        touched = max(touched, stepper.advance().num_active)
        last = diagnostics.balance()
        assert abs(last.total_energy - first.total_energy) < 1e-10 * first.total_energy
    assert touched
    for name in ("linear_momentum", "angular_momentum"):
        change = getattr(last, name) - getattr(first, name)
        assert np.abs(change).max() < 1e-10 * 1e3


@pytest.mark.serial
def test_sheets_run_with_explicit_steps():
    scene = blocks("triangle", material=nts.PlaneStress(LAWS[1]))
    pair = nts.ContactPair(scene.nodes, scene.segments, nts.Penalty(), method="node-to-segment")
    stepper = nts.CentralDifference([scene.lower, scene.upper], [pair])
    throw(scene, stepper)
    diagnostics = nts.Diagnostics(stepper)
    first, gained = diagnostics.balance(), 0.0
    for step in stepper.run(until=0.05):
        gained += diagnostics.bulk_defect() + sum(step.contact_work) - step.contact_work.springs
    last = diagnostics.balance()
    assert last.active_nodes
    assert abs(last.total_energy - first.total_energy - gained) < 1e-9 * first.total_energy


@pytest.mark.serial
def test_invalid_plane_stress_is_refused():
    for law in (
        nts.NeoHookean(**RUBBER),
        nts.MooneyRivlin(c10=1e4, c01=1e3, kappa=1e6, rho=1e3),
        nts.PlaneStress(LAWS[0]),
    ):
        with pytest.raises(ValueError, match=type(law).__name__):
            nts.PlaneStress(law)
    with pytest.raises(TypeError, match="a material, given float"):
        nts.PlaneStress(1.0e5)
    data, V = round_block()
    with pytest.raises(ValueError, match="not axisymmetric, with PlaneStress"):
        nts.Body(V, data.cells, data.tag["block"], nts.PlaneStress(LAWS[0]))
    with pytest.raises(ValueError, match="given one in space"):
        blocks(depth=0.1, material=nts.PlaneStress(LAWS[0]))
