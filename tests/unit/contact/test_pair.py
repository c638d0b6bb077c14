"""Contact of a pair: evaluation, active set, history, gap and pressure."""

import re
from dataclasses import fields

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.implicit.accepted_contact import contact_history, contact_work
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.pair_state import PairState
from helpers import scenes
from helpers.models import box_meshes
from helpers.once import once
from helpers.scenes import BLOCK_STEP
from reference import nts as reference

EPS = np.finfo(float).eps
# Round-off of sums of forces of order one on lengths of order one.
ROUNDING = 1e3 * EPS
# Newton's tolerance of gaps, cells of size 0.4 [m].
CLOSED = 1e-10

cells_ = pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
schemes = pytest.mark.parametrize("scheme", ["midpoint", "conserving"])
DT = 0.04  # several nodes pass through the surface in such a step


def attempt(scene, scheme, *, weight=1.0):
    """Return an attempt at a step, and owned positions at its end."""
    stepper = scene.stepper
    (contact,) = stepper.contacts
    x_n = stepper.x
    x_trial = x_n + DT * stepper.v.x.array.reshape(-1, 3)
    owned = stepper.u.function_space.dofmap.index_map.size_local
    step = ContactStep(contact, scheme, x_n, x_trial, np.full(owned, weight))
    return step, x_trial[:owned], x_n[:owned]


def pressed(step, x, iteration=1):
    """Evaluate with a compressive multiplier at every eligible node."""
    step.normal.lambda_N[:] = -1.0
    return step.evaluate(x, None, iteration)


def copy(history):
    return {field.name: getattr(history, field.name).copy() for field in fields(history)}


def same(history, before):
    return all(np.array_equal(getattr(history, name), value) for name, value in before.items())


@cells_
@schemes
def test_forces_of_every_pair_are_in_equilibrium(comm, cell, scheme):
    # Their sum, and their moment about the origin at the midpoint, vanish.
    scene = scenes.blocks(comm, cell=cell)
    step, x, x_n = attempt(scene, scheme, weight=0.0)
    state = pressed(step, x)
    force = state.force.reshape(*state.pairs.dofs.shape, 3)
    candidates = step.candidates
    x_mid = (candidates.scatter.forward(x) + candidates.scatter.forward(x_n)) / 2
    moment = np.cross(x_mid[state.pairs.dofs], force).sum(axis=1)
    worst = max(np.abs(force.sum(axis=1)).max(initial=0), np.abs(moment).max(initial=0))
    assert comm.allreduce(worst, op=MPI.MAX) <= ROUNDING
    assert comm.allreduce(np.count_nonzero(np.abs(force[:, 0]).max(axis=1) > 0.3)) >= 3


@cells_
@schemes
def test_nodal_forces_of_all_ranks_sum_to_zero(comm, cell, scheme):
    scene = scenes.blocks(comm, cell=cell)
    step, x, x_n = attempt(scene, scheme, weight=0.0)
    state = pressed(step, x)
    candidates = step.candidates
    local = np.zeros((candidates.scatter.num_local, 3))
    np.add.at(local, state.pairs.dofs.ravel(), state.residual.reshape(-1, 3))
    total = candidates.scatter.reverse(local)
    largest = comm.allreduce(np.abs(total).max(initial=0), op=MPI.MAX)
    sums = comm.allreduce(np.concatenate([total.sum(0), np.cross((x + x_n) / 2, total).sum(0)]))
    assert np.abs(sums).max() <= ROUNDING * largest
    assert largest > 0.5


@pytest.mark.at_most_two_ranks
@schemes
def test_energy_momentum_force_works_with_the_change_of_the_gap(comm, scheme):
    # The discrete gradient does so exactly, the midpoint one does not.
    scene = scenes.blocks(comm)
    step, x, x_n = attempt(scene, scheme, weight=0.0)
    state = pressed(step, x)
    candidates = step.candidates
    x, x_n = (candidates.scatter.forward(y)[state.pairs.dofs] for y in (x, x_n))
    signs = candidates.orientation[state.pairs.segment]
    change = _kernels.project(x, signs)[1] - _kernels.project(x_n, signs)[1]
    work = np.einsum("ij,ij->i", state.force, (x - x_n).reshape(state.force.shape))
    defect = comm.allreduce(np.abs(work + change).max(initial=0), op=MPI.MAX)
    if scheme == "conserving":
        assert defect <= ROUNDING
    else:
        assert defect > 1e3 * ROUNDING


