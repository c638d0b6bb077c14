"""Pictures of runs in two dimensions, seen along z."""

from unittest import mock

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import plotting
from dolfinx_nts.parallel import reductions
from dolfinx_nts.plotting.scene import surface_near
from helpers.models.plane import blocks, throw

pytestmark = pytest.mark.at_most_two_ranks

pytest.importorskip("pyvista")


def spied(function, *arguments, **options):
    """Draw, and return the plotter with its recorded calls, or None where nothing is drawn."""
    import pyvista

    plotters = []

    class Spy(pyvista.Plotter):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            for name in ("add_mesh", "add_arrows"):
                setattr(self, name, mock.Mock(wraps=getattr(self, name)))
            plotters.append(self)

    with mock.patch("pyvista.Plotter", Spy):
        picture = function(*arguments, **options)
    return picture, (plotters[0] if plotters else None)


@pytest.fixture
def touching():
    """Two touching blocks above a circular obstacle that only one of them touches."""
    scene = blocks("triangle")
    bodies = [scene.lower, scene.upper]
    circle = nts.RigidSphere((0.0, -1.5), 1.0)
    pairs = nts.all_pairs(
        bodies, obstacles=[circle], enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = nts.EnergyMomentum(bodies, pairs, dt=0.01)
    throw(scene, stepper)
    next(step for step in stepper.run(until=0.1) if step.num_active)
    return stepper


def has_view_along_z(plotter):
    """Whether the camera is above the plane, with y upwards."""
    position, focus, up = map(np.array, plotter.camera_position)
    view = position - focus
    return view[2] > 0 and np.abs(view[:2]).max() <= 1e-9 * view[2] and abs(up[1] - 1) <= 1e-9


def test_bodies_of_the_plane_are_drawn_with_their_obstacles(comm, touching):
    picture, plotter = spied(plotting.snapshot, touching, colour="displacement")
    V = touching.u.function_space
    if comm.rank == 0:
        assert picture.data.startswith(b"\x89PNG")
        grid, circle = (call.args[0] for call in plotter.add_mesh.call_args_list)
        assert grid.n_cells == V.mesh.topology.index_map(2).size_global
        assert circle.n_points > 0
        assert np.hypot(circle.points[:, 0], circle.points[:, 1] + 1.5).max() < 1.001
        assert has_view_along_z(plotter)


def test_contact_forces_of_the_plane_are_drawn_where_they_act(comm, touching):
    _, plotter = spied(plotting.contact, touching)
    force = touching.contacts[0].history.force
    active = reductions.total(comm, int(np.count_nonzero(force.any(axis=1))))
    assert active > 0
    total = reductions.total(comm, force.sum(axis=0))
    if comm.rank == 0:
        line, behind = (call.args[0] for call in plotter.add_mesh.call_args_list[:2])
        assert set(line.celltypes) == {3} and set(behind.celltypes) == {5}
        assert max(line["contact pressure"]) > 0
        at, forces, _ = plotter.add_arrows.call_args.args
        assert len(at) == active
        assert np.abs(forces.sum(axis=0) - total).max() <= 1e-12 * np.abs(total).max()
        assert np.abs(at[:, 1]).max() < 0.1 and has_view_along_z(plotter)


@pytest.mark.serial
def test_area_of_an_obstacle_of_the_plane_is_filled():
    points = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])
    circle = nts.RigidSphere((0.2, 0.1), 0.5)
    assert surface_near(circle, points, 0.0).area == pytest.approx(np.pi / 4, rel=5e-3)
    # A quarter of a turn about the origin.
    moving = circle.moving(nts.Motion(lambda t: (0.3 * t, 0.0), lambda t: np.pi / 2 * t))
    assert surface_near(moving, points, 1.0).center[:2] == pytest.approx([0.2, 0.2], abs=5e-3)
    line = nts.RigidPlane((0.0, 0.0), (0.0, 1.0))
    # The box has a margin of 3 % of its edge around the points.
    assert surface_near(line, points, 0.0).area == pytest.approx(2.12 * 1.06, rel=1e-6)
