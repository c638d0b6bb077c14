"""One attempt at a step of contact pairs: forces and tangents of their nodes.

A `ContactStep` never changes the accepted state of the pairs. Evaluating it gives a
`ContactContribution`, from which residual and tangent are assembled.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.contact.implicit.contributions import ContactContribution, PairKinematics
from dolfinx_nts.contact.implicit.factories import make_friction, make_normal_contact, make_search
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.implicit.normal.interface import start_normal_contact
from dolfinx_nts.contact.implicit.pair_forces import contribution_of
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import dimension, in_space, of_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates

__all__ = ["ContactStep", "contact_forces", "contact_residual", "start_from"]

# Number of state changes above which the message of a failed step names the node.
_UNSETTLED = 4

_NONE: Ints = np.empty(0, dtype=np.int32)


class _Unknown(NamedTuple):
    """Unknowns of the nodes.

    Attributes:
        dim: Components of a displacement.
        free: 1 where a displacement is unknown, otherwise 0, at the nodes of the candidates, shape
            ``(l, 3)``; None if all are unknown.
        is_rigid: Whether a node of the surface belongs to a rigid body, ``(n,)``; None if none
            does.
    """

    dim: int
    free: Floats | None
    is_rigid: Flags | None


class ContactStep:
    """One attempt at a step of a contact pair, or of several that are evaluated together.

    Collective, as are its methods.

    Args:
        state: State of the contact pair or of the pairs, ``c`` in number.
        scheme: Kernel of contact: ``"conserving"``, ``"midpoint"`` or ``"static"``.
        x_n: Accepted positions of the local nodes of the space, owned and ghost, ``(l, 3)``
            [m].
        x_trial: Positions in the trial state without contact, see `Rates`, of the same shape [m].
        stiffness: Stiffness of each owned node of the space, shape ``(n,)`` [N/m]: the weight
            in the tests for contact and stick.
        free: 1 where the displacement of an owned node is unknown, 0 where it is prescribed, shape
            ``(n, d)``; None if all are unknown.
        is_static: Whether there is no inertia.
        rigid: Owned nodes of rigid bodies, whose displacements cannot be eliminated.
        intermediate: Positions after fractions of the ballistic motion, without stretch of rigid
            bodies, by the fraction from 0 to 1; None for no fraction.
        share: Weight of the end of the step in the forces of springs, see `Scheme` [-].
        begins_sticking: Whether all nodes with friction stick at first, see `StickSlip`.
        dt: Length of the step [s], for the speed of slip.
        others: Attempts of other pairs at the same step, on whose contact that of vertices depends.
        x_points: Positions at which points of mortar contact are chosen, ``(l, 3)`` [m]; None for
            ``x_trial``.

    Attributes:
        state: The argument.
        begins_from: The positions x_n, x_trial and x_points.
        repeat: Function ``repeat(x_n=, x_trial=, x_points=)`` that makes another attempt from other
            positions.
        search: Segments of the nodes.
        normal: Normal contact of the nodes.
        friction: Friction of the nodes.
        num_active: Active pairs on all ranks.
        may_touch: Whether a node can become active, on any rank.
        has_rigid_nodes: Whether a node belongs to a rigid body, on any rank.
        touched: Whether any node of each pair was active in any iteration, shape ``(c,)``.
        x: Positions of the nodes of the candidates in the last evaluation, in the frame of the
            search, ``(l, 3)`` [m].
    """

    def __init__(
        self,
        state: PairState | JointState,
        scheme: str,
        x_n: Floats,
        x_trial: Floats,
        stiffness: Floats,
        free: Floats | None = None,
        is_static: bool = False,
        rigid: Ints = _NONE,
        intermediate: Mapping[float, Floats] | None = None,
        share: float = 0.5,
        begins_sticking: bool = False,
        dt: float = 1.0,
        others: Sequence["ContactStep"] = (),
        x_points: Floats | None = None,
    ) -> None:
        """Find the candidates within the search radius, and the eligible nodes."""
        self.state, self._scheme = state, scheme
        x_points = x_trial if x_points is None else x_points
        self.begins_from = x_n, x_trial, x_points
        self.repeat = partial(
            ContactStep,
            state,
            scheme,
            stiffness=stiffness,
            free=free,
            is_static=is_static,
            rigid=rigid,
            intermediate=intermediate,
            share=share,
            begins_sticking=begins_sticking,
            dt=dt,
            others=others,
        )
        self._comm: MPI.Comm = state.nodes.V.mesh.comm
        self.search = search = make_search(state, *self.begins_from, is_static)
        self.x = search.x_n
        self._unknown = _Unknown(
            dimension(state.nodes.V),
            None if free is None else _unknowns(search, free),
            np.isin(state.nodes.nodes, rigid) if len(rigid) else None,
        )
        nodal_stiffness = stiffness[state.nodes.nodes]
        self.normal = make_normal_contact(
            *(state, is_static, search, nodal_stiffness, intermediate or {}, share, dt),
            partial(_compression, others),
            partial(_replace, others),
        )
        self.friction = make_friction(
            *(state, is_static, search, nodal_stiffness, scheme == "static", begins_sticking, dt),
            self.normal.stiffness_fraction,
        )
        is_rigid = self._unknown.is_rigid
        has_rigid = is_rigid is not None and bool(is_rigid.any())
        flags = np.array([bool(self.normal.may_touch.any()), has_rigid])
        self.may_touch, self.has_rigid_nodes = map(bool, reductions.anywhere(self._comm, flags))
        # Results of the first evaluation that stay constant in the step.
        self._idle: ContactContribution | None = None
        self.num_active, self.touched = 0, np.zeros(len(members(state)), dtype=bool)

    @property
    def candidates(self) -> Candidates:
        """Candidates within the search radius. Local."""
        return self.search.candidates

    def evaluate(self, x: Floats, R_bulk: Floats | None, iteration: int) -> ContactContribution:
        """Pair nodes, evaluate the kernels, and update multipliers and active set.

        Args:
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
            R_bulk: Residual without contact at the owned nodes, shape ``(n, d)`` [N], which the
                multipliers balance; None keeps the multipliers.
            iteration: Number of the Newton iteration, from 0.

        Returns:
            The pairs that may transmit force.
        """
        x = self.x = self.candidates.scatter.forward(self.state.search.frame.at_end(x))
        if self._idle is not None:
            return self._idle
        pairs, changed = self._kinematics(x, iteration)
        R = None if R_bulk is None else in_space(R_bulk)
        changed += self.normal.update(pairs, x, R, self.friction, iteration)
        self.count_active(pairs.node)
        if iteration == 0:  # there is no previous active set
            changed = int(np.count_nonzero(self.normal.active[pairs.node]))
        dim = self._unknown.dim
        contribution = contribution_of(pairs, self.normal, self.friction, dim, changed)
        if not (self.may_touch or reductions.anywhere(self._comm, len(self.normal.nodes) > 0)):
            self._idle = contribution
        return contribution

    def count_active(self, node: Ints) -> None:
        """Count active pairs of all ranks, given active nodes of this rank. Collective."""
        own = _kernels.counts_of_parts(self.normal.active[node], node, self.state.ends)
        counts = reductions.total(self._comm, own)
        self.num_active = int(counts.sum())
        self.touched |= counts > 0

    def reproject(self, converged: bool) -> int:
        """Update the segments in equilibrium; return the number of changes on this rank.

        After any change, equilibrium has to be solved for again. ``converged`` is whether Newton's
        method has converged, or is only near an equilibrium.
        """
        node, active = self.normal.nodes, self.normal.active
        moved, is_renewed = self.search.reproject(self.x, node, active[node], converged)
        self._idle = None
        return moved + self.normal.renew(self.x, moved=is_renewed)

    def close_gaps(self, contribution: ContactContribution, x: Floats, u: Floats) -> None:
        """Move owned nodes so that constraints are satisfied, see `NormalContact.close_gaps`.

        ``contribution`` is the last evaluation.
        """
        if self.num_active:
            self.normal.close_gaps(contribution.pairs, x, u, self.friction)

    def add_multipliers(self, contribution: ContactContribution, increments: Floats) -> None:
        """Add increments of the multipliers [N], one for each constraint of the pairs. Local."""
        node, rows = contribution.pairs.node, np.arange(3) < contribution.rank[:, None]
        values = np.zeros(rows.shape)
        values[rows] = increments
        self.normal.lambda_N[node] += values[:, 0]
        self.friction.traction[node] += values[:, 1:]

    @property
    def unsettled(self) -> Ints:
        """Indices in the pair of nodes that changed segment or state repeatedly. Local."""
        flips = self.normal.flips + self.friction.flips
        nodes: Ints = indices(self.search.unsettled | (flips >= _UNSETTLED))
        return nodes

    def _kinematics(self, x: Floats, iteration: int) -> tuple[PairKinematics, int]:
        """Kinematics of eligible nodes, and number of nodes that changed or left their segment."""
        search, node, released = self.search, self.normal.nodes, 0
        segment, moved = search.find(x, node, iteration)
        near = segment >= 0
        if (needed := self.normal.needs(x, node)) is not None:
            near &= needed
        if not near.all():
            far = node[~near]
            released = int(np.count_nonzero(self.normal.active[far]))
            self.normal.active[far], self.normal.lambda_N[far] = False, 0.0
            self.friction.release(far)
            node, segment, moved = node[near], segment[near], moved[near]
        _, free, is_rigid = self._unknown
        pairs = search.pairing.kinematics(self._scheme, x, node, segment, free)
        if is_rigid is not None:
            pairs.fixed |= is_rigid[node]
        self.friction.measure(pairs, x)
        search.gap[node] = pairs.contact.gap
        return pairs, int(np.count_nonzero(moved)) + released


def _compression(steps: Sequence[ContactStep], pair: PairState) -> Floats:
    """Compression of the active springs of one pair of the attempts, ``(n,)`` [m]. Local."""
    compression = np.zeros(len(pair.nodes.nodes))
    for step in steps:
        if pair in (pairs := members(step.state)):
            start, end = step.state.ends[(number := pairs.index(pair)) : number + 2]
            node = start + indices(step.normal.active[start:end])
            compression[node - start] = np.fmax(-step.normal.gaps(step.x, node), 0.0)
    return compression


def _replace(steps: Sequence[ContactStep], pair: PairState, nodes: Flags) -> int:
    """Exclude nodes of one pair of the attempts, see `NormalContact.replace`. Collective."""
    for step in steps:
        if pair in (pairs := members(step.state)):
            start, end = step.state.ends[(number := pairs.index(pair)) : number + 2]
            return step.normal.replace(nodes, slice(start, end))
    return 0


def _unknowns(search: LocalSearch, free: Floats) -> Floats | None:
    """Flags of unknown displacements at the nodes of the candidates. Collective.

    ``free`` is 1 where the displacement of an owned node is unknown, otherwise 0, ``(n, d)``.
    Returns these flags at owned and ghost nodes, shape ``(l, 3)``; or None if all displacements of
    the points and of the candidates on this rank are unknown.
    """
    known = np.ones((len(free), 3))
    known[:, : free.shape[1]] = free
    free = search.candidates.scatter.forward(known)
    return None if free[search.pairing.reached].all() else free


def contact_residual(
    steps: Sequence[ContactStep],
    contributions: Sequence[ContactContribution],
    shape: tuple[int, int],
) -> Floats:
    """Sum of the contact forces on the owned dofs, shape ``(n d,)`` [N]. Collective.

    ``contributions`` are the last evaluations of the attempts, one for each pair; ``shape`` is the
    shape of values at the owned nodes, ``(n, d)``.
    """
    total: Floats = np.zeros((shape[0], 3))
    for step, contribution in zip(steps, contributions, strict=True):
        if step.num_active:
            dofs = contribution.pairs.dofs
            forces = contribution.residual.reshape(*dofs.shape, 3)
            step.candidates.scatter.add(total, dofs, forces)
    return of_space(total, shape[1]).ravel()


def contact_forces(
    steps: Sequence[ContactStep],
    contributions: Sequence[ContactContribution],
    shape: tuple[int, int],
) -> Floats:
    """Contact forces, also at prescribed displacements, see `contact_residual`, ``(n, d)`` [N]."""
    everywhere = [each._replace(residual=each.force) for each in contributions]
    return contact_residual(steps, everywhere, shape).reshape(shape)


def start_from(steps: Sequence[ContactStep], others: Sequence[ContactStep]) -> None:
    """Start from the segments and active sets at the end of other attempts. Local.

    Args:
        steps: Attempts at a step, not yet evaluated.
        others: Earlier attempts at the same step, of the same pairs.
    """
    for step, other in zip(steps, others, strict=True):
        step.search.start_from(other.search)
        start_normal_contact(step.normal, other.normal)
        step.friction.start_from(other.friction)
