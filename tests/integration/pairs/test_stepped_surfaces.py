"""Mortar contact above steps, next to opposite faces, and in front of hidden segments."""

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from scipy.spatial.transform import Rotation

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.serial
RUBBER = nts.NeoHookean(E=1e6, nu=0.0, rho=1e3)


def bodies_of(build: Any, dim: int, turn: Any = None) -> dict[str, nts.Body]:
    """Bodies of a model by name, of a mesh that is rotated."""
    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_SELF)
    if turn is not None:
        mesh.geometry.x[:] = mesh.geometry.x @ turn.T
    V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    names = [name for name in ("low", "high", "up") if name in tag]
    return {name: nts.Body(V, cells, tag[name], RUBBER, name=name) for name in names}


def held(bodies: dict[str, nts.Body], dim: int, height: float, value: float = 0.0) -> Any:
    """Condition that nodes at a height have the given displacement along the last axis."""
    V = next(iter(bodies.values())).V
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[dim - 1], height))
    u = np.zeros(dim)
    u[-1] = value
    return fem.dirichletbc(u, dofs, V)


def pressed(step: float, dim: int) -> float:
    """Force on a block of coarse facets across two bases, the second one lower by a step [N].

    With an infinite step there is one base only.
    """

    def box(model: Any, name: str, x: float, width: float, z: float, h: float, n: Any) -> None:
        add = parts.add_rectangle if dim == 2 else parts.add_box
        middle, one = ((), ()) if dim == 2 else ((0.0,), (1.0,))
        cells = (n[0], n[1]) if dim == 2 else (n[0], n[0], n[1])
        add(model, name, corner=(x, *middle, z), size=(width, *one, h), cells=cells)

    def build(model: Any) -> None:
        box(model, "high", 0.0, 0.45, -0.4, 0.4, (5, 3))
        if np.isfinite(step):
            box(model, "low", 0.45, 0.55, -0.4 - step, 0.4, (5, 3))
        box(model, "up", 0.0, 1.0, 0.0, 0.3, (3, 2))

    bodies = bodies_of(build, dim)
    below = nts.boundary_of(*(body for name, body in bodies.items() if name != "up"))
    pair = nts.ContactPair(nts.boundary_of(bodies["up"]), below)
    bcs = [held(bodies, dim, -0.4), held(bodies, dim, 0.3, -0.003)]
    if np.isfinite(step):
        bcs.append(held(bodies, dim, -0.4 - step))
    stepper = nts.QuasiStatic(list(bodies.values()), [pair], dt=1.0, bcs=bcs)
    stepper.advance()
    (force,) = nts.Diagnostics(stepper).pairs().values()
    return float(force.force[dim - 1])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("step", "error"), [(0.006, 0.05), (0.01, 5e-3), (0.02, 2e-3), (0.08, 1e-3), (0.15, 1e-3)]
)
def test_a_lower_surface_below_the_same_facet_takes_no_force_away(step, error, dim):
    assert pressed(step, dim) == pytest.approx(pressed(np.inf, dim), rel=error)


@pytest.mark.parametrize("cells", [1, 2])
def test_the_opposite_face_beyond_an_edge_does_not_push(cells):
    def build(model: Any) -> None:
        parts.add_box(model, "low", corner=(0, 0, 0), size=(1, 1, 0.4), cells=(8, 8, 2))
        size, number = (1, 0.94, 0.3), (cells, cells, 1)
        parts.add_box(model, "up", corner=(0.8, 0.03, 0.401), size=size, cells=number)

    ratios = []
    for whole in (True, False):
        bodies = bodies_of(build, 3)
        low, up = bodies.values()
        faces = [
            nts.boundary_of(body, where=None if whole else lambda x, z=z: np.isclose(x[2], z))
            for body, z in ((low, 0.4), (up, 0.401))
        ]
        bcs = [held(bodies, 3, 0.0)]
        stepper = nts.EnergyMomentum([low, up], [nts.ContactPair(*faces)], dt=0.002, bcs=bcs)
        stepper.set_velocity(up, (0, 0, -1))
        total = np.zeros(3)
        for _ in range(20):
            stepper.advance()
            total += nts.Diagnostics(stepper).between()["low_up"]
        ratios.append(abs(total[0] / total[2]))
    assert ratios[1] < 0.03
    assert ratios[0] < 0.03


@pytest.mark.parametrize("angle", [(0.3, -1.1, 2.0), (1.0, 0.0, 0.0)])
def test_segments_behind_a_body_do_not_count_in_any_position(angle):
    def build(model: Any) -> None:
        parts.add_box(model, "low", corner=(0, 0, 0.01), size=(1, 1, 0.4), cells=(4, 4, 2))
        size = (0.5, 0.6, 0.4)
        parts.add_box(model, "high", corner=(0.25, 0.13, 0.45), size=size, cells=(3, 4, 3))
        ball = {"centre": (0.45, 0.5, 1.1), "radius": 0.2}
        parts.add_solid_ball(model, "up", **ball, cells_per_edge=2, layers=1)

    positions = []
    for turn in (np.eye(3), Rotation.from_rotvec(angle).as_matrix()):
        bodies = bodies_of(build, 3, turn)
        stepper = nts.EnergyMomentum(
            list(bodies.values()), nts.all_pairs(list(bodies.values())), dt=0.005
        )
        for name, velocity in (("high", (1, 0.2, -1)), ("up", (-0.5, 0.3, -3))):
            stepper.set_velocity(bodies[name], turn @ np.array(velocity, dtype=float))
        for _ in stepper.run(until=0.1):
            pass
        positions.append(stepper.x @ turn)
    assert np.abs(positions[0] - positions[1]).max() < 1e-9