@pytest.mark.at_most_two_ranks
def test_evaluation_leaves_the_history_untouched(comm, agree):
    scene = scenes.blocks(comm)
    scene.run(4)
    (pair,) = scene.stepper.pairs
    before = copy(pair.history)
    step, x, _ = attempt(scene, "conserving")
    for iteration in range(3):
        state = step.evaluate(x, None, iteration)
        step.normal.lambda_N[state.pairs.node] -= 1.0
    history = contact_history(step, state)
    contact_work(step, state, history, history.force)
    assert agree(same(pair.history, before))
    assert comm.allreduce(np.count_nonzero(pair.history.active)) > 0


def test_penetrating_nodes_are_active_first_then_nodes_under_pressure(comm):
    scene = scenes.blocks(comm)
    step, x, _ = attempt(scene, "conserving", weight=0.0)
    state = step.evaluate(x, None, 0)
    wrong = np.count_nonzero(state.active != (state.pairs.excess[:, 0] < 0))
    number = comm.allreduce(np.count_nonzero(state.active))
    assert comm.allreduce(wrong) == 0
    assert number == step.num_active >= 3
    # With no weight on the gap the sign of the multiplier decides.
    one = state.pairs.node[:1]
    step.normal.lambda_N[state.pairs.node] = -1.0
    step.normal.lambda_N[one] = 2.0
    state = step.evaluate(x, None, 1)
    pulls = state.pairs.node == one if len(one) else np.zeros(len(state.pairs.node), dtype=bool)
    assert comm.allreduce(np.count_nonzero(state.active != ~pulls)) == 0
    assert comm.allreduce(np.count_nonzero(step.normal.lambda_N[state.pairs.node[pulls]])) == 0
    assert step.num_active == comm.allreduce(np.count_nonzero(state.active))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("value", [np.nan, 1.0])
def test_pair_that_could_not_be_evaluated_is_counted_active_or_not(comm, monkeypatch, value):
    # A node with a NaN gap must be reported.
    step, x, _ = attempt(scenes.blocks(comm), "conserving")
    kernel = step.candidates.contact

    def contact(*args):
        found = kernel(*args)
        gap_n, gap, turn = (np.full_like(found.gap, of) for of in (value, value, np.nan))
        return found._replace(gap_n=gap_n, gap=gap, turn=turn)

    monkeypatch.setattr(step.candidates, "contact", contact)
    state = step.evaluate(x, None, 0)
    assert step.num_active == 0
    assert state.failed == (len(state.pairs.node) if np.isnan(value) else 0)
    assert comm.allreduce(len(state.pairs.node)) >= 3


def test_changes_of_the_set_are_counted(comm):
    scene = scenes.blocks(comm)
    step, x, _ = attempt(scene, "conserving", weight=0.0)
    first = step.evaluate(x, None, 0)
    step.normal.lambda_N[first.pairs.node] = np.where(first.active, -1.0, 0.0)
    again = step.evaluate(x, None, 1)
    assert comm.allreduce(again.changed) == 0
    released = np.flatnonzero(again.active)[:1]
    step.normal.lambda_N[again.pairs.node[released]] = 1.0
    third = step.evaluate(x, None, 2)
    assert comm.allreduce(third.changed) == comm.allreduce(len(released)) > 0


def test_cycling_active_sets_end_in_changes_of_the_lowest_node_alone(comm):
    # Every node violates its condition in every iteration.
    scene = scenes.blocks(comm)
    step, x, _ = attempt(scene, "conserving", weight=0.0)
    state = step.evaluate(x, None, 0)
    ids = scene.stepper.pairs[0].nodes.node_ids
    changed = []
    for iteration in range(1, 30):
        before = step.normal.active.copy()
        step.normal.lambda_N[state.pairs.node] = np.where(before[state.pairs.node], 1.0, -1.0)
        step.evaluate(x, None, iteration)
        changed.append(np.concatenate(comm.allgather(ids[before != step.normal.active])).tolist())
    lowest = comm.allreduce(ids[state.pairs.node].min(initial=10**9), op=MPI.MIN)
    assert len(changed[0]) > 1
    # One in three iterations; Newton's method converges in the others.
    assert sorted(changed[-3:]) == sorted(changed[-6:-3]) == [[], [], [lowest]]


