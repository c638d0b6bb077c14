"""Stick, slip and traction of the nodes of a pair in one attempt at a step."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.friction import transport
from dolfinx_nts.contact.implicit.active_set import BlockPivoting
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.pair import ContactPair

__all__ = ["StickSlip"]


_SLIP_WEIGHT = 0.3  # of slip in the test for stick, relative to the stiffness of a node


class StickSlip:
    """What friction adds to a `ContactStep`.

    ``m`` pairs of `PairKinematics` are a part of the ``n`` nodes of the surface;
    ``active`` tells which of the pairs transmit force, shape ``(m,)``.

    Args:
        pair: Contact pair with friction.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
        comm: Communicator of the mesh.

    Attributes:
        sliding: Nodes that slide where they are active, shape ``(n,)``.
        traction: In the frames of the segments at t_n, ``(n, 2)`` [N].
    """

    def __init__(self, pair: ContactPair, stiffness: Floats, comm: MPI.Comm) -> None:
        """Continue from the accepted step."""
        history, n = pair.history, len(stiffness)
        assert pair.friction is not None
        self._pair, self._law, self._stiffness = pair, pair.friction, stiffness
        self._pivoting = BlockPivoting(comm)
        # A node that arrives slides until it is found to stick.
        self.sliding: Flags = history.sliding | ~history.active
        self.traction: Floats = np.zeros((n, 2))
        # Model of the traction and slip of the last iteration.
        self._explicit, self._direction, self._slip = np.zeros((3, n, 2))
        self._turn_stiffness = np.zeros((n, 2, 2))

    def release(self, node: Ints) -> None:
        """Forget the traction of nodes that have become inactive. Local."""
        self.traction[node] = 0.0

    def arrive(self, node: Ints) -> None:
        """Let nodes slide that have become active. Local."""
        self.sliding[node] = True
        self._direction[node] = 0.0

    def sticks(self, node: Ints, active: Flags) -> Flags:
        """Active nodes held by multipliers in the tangent plane. Local."""
        flags: Flags = active & ~self.sliding[node] & (not self._pair.has_slip_spring)
        return flags

    def energy(self, traction: Floats) -> Floats:
        """Energy of the tangential springs, shape ``(n,)`` [J]. Local.

        Args:
            traction: Of all nodes, shape ``(n, 3)`` [N].
        """
        if not self._pair.has_slip_spring:
            return np.zeros(len(traction))
        assert self._pair.eps_T is not None
        energy: Floats = np.einsum("ni,ni->n", traction, traction) / (2 * self._pair.eps_T)
        return energy

    def update(self, rows: PairKinematics, p: Floats, active: Flags, iteration: int) -> int:
        """Decide on stick and slip, and model the traction. Collective.

        Args:
            rows: The pairs.
            p: Pressing force, shape ``(m,)`` [N].
            active: Whether a pair transmits force.
            iteration: Number of the Newton iteration, from 0.

        Returns:
            Pairs of this rank whose state did not fit.
        """
        node, slip, before = rows.node, rows.slip.value, self.sliding[rows.node]
        spring = self._pair.has_slip_spring
        if spring:
            assert self._pair.eps_T is not None
            old, c = self._pair.history, self._pair.eps_T[node]
            t = transport(
                old.traction[node], old.normal[node], rows.slip.frame_n, rows.slip.normal_n
            )
        else:
            t, c = self.traction[node], _SLIP_WEIGHT * self._stiffness[node]
        trial = t + c[:, None] * slip
        way = trial if spring else slip
        sliding, violators, heading = before, 0, way
        if iteration:
            # With p < 0, which may pass, a traction points backwards.
            heading = np.where(before[:, None], self._direction[node], self.traction[node])
            arrives = ~np.any(heading != 0, axis=1)
            heading = np.where(arrives[:, None], way, heading)
            after = self._law.slides(trial, way, p, heading, before)
            flips, violators = self._pivoting.select(
                active & (after != before), self._pair.nodes.node_ids[node], iteration
            )
            sliding = np.where(active, before ^ flips, after)
        if spring:
            model = self._law.spring(trial, p, c, heading, sliding)
        else:
            known = float(iteration > 0)  # multipliers of the starting guess mean nothing
            model = self._law.exact(known * t, slip, known * p, c, heading, sliding)
        self.sliding[node] = sliding
        self._slip[node] = slip
        self._explicit[node] = model.explicit
        self._direction[node] = model.direction
        self._turn_stiffness[node] = model.stiffness
        self.traction[node] = np.where(
            (sliding | spring)[:, None],
            model.explicit + p[:, None] * model.direction,
            self.traction[node],
        )
        self.release(node[~active])
        return violators

    def reduced(self, rows: PairKinematics, R: Floats, active: Flags) -> tuple[Floats, Floats]:
        """What the normal multipliers have to balance, and their columns. Local.

        Args:
            rows: The pairs.
            R: Residual at their nodes, shape ``(m, 3)`` [N].
            active: Whether a pair transmits force.

        Returns:
            Residual with the tractions that do not scale with the
            pressing force, ``(m, 3)``; force per multiplier with those
            that do, ``(m, 3)``.
        """
        along = rows.columns[:, 1:, :3]
        rest: Floats = R + np.einsum("mi,mij->mj", self._known(rows, active), along)
        column: Floats = rows.columns[:, 0, :3] - np.einsum(
            "mi,mij->mj", self._direction[rows.node], along
        )
        return rest, column

    def balance(
        self, rows: PairKinematics, rest: Floats, lambda_N: Floats, active: Flags
    ) -> Floats:
        """Set the tractions that go with normal multipliers. Local.

        Args:
            rows: The pairs.
            rest: As `reduced` gives it.
            lambda_N: Normal multipliers of sliding nodes, ``(m,)`` [N].
            active: Whether a pair transmits force.

        Returns:
            Normal multipliers, those of sticking nodes too.
        """
        stick = self.sticks(rows.node, active) & ~rows.fixed
        traction = self._known(rows, active) - lambda_N[:, None] * self._direction[rows.node]
        A = rows.columns[stick, :, :3].transpose(0, 2, 1)
        solution = np.linalg.solve(A, -rest[stick][:, :, None])[:, :, 0]
        lambda_N = lambda_N.copy()
        lambda_N[stick], traction[stick] = solution[:, 0], solution[:, 1:]
        self.traction[rows.node] = np.where(active[:, None], traction, 0.0)
        return lambda_N

    def follow(self, rows: PairKinematics, lambda_N: Floats, active: Flags) -> None:
        """Set the tractions of sliding nodes by their model. Local.

        What `balance` does for them, where multipliers were solved for.

        Args:
            rows: The pairs.
            lambda_N: Normal multipliers, shape ``(m,)`` [N].
            active: Whether a pair transmits force.
        """
        node = rows.node
        slides = active & ~self.sticks(node, active)
        traction = self._known(rows, active) - lambda_N[:, None] * self._direction[node]
        self.traction[node[slides]] = traction[slides]

    def _known(self, rows: PairKinematics, active: Flags) -> Floats:
        """Tractions that do not scale with the pressing force, ``(m, 2)``."""
        node = rows.node
        explicit: Floats = self._explicit[node]
        if not self._pair.has_slip_spring:
            turned = rows.slip.value - self._slip[node]
            explicit = explicit + np.einsum("mij,mj->mi", self._turn_stiffness[node], turned)
        stick = self.sticks(node, active) & ~rows.fixed
        return np.where(stick[:, None], 0.0, explicit)

    def add_to(self, rows: PairKinematics, active: Flags, force: Floats, tangent: Floats) -> Floats:
        """Add tractions to forces and tangents of pairs. Local.

        Args:
            rows: The pairs.
            active: Whether a pair transmits force.
            force: Shape ``(m, d)`` [N].
            tangent: Shape ``(m, d, d)`` [N/m].

        Returns:
            Force per multiplier, shape ``(m, 3, d)``, that of the normal
            with the friction which scales with it.
        """
        node, along = rows.node, rows.force[:, 1:]
        t, slides = self.traction[node], active & ~self.sticks(node, active)
        force += np.einsum("mi,mij->mj", t, along)
        tangent += rows.slip.hessian(t) / 2
        model = np.where(slides[:, None, None], self._turn_stiffness[node], 0.0)
        tangent += np.einsum("mia,mij,mjb->mab", along, model, rows.slip.gradient, optimize=True)
        direction = np.where(slides[:, None], self._direction[node], 0.0)
        columns: Floats = rows.columns.copy()
        columns[:, 0] -= np.einsum("mi,mij->mj", direction, columns[:, 1:])
        return columns
