"""The condensed contact against the paper's full mixed system.

Two small bodies collide; the mixed system (``reference/mixed.py``) and
a condensed Newton method around the kernel are solved for the same
steps. Local: one rank does it.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from dolfinx_nts import _kernels
from reference import mixed, nts
from reference.bulk import Bulk, box, rotation, taylor_order

pytestmark = pytest.mark.serial

# Lengths of order one. Both systems are solved until Newton's update is
# below 1e-13; multipliers, relative to the largest, see that change of
# the positions times stiffness over contact force, about 100.
POSITION_TOLERANCE = 1e-12
MULTIPLIER_TOLERANCE = 1e-10
# Tolerance of momenta and energy, relative to the energy at the start.
BALANCE_TOLERANCE = 1e-11

segments = pytest.mark.parametrize("k", [3, 4], ids=["triangle", "quadrilateral"])
impacts = pytest.mark.parametrize("impact", ["plastic", "elastic"])


@dataclass
class Scene:
    """Two bodies, with the contact nodes of one and the segments of the other."""

    bulk: Bulk
    x: np.ndarray
    v: np.ndarray
    nodes: np.ndarray
    segments: np.ndarray
    orientation: np.ndarray
    dt: float


def colliding_blocks(k):
    """Return a turned, twisted block that falls on another one.

    Only eight hexahedra, in arbitrary position. Every other segment has
    its first two edges swapped, so that both orientations occur.
    """
    lower_X, lower_cells = box((2, 2, 1), (1.2, 1.2, 0.5))
    upper_X, upper_cells = box((2, 2, 1), (0.8, 0.8, 0.4))
    X = np.vstack((lower_X, upper_X))
    num = len(lower_X)
    bulk = Bulk(X, np.vstack((lower_cells, num + upper_cells)), lmbda=500.0, mu=400.0, rho=10.0)
    x, v = X.copy(), np.zeros_like(X)
    centred, tilt = upper_X - [0.4, 0.4, 0], rotation([1, 0.3, 0], 0.1)
    for point, (a, b, c) in zip(x[num:], centred, strict=True):
        point[:] = tilt @ rotation([0, 0, 1], 0.5 + 0.2 * c) @ [a, b, c + 0.04 * a * b]
    x[num:] += [0.63, 0.57, 0.55]
    x[:num, 2] += 0.03 * (x[:num, 0] - 0.6) * (x[:num, 1] - 0.6)
    v[num:] = np.cross([0.3, -0.2, 1.5], x[num:] - [0.6, 0.6, 0.7]) - [0.2, 0.1, 1.5]
    turn = rotation([1, 2, 0.5], 0.9)

    top = lower_cells[:, 4:].copy()
    top[::2] = top[::2][:, [0, 2, 1, 3]]
    orientation = np.where(np.arange(len(top)) % 2, 1.0, -1.0)
    if k == 3:  # the same diagonal seen from both halves
        top = np.concatenate((top[:, [0, 1, 2]], top[:, [3, 2, 1]]))
        orientation = np.tile(orientation, 2)
    nodes = num + np.unique(upper_cells[:, :4])
    return Scene(bulk, x @ turn.T, v @ turn.T, nodes, top, orientation, 0.02)


def choose_contacts(scene, x_n, v_n, impact):
    """Pair every node with the segment it will hit and fix the references.

    The pair is found at the ballistic positions. Elastic: a node is
    eligible if it penetrates or would penetrate ballistically.
    """
    k = scene.segments.shape[1]
    trial = x_n + scene.dt * v_n
    pairs, orientation = [], []
    for node in scene.nodes:
        candidates = [np.vstack((trial[node], trial[segment])) for segment in scene.segments]
        found = [nts.project(p, s) for p, s in zip(candidates, scene.orientation, strict=True)]
        outside = [max(*-xi, xi.sum() - 1 if k == 3 else xi.max() - 1) for xi, *_ in found]
        best = int(np.argmin(outside))
        pairs.append([node, *scene.segments[best]])
        orientation.append(scene.orientation[best])
    pairs, orientation = np.array(pairs), np.array(orientation)
    reference = np.zeros(len(pairs))
    if impact == "elastic":
        gap_n, gap = (_kernels.project(x[pairs], orientation)[1] for x in (x_n, trial))
        eligible = (gap_n <= 0) | (gap < 0)
        reference = np.where(eligible, gap_n, -np.inf)
    return mixed.Contacts(pairs, orientation, reference, scale=1e3)


def solve_condensed(bulk, contacts, x_n, x_start):
    """Return positions and normal multipliers of the condensed system."""
    num, x = x_n.size, x_start.copy()
    multipliers = np.zeros(len(contacts.pairs))
    dofs = (3 * contacts.pairs[:, :, None] + np.arange(3)).reshape(len(contacts.pairs), -1)
    for _ in range(40):
        _, gap, force, gradient, tangent, turn = _kernels.contact_conserving(
            x_n[contacts.pairs], x[contacts.pairs], contacts.orientation
        )
        assert not np.isnan(turn).any()
        excess = gap - contacts.slack_reference
        active = np.flatnonzero(-multipliers - contacts.scale * excess > 0)
        multipliers[np.setdiff1d(np.arange(len(multipliers)), active)] = 0
        R, K = bulk(x)
        F, G = np.zeros((num, len(active))), np.zeros((len(active), num))
        for column, s in enumerate(active):
            F[dofs[s], column], G[column, dofs[s]] = force[s], gradient[s]
            K[np.ix_(dofs[s], dofs[s])] += multipliers[s] * tangent[s]
        system = np.block([[K, F], [G, np.zeros((len(active), len(active)))]])
        right = -np.concatenate((R + F @ multipliers[active], excess[active]))
        rows = np.abs(system).max(axis=1)
        change = np.linalg.solve(system / rows[:, None], right / rows)
        x = x + change[:num].reshape(-1, 3)
        multipliers[active] += change[num:]
        if np.abs(change[:num]).max() <= 1e-13:
            return x, multipliers
    raise AssertionError("condensed Newton did not converge")


def run(scene, impact, num_steps):
    """Yield the steps solved by the mixed system and their contacts."""
    x_n, v_n = scene.x, scene.v
    for _ in range(num_steps):
        contacts = choose_contacts(scene, x_n, v_n, impact)
        bulk = scene.bulk.step(x_n, v_n, scene.dt)
        solution = mixed.solve_step(bulk, contacts, x_n, x_n + scene.dt * v_n)
        v = 2 / scene.dt * (solution.x - x_n) - v_n
        yield contacts, bulk, x_n, v_n, solution, v
        x_n, v_n = solution.x, v


@segments
@impacts
def test_condensed_and_mixed_system_have_the_same_solution(k, impact):
    scene = colliding_blocks(k)
    most_active, inactive = 0, 0
    for contacts, bulk, x_n, v_n, solution, _ in run(scene, impact, 5):
        x, multipliers = solve_condensed(bulk, contacts, x_n, x_n + scene.dt * v_n)
        np.testing.assert_allclose(x, solution.x, atol=POSITION_TOLERANCE, rtol=0)
        largest = np.abs(solution.multipliers).max()
        np.testing.assert_allclose(
            multipliers, solution.multipliers[:, 0], atol=MULTIPLIER_TOLERANCE * largest, rtol=0
        )

        xi, gap, normal, _ = _kernels.project(x[contacts.pairs], contacts.orientation)
        expected = np.column_stack((xi, gap))
        np.testing.assert_allclose(solution.f, expected, atol=POSITION_TOLERANCE, rtol=0)
        np.testing.assert_allclose(solution.normal, normal, atol=POSITION_TOLERANCE, rtol=0)
        active = multipliers != 0
        assert (np.abs(gap - contacts.slack_reference)[active] <= POSITION_TOLERANCE).all()
        most_active = max(most_active, active.sum())
        inactive += (~active).sum()
    assert most_active >= 3
    assert inactive > 0


@segments
@impacts
def test_mixed_system_conserves_momenta_and_balances_energy(k, impact):
    scene = colliding_blocks(k)
    momenta = scene.bulk.momenta(scene.x, scene.v)
    total = scene.bulk.kinetic_energy(scene.v)
    for contacts, _, x_n, v_n, solution, v in run(scene, impact, 5):
        np.testing.assert_allclose(
            scene.bulk.momenta(solution.x, v), momenta, atol=BALANCE_TOLERANCE * total
        )
        energy_n, energy = (
            scene.bulk.kinetic_energy(b) + scene.bulk.strain_energy(a)
            for a, b in ((x_n, v_n), (solution.x, v))
        )
        gap_n = _kernels.project(x_n[contacts.pairs], contacts.orientation)[1]
        loss = solution.multipliers[:, 0] @ (solution.f[:, 2] - gap_n)
        assert abs(energy - energy_n + loss) <= BALANCE_TOLERANCE * total
        if impact == "elastic":
            assert abs(energy - energy_n) <= BALANCE_TOLERANCE * total


@segments
def test_jacobian_of_the_mixed_system_has_a_second_order_remainder(k):
    scene = colliding_blocks(k)
    contacts = choose_contacts(scene, scene.x, scene.v, "plastic")
    bulk = scene.bulk.step(scene.x, scene.v, scene.dt)
    unknowns = mixed.start_values(contacts, scene.x, scene.x + scene.dt * scene.v)
    rng = np.random.default_rng(3)
    own = unknowns[scene.x.size :].reshape(-1, mixed.UNKNOWNS)
    own[:, 6:] = rng.uniform(-1, 1, own[:, 6:].shape) - [30, 0, 0, 0, 0, 0]
    own[::2, 6] = 30  # tension: the inactive branch
    d = rng.uniform(-0.1, 0.1, unknowns.shape)
    _, jacobian = mixed.assemble(bulk, contacts, scene.x, unknowns)

    def residual(at):
        return mixed.assemble(bulk, contacts, scene.x, at)[0]

    # Rows of bulk and contact apart: forces hide lengths otherwise
    for part in (slice(0, scene.x.size), slice(scene.x.size, None)):
        order = taylor_order(
            lambda at, part=part: residual(at)[part], unknowns, d, (jacobian @ d)[part]
        )
        assert order > 1.9


def test_bulk_of_the_reference_program_conserves_and_is_consistent():
    X, cells = box((2, 1, 1), (1.0, 0.6, 0.5))
    bulk = Bulk(X, cells, lmbda=500.0, mu=400.0, rho=10.0)
    rng = np.random.default_rng(4)
    x_n = X @ rotation([1, 2, 3], 0.7).T + rng.uniform(-0.05, 0.05, X.shape)
    x = x_n + rng.uniform(-0.05, 0.05, X.shape)
    force, tangent = bulk.internal(x_n, x)
    change = bulk.strain_energy(x) - bulk.strain_energy(x_n)
    np.testing.assert_allclose(force @ (x - x_n).ravel(), change, rtol=1e-12)
    moments = np.cross((x_n + x) / 2, force.reshape(-1, 3)).sum(axis=0)
    np.testing.assert_allclose(moments, 0, atol=1e-12 * np.abs(force).max())
    np.testing.assert_allclose(bulk.mass.sum() / 3, 10 * 0.3, rtol=1e-13)
    d = rng.normal(size=X.shape)
    assert taylor_order(lambda at: bulk.internal(x_n, at)[0], x, d, tangent @ d.ravel()) > 1.9