@pytest.mark.at_most_two_ranks
def test_multipliers_balance_the_residual_along_the_normal(comm, rng):
    scene = scenes.blocks(comm)
    step, x, _ = attempt(scene, "conserving")
    R = rng.normal(size=x.shape)
    state = step.evaluate(x, R, 0)
    forces = R[state.pairs.dofs[:, 0]] + state.force[:, :3]
    normal = state.pairs.gradients[:, 0, :3]
    left = np.abs(np.einsum("ij,ij->i", forces, normal))[state.active]
    idle = np.abs(state.force[~state.active]).max(initial=0)
    assert comm.allreduce(left.max(initial=0), op=MPI.MAX) <= ROUNDING
    assert comm.allreduce(idle, op=MPI.MAX) == 0


def test_accepted_history_holds_pushing_forces_along_the_normals(comm, agree):
    scene = scenes.blocks(comm)
    scene.run(4)
    (pair,) = scene.stepper.pairs
    history = pair.history
    assert agree(np.all(history.lambda_N <= 0))
    assert agree(np.all(history.active == (history.lambda_N < 0)))
    assert agree(np.all(history.key[history.active] >= 0))
    size = np.linalg.norm(history.force, axis=1)
    # The direction is a mean over the step: nearly a unit vector.
    assert agree(np.allclose(size, -history.lambda_N, rtol=1e-2))
    up = history.force[history.active][:, 2]
    assert agree(np.all(up > 0))
    np.testing.assert_allclose(pair.pressure * pair.nodes.area, -history.lambda_N, rtol=ROUNDING)
    # Nearly all facets that the nodes touch are flat.
    facing = history.gap < np.inf
    assert agree(np.allclose(np.linalg.norm(history.normal[history.active], axis=1), 1, ROUNDING))
    assert agree(np.all(history.normal[history.active][:, 2] > 0.99))
    assert agree(not history.normal[~facing].any())
    assert comm.allreduce(np.count_nonzero(history.active)) >= 3


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("scheme", "law", "friction"),
    [
        (nts.EnergyMomentum, nts.LagrangeMultiplier(), None),
        once(nts.Midpoint, nts.Penalty(), nts.Coulomb(0.3)),
        once(nts.CentralDifference, nts.Penalty(), None),
        (nts.CentralDifference, nts.Penalty(), nts.Coulomb(0.3)),
    ],
)
def test_accepted_normal_is_the_gradient_of_the_gap(comm, scheme, law, friction):
    old = scenes.blocks(comm).stepper
    pair = nts.ContactPair(
        old.pairs[0].nodes, old.pairs[0].segments, law, friction, method="node-to-segment"
    )
    explicit = scheme is nts.CentralDifference
    stepper = scheme(old.bodies, [pair], dt=BLOCK_STEP / (4 if explicit else 1))
    for body in old.bodies:
        stepper.set_velocity(body, old.v)
    while stepper.advance().num_active < 3:
        pass
    history, x, h = pair.history, stepper.x, 1e-6
    slope = []
    for direction in np.eye(3):
        ends = []
        for sign in (-1, 1):
            moved = x.copy()
            moved[pair.nodes.nodes] += sign * h * direction
            ends.append(pair.gap(moved))
        slope.append((ends[1] - ends[0]) / (2 * h))
    expected = np.column_stack(slope)[history.active]
    np.testing.assert_allclose(history.normal[history.active], expected, atol=1e-7)
    assert comm.allreduce(len(expected)) >= 3


def gaps_of_active_nodes(comm, impact):
    """Gaps of the active nodes before and after each step."""
    scene = scenes.blocks(comm, nts.EnergyMomentum, nts.LagrangeMultiplier(impact))
    (pair,) = scene.stepper.pairs
    found = []
    for _ in range(6):
        gap_n, key_n = pair.gap(scene.stepper.x), pair.history.key
        scene.stepper.advance()
        held = pair.history.active & ((key_n == pair.history.key) | (key_n < 0))
        found.append(np.column_stack([gap_n, pair.gap(scene.stepper.x)])[held])
    return np.concatenate(comm.allgather(np.concatenate(found)))


