"""The tangent is the derivative of the residual: second-order remainder.

Pairs, active set and multipliers stay, everything else may move.
"""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_residual
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.precond.tangent import Tangent
from helpers import scenes
from helpers.once import once
from helpers.scene import gathered, input_ids
from helpers.step_parts import following, step_forms

pytestmark = pytest.mark.at_most_two_ranks

# Least observed order, which tends to 2.
ORDER = 1.9
# Matrix and action are sums of the same terms in another order, relative.
ROUNDING = 1e4 * np.finfo(float).eps
LATER = 1  # an iteration in which the signs of the multipliers decide

SCHEMES = {
    "midpoint": nts.Midpoint,
    "conserving": nts.EnergyMomentum,
}
schemes = pytest.mark.parametrize("scheme", SCHEMES)
cells_ = pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
enforcements = pytest.mark.parametrize(
    "enforcement",
    [
        nts.LagrangeMultiplier("elastic"),
        once(nts.LagrangeMultiplier("plastic")),
        once(Penalty(50.0)),
    ],
)


class System:
    """Residual and tangent action of a step in the middle of an impact."""

    def __init__(self, comm, scheme, cell, enforcement, contact=True):
        """Advance into the contact and move away from that state."""
        scene = scenes.blocks(comm, SCHEMES[scheme], enforcement, cell=cell)
        scene.run(3)
        s = self.stepper = scene.stepper
        self.comm = comm
        s.u_n.x.array[:] = s.u.x.array
        self.bulk = Bulk(step_forms(s).residual(), s.u, [])
        V = s.u.function_space
        self.owned = V.dofmap.index_map.size_local
        self.X = V.tabulate_dof_coordinates()[: self.owned]
        # A state that is neither the one at t_n nor a rigid motion of it.
        trial = s.u.x.array + 2 * s.dt * s.v.x.array
        ids = input_ids(V)
        self.numbers = ids[: self.owned]
        noise = 0.01 * np.random.default_rng(1).normal(size=(V.dofmap.index_map.size_global, 3))
        self.u = trial.reshape(-1, 3)[: self.owned] + noise[self.numbers]
        self.steps = []
        if contact:
            weight = np.zeros(self.owned)  # the sign of the multiplier decides
            X = V.tabulate_dof_coordinates()
            step = ContactStep(s.contacts[0], scheme, s.x, X + trial.reshape(-1, 3), weight)
            step.evaluate(self.X + self.u, None, 0)
            step.evaluate(self.X + self.u, None, 1)
            step.normal.lambda_N[:] = -2.0 - np.arange(len(step.normal.lambda_N))
            self.steps = [step]

    def states(self, u):
        self.stepper.u.x.array[: 3 * self.owned] = u.ravel()
        self.stepper.u.x.scatter_forward()
        return [step.evaluate(self.X + u, None, LATER) for step in self.steps]

    def residual(self, u):
        """Residual of all nodes by input number, and constraints."""
        states = self.states(u)
        R = self.bulk.forces() + contact_residual(self.steps, states, (self.owned, 3))
        gaps = [s.pairs.excess[np.arange(3) < s.rank[:, None]] for s in states]
        return self.everywhere(R), self.constraints(gaps)

    def slope(self, u, d):
        """Derivative of the residual along d."""
        states = self.states(u)
        K_d = self.bulk.action(d)
        gaps = []
        for step, state in zip(self.steps, states, strict=True):
            scatter = step.candidates.scatter
            local = scatter.forward(d)[state.pairs.dofs].reshape(state.force.shape)
            values = np.einsum("mab,mb->ma", state.tangent, local)
            values += following(state, local)
            forces = np.zeros((scatter.num_local, 3))
            np.add.at(forces, state.pairs.dofs.ravel(), values.reshape(-1, 3))
            K_d = K_d + scatter.reverse(forces)
            rows = np.arange(3) < state.rank[:, None]
            gaps.append(np.einsum("mia,ma->mi", state.pairs.gradients, local)[rows])
        return self.everywhere(K_d), self.constraints(gaps)

    def everywhere(self, values):
        V = self.stepper.u.function_space
        return gathered(V, values.reshape(-1, 3))

    def constraints(self, gaps):
        return np.concatenate(self.comm.allgather(np.concatenate([*gaps, np.empty(0)])))

    def direction(self, seed):
        rng = np.random.default_rng(seed)
        V = self.stepper.u.function_space
        d = rng.uniform(-1, 1, (V.dofmap.index_map.size_global, 3))
        return d[self.numbers]


def orders(system, d):
    """Observed orders of residual and constraints over four halvings."""
    lengths = 0.004 / 2.0 ** np.arange(5)
    start, slope = system.residual(system.u), system.slope(system.u, d)
    remainders = []
    for h in lengths:
        moved = system.residual(system.u + h * d)
        rest = [a - b - h * c for a, b, c in zip(moved, start, slope, strict=True)]
        remainders.append([np.abs(part).max(initial=0) for part in rest])
    remainders = np.array(remainders)
    if not start[1].size:
        remainders = remainders[:, :1]
    return np.log2(remainders[:-1] / remainders[1:]).min(axis=0)


@schemes
@cells_
@enforcements
def test_remainder_of_bulk_and_contact_is_of_second_order(comm, scheme, cell, enforcement):
    system = System(comm, scheme, cell, enforcement)
    active = comm.allreduce(sum(np.count_nonzero(s.active) for s in system.states(system.u)))
    assert active >= 2
    for seed in range(2):
        assert orders(system, system.direction(seed)).min() > ORDER


@pytest.mark.serial
@schemes
@cells_
def test_contact_alone_changes_the_remainder(comm, scheme, cell):
    # Without the derivative of the contact force the order is one.
    system = System(comm, scheme, cell, nts.LagrangeMultiplier("plastic"))
    d = system.direction(0)
    plain, full = system.bulk, system.slope(system.u, d)
    system.states(system.u)
    difference = np.abs(system.everywhere(plain.action(d)) - full[0]).max()
    assert difference > 1e-3 * np.abs(full[0]).max()


@schemes
@cells_
def test_matrix_and_action_of_the_bulk_are_the_same(comm, scheme, cell):
    system = System(comm, scheme, cell, None, contact=False)
    system.states(system.u)
    d = system.direction(4)
    tangent = Tangent(step_forms(system.stepper).residual(), system.stepper.u, [])
    tangent.assemble_exact()
    K = tangent.matrix(scalar=False)
    x, y = K.createVecs()
    x.array[:] = d.ravel()
    K.mult(x, y)
    product, action = system.everywhere(y.array.copy()), system.everywhere(system.bulk.action(d))
    assert np.abs(product - action).max() <= ROUNDING * np.abs(product).max()
    assert tangent.num_assembled == 1
