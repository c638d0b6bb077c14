"""Forces between each two bodies: against changes of momentum, and their names."""

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.laws import NODAL
from helpers.models.box_meshes import boxes, distribute
from reference.bulk import rotation

NAMES = ("left", "ball", "right")


def scene(comm: MPI.Comm, stiff: float = 1e5, **options: Any) -> nts.EnergyMomentum:
    """Three blocks in a row along x; the outer ones move towards the middle one."""

    def build(model: Any) -> None:
        for name, x, cells in zip(NAMES, (-1.01, 0.0, 1.02), ((1, 2), (2, 3), (1, 2)), strict=True):
            size = {"corner": (x, -0.5 * (name != "ball") * 0.2), "size": (1, 1 - 0.1 * len(name))}
            nts.parts.add_rectangle(model, name, **size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    soft, hard = (nts.NeoHookean(E=E, nu=0.3, rho=1e3) for E in (1e5, stiff))
    bodies = [nts.Body(V, cells, tag[n], soft if n == "ball" else hard) for n in NAMES]
    stepper = nts.EnergyMomentum(bodies, nts.all_pairs(bodies, **(NODAL | options)), dt=0.01)
    stepper.set_velocity(bodies[0], (1.0, 0.1))
    stepper.set_velocity(bodies[2], (-1.2, 0.0))
    return stepper


def wall(comm: MPI.Comm, **options: Any) -> nts.EnergyMomentum:
    """A block that falls on two others, with a joint between them; some nodes face two bodies."""

    def build(model: Any) -> None:
        for name, x, y, n in zip(NAMES, (0, 0.5, 1.05), (0, 0.401, 0), (4, 5, 4), strict=True):
            nts.parts.add_rectangle(model, name, corner=(x, y), size=(1, 0.4), cells=(n, 2))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    bodies = [nts.Body(V, cells, tag[n], nts.NeoHookean(E=1e5, nu=0.0, rho=1e3)) for n in NAMES]
    stepper = nts.EnergyMomentum(bodies, nts.all_pairs(bodies, **(NODAL | options)), dt=0.005)
    stepper.set_velocity(bodies[1], (0.05, -0.3))
    return stepper


def roofs(comm: MPI.Comm, **options: Any) -> nts.EnergyMomentum:
    """The edge of a cube falls on those of two others, next to each other."""
    data, high = boxes([(2, 2, 2)] * 3, [(1.0, 1.0, 1.0)] * 3), np.sqrt(2) + 0.002
    places = [(0.0, (-0.52, 0, 0)), (np.pi / 2, (-0.3, 0.1, high)), (0.0, (0.52, 0, 0))]
    for body, (angle, place) in enumerate(places):
        some = np.unique(data.cells[data.body == body])
        X = (data.X[some] - data.X[some].mean(axis=0)) @ rotation([1, 0, 0], np.pi / 4).T
        data.X[some] = X @ rotation([0, 0, 1], angle).T + place
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(E=2e4, nu=0.3, rho=10.0)
    bodies = [nts.Body(V, cells, tag[f"body {i}"], rubber, name=n) for i, n in enumerate(NAMES)]
    stepper = nts.EnergyMomentum(bodies, nts.all_pairs(bodies, **(NODAL | options)), dt=0.005)
    stepper.set_velocity(bodies[1], (0.1, 0.0, -1.0))
    return stepper


@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize("friction", [None, nts.Coulomb(mu=0.4)])
@pytest.mark.parametrize("build", [scene, wall, roofs])
def test_forces_between_bodies_are_their_changes_of_momentum(comm, build, method, friction):
    stepper = build(comm, method=method, friction=friction)
    diagnostics = nts.Diagnostics(stepper)
    largest = dict.fromkeys(("left_ball", "left_right", "ball_right"), 0.0)
    for _ in range(8):
        before = {k: b.linear_momentum for k, b in diagnostics.bodies().items()}
        step = stepper.advance()
        between, after = diagnostics.between(), diagnostics.bodies()
        assert list(between) == list(largest)
        expected = {
            "left": between["left_ball"] + between["left_right"],
            "ball": between["ball_right"] - between["left_ball"],
            "right": -between["ball_right"] - between["left_right"],
        }
        largest = {name: max(largest[name], np.abs(between[name]).max()) for name in largest}
        for name, force in expected.items():
            rate = (after[name].linear_momentum - before[name]) / step.dt
            np.testing.assert_allclose(rate, force, atol=1e-5 * 1e3)
    touched = {name for name, force in largest.items() if force}
    if build is scene:
        assert touched == {"left_ball", "ball_right"}
        assert between["left_ball"][0] < 0 < between["ball_right"][0] or step.num_active
    if build is roofs:
        assert touched == {"left_ball"}
        return
    apart = largest.pop("left_right")
    assert apart < 1e-3 * min(largest.values())


@pytest.mark.at_most_two_ranks
def test_names_of_columns_do_not_depend_on_stiffness(comm, tmp_path):
    columns = []
    for stiff in (1e4, 1e5, 2e6, 5e6, 1e9):
        stepper = scene(comm, stiff)
        row = nts.Recorder(comm.bcast(tmp_path / "run"), stepper)
        columns.append([*row.diagnostics.pairs(), *row.diagnostics.between()])
    assert all(names == columns[0] for names in columns)
    assert columns[0][:2] == ["1", "2"]


@pytest.mark.at_most_two_ranks
def test_names_of_two_bodies_are_in_the_order_of_the_scene(comm):
    stepper = scene(comm)
    left, ball, _ = stepper.bodies
    for stiff in (left, ball), (ball, left):
        (pair,) = nts.all_pairs(
            stiff, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )
        assert pair.name == " and ".join(body.name for body in stiff)
        assert f"name='{pair.name}'" in repr(pair)


@pytest.mark.at_most_two_ranks
def test_own_names_are_in_texts_and_columns(comm, tmp_path):
    mesh_bodies = scene(comm).bodies
    V, tag = mesh_bodies[0].V, {body.name: body for body in mesh_bodies}
    surface = nts.boundary_of(tag["ball"], name="skin")
    floor = nts.RigidPlane((0, -1), (0, 1), name="floor")
    pair = nts.ContactPair(
        surface, floor, name="grip", enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    assert "name='skin'" in repr(surface) and "name='floor'" in repr(floor)
    assert floor.moving(nts.Motion(translation=lambda t: (0, t))).name == "floor"
    assert pair.between == "skin and floor (pair 'grip')"
    stepper = nts.EnergyMomentum(mesh_bodies, [pair], dt=0.1)
    diagnostics = nts.Diagnostics(stepper)
    assert list(diagnostics.pairs()) == ["grip"] and list(diagnostics.obstacles()) == ["floor"]
    assert diagnostics.between() == {}
    for name in (3, None):
        with pytest.raises(TypeError, match="expected a text as name"):
            nts.RigidPlane((0, -1), (0, 1), name=name)
    assert nts.Guide(slides="x", name="rail").name == "rail" and V is not None