@pytest.mark.at_most_two_ranks
def test_plastic_impact_closes_the_gap(comm):
    gaps = gaps_of_active_nodes(comm, "plastic")
    assert len(gaps) > 5
    assert np.abs(gaps[:, 1]).max() <= CLOSED


@pytest.mark.at_most_two_ranks
def test_elastic_impact_keeps_the_gap_with_which_a_node_came(comm):
    gaps = gaps_of_active_nodes(comm, "elastic")
    assert len(gaps) > 5
    assert np.abs(gaps[:, 1] - gaps[:, 0]).max() <= CLOSED
    assert np.abs(gaps).max() > 1e-4


@cells_
def test_gap_of_every_node_is_that_to_the_nearest_segment(comm, cell):
    scene = scenes.blocks(comm, cell=cell)
    (pair,) = scene.stepper.pairs
    x = scene.stepper.x
    parts = comm.allgather((x[pair.segments.segments], pair.segments.orientation))
    segments = np.concatenate([p[0] for p in parts])
    signs = np.concatenate([p[1] for p in parts])
    wrong = 0
    for node, gap in zip(x[pair.nodes.nodes], pair.gap(x), strict=True):
        found = [
            reference.project(np.vstack((node, segment)), sign)
            for segment, sign in zip(segments, signs, strict=True)
        ]
        over = [g for xi, g, *_ in found if xi.min() > -0.01 and _outside(xi, cell) < 0.01]
        wrong += not np.abs(np.array(over) - gap).min() <= ROUNDING
    assert comm.allreduce(wrong) == 0


def _outside(xi, cell):
    return xi.sum() - 1 if cell == "tetrahedron" else xi.max() - 1


@pytest.mark.at_most_two_ranks
def test_gap_beyond_the_surface_is_not_a_number(comm, agree):
    scene = scenes.blocks(comm)
    (pair,) = scene.stepper.pairs
    x = scene.stepper.x.copy()
    x[pair.nodes.nodes] += [5.0, 0, 0]
    assert agree(np.isnan(pair.gap(x)).all())


@pytest.mark.at_most_two_ranks
def test_pair_refuses_wrong_arguments(comm, refused):
    data = box_meshes.boxes([(2, 2, 1), (1, 1, 1)], [(1.0, 1.0, 0.5), (0.5, 0.5, 0.3)])
    data.surfaces["overlap"] = np.union1d(data.surfaces["top 0"], data.surfaces["bottom 1"])
    mesh, _, facets, tag = box_meshes.distribute(comm, data)
    V, W = (fem.functionspace(mesh, ("Lagrange", 1, (3,))) for _ in range(2))
    side = nts.Surface(V, facets, tag["top 1"])
    lower = nts.Surface(V, facets, tag["bottom 0"])
    with refused(TypeError, r"Surface as nodes, such as boundary_of\(body\), given int"):
        nts.ContactPair(3, lower, enforcement=nts.LagrangeMultiplier(), method="node-to-segment")
    with refused(TypeError, "or an obstacle as segments, given NoneType"):
        nts.ContactPair(side, None, enforcement=nts.LagrangeMultiplier(), method="node-to-segment")
    with refused(TypeError, "given str"):
        nts.ContactPair(side, lower, "elastic", method="node-to-segment")
    with refused(ValueError, "one function space, given two"):
        nts.ContactPair(
            side,
            nts.Surface(W, facets, tag["bottom 0"]),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )


def test_surfaces_that_share_an_edge_are_refused(comm, refused):
    data = box_meshes.boxes([(2, 2, 1)], [(1.0, 1.0, 0.5)])
    X = data.X
    data.surfaces["left 0"] = np.flatnonzero(X[:, 0] == 0)
    mesh, _, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    with refused(ValueError, "without common nodes in a contact pair, .*given 3 nodes on both"):
        nts.ContactPair(
            nts.Surface(V, facets, tag["left 0"]),
            nts.Surface(V, facets, tag["top 0"]),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )


def test_the_contact_of_a_step_is_computed_once(comm):
    (old,) = scenes.blocks(comm).stepper.pairs
    contact, made = (
        PairState(
            nts.ContactPair(
                old.nodes,
                old.segments,
                enforcement=nts.LagrangeMultiplier(),
                method="node-to-segment",
            )
        ),
        [],
    )

    def history():
        made.append(ContactHistory.none(len(old.nodes.nodes)))
        return made[-1]

    contact.accept(history)
    assert not made  # most steps are not described
    assert contact.history is contact.history is made[0]
    assert len(made) == 1


