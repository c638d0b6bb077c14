"""Friction of surface-to-surface contact: exact ledger, objectivity, a patch test of shear."""

from functools import cache

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers import scenes
from helpers.models.homogeneous_blocks import deform
from helpers.scene import Motion, Scene, Totals

pytestmark = pytest.mark.serial

# Nodes stick by multipliers or on springs [N/m]; with any of these, some slide.
LAWS = {
    "multipliers": (None, nts.Coulomb(1.0)),
    "springs": (None, nts.Coulomb(1.0, eps_T=3e4)),
    "penalty": (nts.Penalty(1e5), nts.Coulomb(1.0, eps_T=3e4)),
}
laws = pytest.mark.parametrize("law", LAWS)
NUM_STEPS = 25


@cache
def impact(law: str, method: str = "mortar") -> tuple[Scene, dict[str, np.ndarray]]:
    """Throw the hollow ball against the plate at an angle; energies and momenta by step."""
    enforcement, friction = LAWS[law]
    scene = scenes.ball_plate(
        MPI.COMM_WORLD, enforcement=enforcement, friction=friction, method=method
    )
    totals, rows = Totals(scene), {"nodes": [], "total": [], "dissipation": []}
    rows["total"].append(totals.row())
    for _ in range(NUM_STEPS):
        assert scene.stepper.advance().newton_iterations <= 10
        history = scene.stepper.contacts[0].history
        rows["total"].append(totals.row())
        rows["dissipation"].append([history.dissipation.sum(), history.energy.sum()])
        rows["nodes"].append([(history.active & ~history.sliding).sum(), history.sliding.sum()])
        assert history.dissipation.min() >= -1e-12
    return scene, {name: np.array(values) for name, values in rows.items()}


@laws
def test_sum_of_energy_and_frictional_dissipation_is_conserved(law, table_row):
    """Springs of friction store a part; some nodes stick, others slide."""
    _, rows = impact(law)
    energy = rows["total"][:, 1:3].sum(axis=1)
    taken = np.cumsum(rows["dissipation"][:, 0]) + rows["dissipation"][:, 1]
    error = np.abs((energy[1:] + taken) / energy[0] - 1).max()
    table_row(
        f"ball on plate, μ = 1, {law}",
        "energy and dissipation together are conserved",
        f"{error:.0e}",
    )
    assert error <= 1e-12
    assert taken[-1] > 0.03 * energy[0]
    assert rows["nodes"].max(axis=0).min() >= 3


@laws
def test_momenta_are_conserved_with_friction(law):
    _, rows = impact(law)
    for momentum in (rows["total"][:, 3:6], rows["total"][:, 6:]):
        change = np.linalg.norm(momentum - momentum[0], axis=1).max()
        assert change <= 1e-12 * np.linalg.norm(momentum[0])


def test_friction_dissipates_as_between_nodes_and_segments():
    """Up to the mesh error: five nodes of the ball touch at first."""
    (_, mortar), (_, nodes) = impact("multipliers"), impact("multipliers", "node-to-segment")
    taken = [rows["dissipation"][:, 0].sum() for rows in (mortar, nodes)]
    assert taken[0] == pytest.approx(taken[1], rel=0.1)


def test_linear_systems_with_friction_need_no_complete_factors():
    scene, _ = impact("multipliers")
    assert scene.stepper.statistics.solver.num_direct == 0


@laws
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_moved_bodies_have_moved_results(law, cell, rng):
    """Friction is the same in all directions of the surface."""
    motion = Motion.random(rng)

    def stepper(bodies, pairs, dt):
        pairs = [
            nts.ContactPair(p.nodes, p.segments, enforcement, friction, "mortar") for p in pairs
        ]
        return nts.EnergyMomentum(bodies, pairs, dt=dt)

    enforcement = nts.Penalty(50.0) if law == "penalty" else None
    friction = nts.Coulomb(0.3, eps_T=None if law == "multipliers" else 20.0)
    fixed, moved = (
        scenes.blocks(MPI.COMM_WORLD, stepper, cell=cell, motion=m) for m in (None, motion)
    )
    histories = fixed.run(10), moved.run(10)
    assert np.abs(moved.positions() - motion(fixed.positions())).max() <= 1e-11
    assert max(histories[0].num_active) >= 5


@pytest.mark.parametrize(
    ("cells", "cell", "degree"),
    [
        *(((3, 4), "hexahedron", 1), ((4, 3), "hexahedron", 1)),
        *(((2, 3), "hexahedron", 2), ((3, 2), "tetrahedron", 2)),
    ],
)
def test_blocks_that_stick_are_sheared_as_one(cells, cell, degree, table_row):
    """A patch test: nodes do not match, stress and deformation are homogeneous all the same."""
    F = np.eye(3) + np.array([[0.0, 0.0, 0.003], [0.0, 0.0, 0.001], [0.0, 0.0, -0.01]])
    stepper, error, stress = deform(cells, F, cell=cell, friction=nts.Coulomb(5.0), degree=degree)
    (contact,) = stepper.contacts
    history = contact.history
    assert history.active[history.area > 0].all() and not history.sliding.any()
    table_row(
        f"two blocks that stick, sheared and compressed, {cells[0]}:{cells[1]} cells"
        + degree // 2 * f", {cell} of degree 2",
        "homogeneous deformation",
        f"largest error of the displacement {error:.0e} m",
    )
    assert error <= 1e-10
    # Pressure and shear of the whole surface.
    force = contact.history.force.sum(axis=0)
    np.testing.assert_allclose(force, -stress @ [0, 0, 1], atol=1e-4 * np.abs(stress).max())
