"""Tied surfaces: exact balances, comparison with a conforming mesh, patch test, refusals."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.box_meshes import boxes, distribute
from helpers.models.plane import blocks
from helpers.once import once
from helpers.scene import Motion, Scene

LAW = nts.SaintVenantKirchhoff(1e3, 0.3, 10.0, one_point=())
OMEGA = np.array([0.5, -1.0, 2.0])
METHODS = ["node-to-segment", "mortar"]


def stacked(comm, upper=(4, 4, 2), gap=0.0, motion=None):
    """Two stacked boxes of 0.5 m; the lower one has 3 x 3 x 2 cells."""
    motion = motion or Motion.none()
    data = boxes([(3, 3, 2), upper], [(1.0, 1.0, 0.5)] * 2)
    data.X[np.unique(data.cells[data.body == 1])] += [0, 0, 0.5 + gap]
    mesh, cells, facets, tag = distribute(comm, data)
    mesh.geometry.x[:] = motion(mesh.geometry.x)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.Body(V, cells, tag[f"body {i}"], LAW) for i in (0, 1)]
    surfaces = [nts.Surface(V, facets, tag[name]) for name in ("bottom 1", "top 0")]
    return bodies, surfaces, facets, tag


def tearing(X):
    """Velocity of spinning boxes whose upper parts are pulled to the side."""
    return np.cross(OMEGA, X.T).T + np.array([0 * X[0], 3 * X[2] ** 2, 2 * X[0] * X[2]])


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("method", ["node-to-segment", once("mortar")])
def test_tie_keeps_energy_and_momenta_while_it_pulls(comm, agree, method):
    motion = Motion.random(np.random.default_rng(3))
    bodies, surfaces, *_ = stacked(comm, gap=2e-3, motion=motion)
    pair = nts.ContactPair(*surfaces, nts.Tied(), method=method)
    stepper = nts.EnergyMomentum(bodies, [pair], dt=0.01)
    for body in bodies:
        stepper.set_velocity(body, lambda X: motion.Q @ tearing(motion.Q.T @ X))
    diagnostics = nts.Diagnostics(stepper)
    first = diagnostics.balance()
    pulls = 0.0
    for _ in range(25):
        report = stepper.advance()
        assert report.num_active == 25 and abs(sum(report.contact_work)) < 1e-11
        history = pair.history
        normal = np.einsum("ni,ni->n", history.force, history.normal)
        pulls = min(pulls, comm.allreduce(normal.min(initial=0.0), op=MPI.MIN))
    last = diagnostics.balance()
    assert pulls < -1.0
    assert abs(last.total_energy / first.total_energy - 1) < 1e-12
    assert last.strain_energy > 0.01 * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        assert np.linalg.norm(after - before) < 1e-11 * np.linalg.norm(before)
    if method == METHODS[0]:
        gap = pair.gap(stepper.x)
        assert agree(np.abs(gap - 2e-3).max(initial=0.0) < 1e-12)
    assert stepper.statistics.solver.num_direct == 0


@pytest.mark.serial
@pytest.mark.parametrize("method", METHODS)
def test_tied_boxes_of_matching_meshes_are_one_body(comm, method):
    bodies, surfaces, *_ = stacked(comm, upper=(3, 3, 2))
    tied = nts.EnergyMomentum(
        bodies, [nts.ContactPair(*surfaces, nts.Tied(), method=method)], dt=0.01
    )
    mesh, cells, _, tag = distribute(comm, boxes([(3, 3, 4)], [(1.0, 1.0, 1.0)]))
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    whole = nts.Body(V, cells, tag["body 0"], LAW)
    one = nts.EnergyMomentum([whole], dt=0.01)
    one.set_velocity(whole, tearing)
    for body in bodies:
        tied.set_velocity(body, tearing)
    for _ in range(20):
        tied.advance()
        one.advance()
    X, Y = (s.u.function_space.tabulate_dof_coordinates() for s in (tied, one))
    same = np.linalg.norm(X[:, None] - Y[None], axis=2).argmin(axis=1)
    assert np.abs(X - Y[same]).max() < 1e-12
    assert np.abs(tied.x - tied.x.mean(axis=0)).max() > 0.5
    assert np.abs(tied.x - one.x[same]).max() < 1e-10


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(("method", "tol"), [("mortar", 1e-11), once("node-to-segment", None)])
def test_mortar_tie_passes_the_patch_test_in_tension(comm, agree, method, tol):
    bodies, surfaces, facets, tag = stacked(comm)
    V = bodies[0].V
    bcs = []
    for axis in range(3):
        at = fem.locate_dofs_geometrical(
            (V.sub(axis), V.sub(axis).collapse()[0]), lambda x, axis=axis: np.isclose(x[axis], 0)
        )
        bcs.append(fem.dirichletbc(0.0, at[0], V.sub(axis)))
    pull = nts.Traction(nts.Surface(V, facets, tag["top 1"]), (0, 0, 5.0))
    pair = nts.ContactPair(*surfaces, nts.Tied(), method=method)
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, loads=[pull])
    assert stepper.advance().newton_iterations < 6
    X, u = V.tabulate_dof_coordinates(), stepper.u.x.array.reshape(-1, 3)
    top = comm.allreduce(u[np.isclose(X[:, 2], 1)].max(initial=-1.0), op=MPI.MAX)
    side = comm.allreduce(u[np.isclose(X[:, 0], 1), 0].max(initial=-1.0), op=MPI.MAX)
    strain = np.array([side, side, top])
    error = comm.allreduce(np.abs(u - strain * X).max(initial=0.0), op=MPI.MAX) / top
    assert top > 0.004
    assert error < tol if tol else 1e-3 < error < 0.1


@pytest.mark.serial
def test_tie_in_the_plane(comm):
    scene = blocks("triangle", angle=0.4)
    pair = nts.ContactPair(
        scene.nodes, scene.segments, nts.Tied(reach=0.1), method="node-to-segment"
    )
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.002)
    turn = scene.turn
    stepper.set_velocity(scene.upper, lambda X: turn @ np.array([0 * X[0], 2 + 0 * X[0]]))
    diagnostics = nts.Diagnostics(stepper)
    first = diagnostics.balance()
    for _ in range(25):
        assert stepper.advance().num_active == 4
    last = diagnostics.balance()
    assert abs(last.total_energy / first.total_energy - 1) < 1e-12
    assert diagnostics.body_velocity(scene.lower) @ turn[:, 1] > 0.1


def test_tie_is_the_same_on_any_number_of_ranks_and_resumed(comm, agree, tmp_path):
    folder = comm.bcast(tmp_path)

    def scene(on):
        bodies, surfaces, *_ = stacked(on)
        pair = nts.ContactPair(*surfaces, nts.Tied(), method="mortar")
        stepper = nts.EnergyMomentum(bodies, [pair], dt=0.01)
        for body in bodies:
            stepper.set_velocity(body, tearing)
        return stepper

    alone = scene(MPI.COMM_SELF)
    for _ in alone.run(until=0.08):
        pass
    for num_steps in (4, 8):
        here = scene(comm)
        with nts.Recorder(folder / "run", here, checkpoint_every=2, resume=True) as recorder:
            for step in here.run(until=num_steps * here.dt):
                recorder.write(step)
    there, other = (Scene(each, {}, ()).positions() for each in (here, alone))
    assert agree(np.abs(there - other).max() < 1e-10)


@pytest.mark.at_most_two_ranks
def test_bad_ties_are_refused(comm, refused):
    bodies, surfaces, *_ = stacked(comm, gap=0.1)
    with refused(ValueError, "no friction, as tied nodes never slide"):
        nts.ContactPair(*surfaces, nts.Tied(), nts.Coulomb(mu=0.3))
    with refused(ValueError, "a Surface as segments, given RigidPlane"):
        nts.ContactPair(
            surfaces[0], nts.RigidPlane((0, 0, 0), (0, 0, 1)), nts.Tied(), method="node-to-segment"
        )
    with refused(ValueError, "two surfaces, given one that touches itself"):
        nts.ContactPair(surfaces[0], surfaces[0], nts.Tied(), method="node-to-segment")
    with refused(ValueError, "reach of a tie"):
        nts.Tied(reach=0.0)
    pair = nts.ContactPair(*surfaces, nts.Tied())
    with refused(ValueError, r"within 0.05 of the size .* given none to tie"):
        nts.EnergyMomentum(bodies, [pair], dt=0.01).advance()
    with refused(ValueError, r"GeneralizedAlpha, given Tied\(reach=0.05\)"):
        nts.GeneralizedAlpha(bodies, [pair], dt=0.01)
    with refused(ValueError, "Penalty.*given Tied"):
        nts.CentralDifference(bodies, [pair])