def test_text_of_a_pair_has_the_stiffness_of_its_springs(comm, caplog):
    (old,) = scenes.blocks(comm).stepper.pairs
    pair = nts.ContactPair(
        old.nodes,
        old.segments,
        nts.Penalty(),
        nts.Coulomb(0.3, eps_T=250.0),
        method="node-to-segment",
    )
    assert str(pair) == "contact by Penalty, Coulomb friction with mu = 0.3"
    stiffness = 100.0 + pair.nodes.node_ids
    contact = PairState(pair)
    with caplog.at_level("INFO", logger="dolfinx_nts"):
        contact.choose_penalty(10 * stiffness, stiffness)
        contact.choose_penalty(2 * stiffness, stiffness)  # too late
    everywhere = 10 * np.concatenate(comm.allgather(stiffness))
    assert str(pair) == (
        "contact by Penalty, Coulomb friction with mu = 0.3, "
        f"eps_N = {everywhere.min():.3g} to {everywhere.max():.3g} N/m, eps_T = 250 N/m"
    )
    np.testing.assert_array_equal(contact.eps_N, 10 * stiffness)
    assert caplog.messages == ([str(pair)] if comm.rank == 0 else [])


@pytest.mark.at_most_two_ranks
def test_text_of_a_pair_has_its_surfaces_and_laws_in_one_line(comm, agree):
    (old,) = scenes.blocks(comm).stepper.pairs
    printed = []
    for surface in (old.nodes, old.segments):
        nodes, segments = len(surface.nodes), len(surface.segments)
        tail = f", name={surface.name!r}, owned_nodes={nodes}, owned_segments={segments})"
        assert agree(re.fullmatch(rf"Surface\(tag=\d+{re.escape(tail)}", repr(surface)))
        printed.append(repr(surface))
    pair = nts.ContactPair(
        old.nodes, old.segments, nts.Penalty(50), nts.Coulomb(0.3), method="node-to-segment"
    )
    assert agree(
        repr(pair) == f"ContactPair(nodes={printed[0]}, segments={printed[1]}, "
        "enforcement=Penalty(eps_N=50), friction=Coulomb(mu=0.3, eps_T=None, law='objective'), "
        "method='node-to-segment')"
    )
    pair = nts.ContactPair(
        old.nodes,
        nts.RigidSphere((0, 0, 9), 1),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    assert agree(
        repr(pair) == f"ContactPair(nodes={printed[0]}, "
        "segments=RigidSphere(centre=(0, 0, 9), radius=1, hollow=False), "
        "enforcement=LagrangeMultiplier(impact='elastic'), friction=None, "
        "method='node-to-segment')"
    )


def box_on_a_wall(comm, scheme, dt):
    """Stepper of a cell of edges 0.2 m, E = 9 Pa and nu = 0 on springs, after a step."""
    mesh, cells, facets, tag = box_meshes.distribute(
        comm, box_meshes.boxes([(1, 1, 1)], [(0.2, 0.2, 0.2)])
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    box = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(9.0, 0.0, 1e3))
    wall = nts.RigidPlane((0, 0, -1), (0, 0, 1))
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["bottom 0"]), wall, nts.Penalty(), method="node-to-segment"
    )
    clamp = fem.dirichletbc(np.zeros(3), fem.locate_dofs_geometrical(V, lambda x: x[2] > 0.1), V)
    stepper = scheme([box], [pair], dt=dt, bcs=[clamp])
    stepper.advance()
    return stepper


@pytest.mark.parametrize(
    ("scheme", "dt"),
    [
        (nts.EnergyMomentum, 1.0),
        once(nts.EnergyMomentum, 1e-4),
        once(nts.Midpoint, 1e-2),
        once(nts.GeneralizedAlpha, 1e-2),
    ],
)
def test_default_springs_have_three_fifths_of_the_stiffness_of_their_cells(comm, agree, scheme, dt):
    (contact,) = box_on_a_wall(comm, scheme, dt).contacts
    # A quarter of E A/h, whatever the step.
    assert agree(contact.eps_N == pytest.approx(0.6 * 9.0 * 0.2**2 / 0.2 / 4, rel=1e-9))
    assert agree("eps_N = " in str(contact))


