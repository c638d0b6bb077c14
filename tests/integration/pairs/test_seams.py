"""Seams of floors in two pieces, over which a block slides as over one piece."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

RHO, SIZE = 1e3, (0.3, 0.15)  # kg/m^3, m
FLOOR = 0.2  # height [m]


def scene(comm, kind, method=None, friction=None):
    """A soft block on a floor of two pieces that meet at x = 0.65: tied, or rigid and held."""

    def build(model):
        parts.add_rectangle(model, "block", corner=(0.3, FLOOR), size=SIZE, cells=(4, 2))
        for name, x, length in (("left", 0.0, 0.65), ("right", 0.65, 1.0)):
            parts.add_rectangle(
                model, name, corner=(x, 0), size=(length, FLOOR), cells=(round(5 * length), 2)
            )

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(1e5, 0.3, RHO))
    pairs = []
    if kind == "tied":
        stiff = nts.NeoHookean(1e6, 0.3, RHO)
        floor = [nts.Body(V, cells, tag[name], stiff) for name in ("left", "right")]
        left, right = (nts.boundary_of(b, where=lambda x: np.isclose(x[0], 0.65)) for b in floor)
        pairs.append(nts.ContactPair(right, left, nts.Tied()))
    else:
        floor = [nts.RigidBody(V, cells, tag[n], RHO, nts.Guide()) for n in ("left", "right")]
    sides = [nts.boundary_of(block), nts.boundary_of(*floor)]
    contact = nts.ContactPair(*sides, method=method, friction=friction)
    return V, [block, *floor], [contact, *pairs]


def on_plane(V, height, value):
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], height))
    return fem.dirichletbc(value, dofs, V)


@pytest.mark.parametrize(
    ("kind", "method", "friction"),
    [
        ("tied", None, None),
        once("rigid", None, None),
        once("tied", "node-to-segment", None),
        ("rigid", "node-to-segment", None),
        once("tied", None, 0.2),
    ],
)
def test_a_block_is_dragged_over_a_seam_with_the_force_of_friction(comm, kind, method, friction):
    V, bodies, pairs = scene(comm, kind, method, friction)
    lift = fem.Constant(V.mesh, np.zeros(2))
    bcs = [on_plane(V, FLOOR + SIZE[1], lift)]
    if kind == "tied":
        bcs.append(on_plane(V, 0.0, np.zeros(2)))

    def update(t):
        lift.value[:] = 0.4 * max(t - 0.1, 0.0), -0.004 * min(10 * t, 1.0)

    stepper = nts.QuasiStatic(bodies, pairs, dt=0.05, bcs=bcs, update=update)
    for report in stepper.run(until=1.0):
        pull, push, *_ = report.reactions[0].force
        if report.t > 0.3:
            assert pull / push == pytest.approx(-(friction or 0.0), abs=3e-3)


@pytest.mark.parametrize(
    ("kind", "enforcement"), [("tied", None), once("rigid", nts.LagrangeMultiplier())]
)
def test_a_block_slides_over_a_seam_without_loss_of_speed(comm, kind, enforcement):
    V, bodies, (contact, *pairs) = scene(comm, kind)
    if enforcement is not None:
        contact = nts.ContactPair(contact.nodes, contact.segments, enforcement)
    bcs = [on_plane(V, 0.0, np.zeros(2))] if kind == "tied" else []
    gravity = nts.Gravity(bodies[:1], lambda t: (0.0, -10.0 * min(10 * t, 1.0)))
    stepper = nts.EnergyMomentum(bodies, [contact, *pairs], dt=4e-3, bcs=bcs, loads=[gravity])
    stepper.set_velocity(bodies[0], (1.0, 0.0))
    for _ in stepper.run(until=0.5):
        pass
    velocity = nts.Diagnostics(stepper).body_velocity(bodies[0])
    assert velocity[0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.serial
def test_results_of_a_pair_belong_to_the_nodes_of_its_surface(comm):
    _, bodies, (contact, *_) = scene(comm, "rigid")
    pair = nts.ContactPair(contact.segments, contact.nodes)
    stepper = nts.EnergyMomentum(bodies, [pair], dt=4e-3)
    stepper.set_velocity(bodies[0], (0.0, -1.0))
    for _ in stepper.run(until=0.02):
        pass
    pressure, gap, history = pair.pressure, pair.gap(stepper.x), pair.history
    assert len(pressure) == len(gap) == len(history.active) == len(pair.nodes.nodes)
    x, y, _ = stepper.x[pair.nodes.nodes].T
    on_top = np.isclose(y, FLOOR) & (x > 0.3) & (x < 0.6)
    assert np.all(pressure[on_top] > 0)
    in_seam = np.isclose(x, 0.65) & (y < 0.9 * FLOOR)
    assert in_seam.any() and not pressure[in_seam].any() and np.isnan(gap[in_seam]).all()


@pytest.mark.serial
def test_contact_of_the_fastened_bodies_themselves_keeps_its_facets(comm):
    # As of a crack beside the tied part of an interface.
    _, bodies, (_, tie) = scene(comm, "tied")
    left, right = (nts.boundary_of(body) for body in bodies[1:])
    crack = nts.ContactPair(right, left)
    stepper = nts.EnergyMomentum(bodies, [crack, tie], dt=4e-3)
    for pair, given in zip(stepper.pairs, (crack, tie), strict=True):
        assert pair.nodes is given.nodes and pair.segments is given.segments