def test_default_springs_of_statics_have_ten_times_the_stiffness_of_their_nodes(comm, agree):
    (contact,) = box_on_a_wall(comm, nts.QuasiStatic, 1.0).contacts
    # Integral of E (N,x^2 + N,y^2/2 + N,z^2/2) over the only cell at a node.
    assert agree(contact.eps_N == pytest.approx(10 * 9.0 * 0.2 * 2 / 9, rel=1e-9))


@pytest.mark.at_most_two_ranks
def test_exact_contact_has_no_springs(comm):
    scene = scenes.blocks(comm)
    scene.run(1)
    assert str(scene.stepper.pairs[0]) == "contact by LagrangeMultiplier"


def test_pair_never_changes_and_answers_for_one_stepper_alone(comm, agree, refused):
    scene = scenes.blocks(comm)
    (pair,), bodies = scene.stepper.pairs, scene.stepper.bodies
    with pytest.raises(AttributeError, match=r"of a ContactPair .* a new value of friction"):
        pair.friction = nts.Coulomb(0.3)
    assert agree(pair.history is scene.stepper.contacts[0].history)
    other = nts.EnergyMomentum(bodies, scene.stepper.pairs, dt=BLOCK_STEP)
    for question in (lambda: pair.history, lambda: pair.pressure, lambda: pair.gap(other.x)):
        with refused(ValueError, "one stepper, given one of 2 steppers: use the item of"):
            question()
    assert str(pair) == "contact by LagrangeMultiplier"
    unused = nts.ContactPair(
        pair.nodes, pair.segments, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    with refused(ValueError, "given one of 0"):
        unused.history  # noqa: B018 (it is a property)


@pytest.mark.serial
@pytest.mark.parametrize("law", ["elastic", "penalty", "friction", "explicit"])
def test_steppers_that_share_their_pairs_do_not_disturb_each_other(comm, agree, law):
    enforcement = nts.LagrangeMultiplier() if law == "elastic" else nts.Penalty()
    friction = nts.Coulomb(0.3) if law in ("friction", "explicit") else None
    scheme = nts.CentralDifference if law == "explicit" else nts.EnergyMomentum
    old = scenes.blocks(comm, num_bodies=3).stepper
    pairs = [
        nts.ContactPair(p.nodes, p.segments, enforcement, friction, method="node-to-segment")
        for p in old.pairs
    ]
    dt = 0.1 * BLOCK_STEP if law == "explicit" else BLOCK_STEP

    def steppers():
        """Yield two whose bodies meet with different speeds."""
        for factor in (1.0, 1.3):
            stepper, v = scheme(old.bodies, pairs, dt=dt), old.v.copy()
            v.x.array[:] *= factor
            for body in old.bodies:
                stepper.set_velocity(body, v)
            yield stepper

    num_steps, touched = 60 if law == "explicit" else 12, [0, 0]
    alone = []
    for i, stepper in enumerate(steppers()):
        for _ in range(num_steps):
            touched[i] += stepper.advance().num_active
        alone.append(stepper)
    assert min(touched) > 0
    together = list(steppers())
    for _ in range(num_steps):
        for stepper in together:
            stepper.advance()
    for one, other in zip(alone, together, strict=True):
        assert agree(np.array_equal(one.u.x.array, other.u.x.array))
        assert agree(np.array_equal(one.v.x.array, other.v.x.array))
        for contact, twin in zip(one.contacts, other.contacts, strict=True):
            assert agree(same(contact.history, copy(twin.history)))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.Midpoint), nts.CentralDifference])
def test_contact_goes_with_its_stepper(comm, agree, scheme):
    # Without a collection of garbage: nothing in a stepper refers back to it.
    enforcement = nts.Penalty() if scheme is nts.CentralDifference else None
    scene = scenes.blocks(comm, scheme, enforcement, dt=1e-3)
    scene.stepper.advance()
    (pair,), bodies = scene.stepper.pairs, scene.stepper.bodies
    del scene
    other = scheme(bodies, [pair], dt=1e-3)
    assert agree(pair.history is other.contacts[0].history)
