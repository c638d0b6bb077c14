"""Pairs that may transmit force: kinematics, residual and tangent.

Arrays are over the ``m`` pairs of one contact pair on one rank; ``d`` stands for the
coordinates of a pair, three a node also in the plane, those of its node first: 3 (1+k) with
segments of k vertices, three times the nodes of the longest list with mortar contact. Everything
is local.
"""

from copy import copy
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.implicit.pair_blocks import PairBlocks
from dolfinx_nts.model.kinematics import ContactKinematics, Slip

__all__ = ["ContactContribution", "PairKinematics", "changed", "changes_by"]

# Length of the free part of a unit normal [-] above which a node can move along it.
_FREE_NORMAL = 0.5
# Part of a gradient of the gap, of a force, or of the square of a direction [-] that is round-off.
_NO_FREEDOM = 1e-8


class PairKinematics:
    """Kinematics of pairs, before multipliers are known.

    Args:
        node: Position of the node among those of the surface, shape ``(m,)``.
        segment: Candidate that the node faces, shape ``(m,)``.
        free: 1 where the displacement is unknown, otherwise 0, shape ``(m, d)``; None if all
            are unknown.
        contact: Gap and force of the pairs.
        blocks: How they enter linear systems.

    Attributes:
        node, segment, contact, blocks: The arguments.
        force: Normal and tangential force per multiplier, shape ``(m, 3, d)``.
        columns: The same, 0 where the displacement is given.
        gradients: Gradients of gap and slip at x, 0 where it is given, shape ``(m, 3, d)``.
        excess: What constraints make zero, shape ``(m, 3)`` [m].
        normal: Free part of the node's normal, of unit length, shape ``(m, 3)``.
        fixed: Whether the node cannot give up what constraints determine, shape ``(m,)``.
        slip: Slip of the pairs, with friction only.
    """

    slip: Slip

    def __init__(
        self,
        node: Ints,
        segment: Ints,
        free: Floats | None,
        contact: ContactKinematics,
        blocks: PairBlocks,
    ) -> None:
        self.node, self.segment, self._free = node, segment, free
        self.contact, self.blocks = contact, blocks
        m, d = contact.force.shape
        self.force, self.gradients = np.zeros((2, m, 3, d))
        self.excess: Floats = np.zeros((m, 3))
        self.force[:, 0], self.gradients[:, 0] = contact.force, contact.gradient
        self.columns, self.normal = self.force, _kernels.unit_vectors(contact.gradient)
        self.fixed: Flags = np.zeros(m, dtype=bool)
        if free is not None:
            self.columns = self.force * free[:, None]
            self.gradients[:, 0] *= free
            self.normal *= free[:, :3]
            self.fixed = ~(np.linalg.norm(self.normal, axis=1) > _FREE_NORMAL)
            self.normal = _kernels.unit_vectors(self.normal)

    def add_slip(self, slip: Slip, never_sticks: Flags, still: Floats | None) -> None:
        """Fill the tangential parts.

        Args:
            slip: Slips of the pairs. Those to round-off become 0 in directions that are given.
            never_sticks: Pairs without friction, shape ``(m,)``.
            still: Lengths of slips that are none where constraints hold them, shape ``(m,)``
                [m]; None where springs do.
        """
        self.slip = slip
        self.force[:, 1:] = slip.force
        self.gradients[:, 1:] = slip.gradient
        if self._free is not None:
            self.columns[:, 1:] = slip.force * self._free[:, None]
            self.gradients[:, 1:] *= self._free[:, None]
            # A sticking node gives up all its displacements.
            self.fixed |= np.any(self._free[:, :3] != 1, axis=1) & ~never_sticks
            if still is not None and self.fixed.any():
                self._leave_out_given(self._free, still)
        self.excess[:, 1:] = slip.value

    def _leave_out_given(self, free: Floats, still: Floats) -> None:
        """Leave directions of slip out in which all displacements are given, and of no length.

        Across a plane of symmetry nothing but small levers and the last digits would decide on
        multipliers. Arguments are those of the class and of `add_slip`.
        """
        m, slip = len(self.node), self.slip.value
        size = np.abs(self.force).reshape(m, 3, -1, 3).max(axis=(1, 3))
        takes_part = size > _NO_FREEDOM * size.max(axis=1, keepdims=True)
        axes_free = (free.reshape(m, -1, 3) * takes_part[..., None]).max(axis=1)
        directions = self.slip.frame_n * axes_free[:, None]
        length, axes = np.linalg.eigh(directions @ directions.swapaxes(1, 2))
        axes *= (length > _NO_FREEDOM)[:, None]
        kept = axes @ axes.swapaxes(1, 2)
        given = slip - np.einsum("mij,mj->mi", kept, slip)
        kept[~self.fixed | (np.linalg.norm(given, axis=1) > still)] = np.eye(2)
        slip[:] = np.einsum("mij,mj->mi", kept, slip)
        for rows in (self.columns, self.gradients):
            rows[:, 1:] = kept @ rows[:, 1:]

    @property
    def dofs(self) -> Ints:
        """Local nodes of each pair, numbered as by the scatter of the candidates."""
        return self.blocks.dofs

    @property
    def is_given(self) -> Flags:
        """Whether given displacements alone decide the gap, shape ``(m,)``."""
        if self._free is None:
            return np.zeros(len(self.node), dtype=bool)
        free, whole = (
            np.linalg.norm(gradient, axis=1)
            for gradient in (self._free * self.contact.gradient, self.contact.gradient)
        )
        given: Flags = free <= _NO_FREEDOM * whole
        return given

    def failures(self, active: Flags) -> int:
        """Number of pairs without a gap, and of ``active`` ones turned by more than 90 degrees."""
        valid = self.contact.turn >= 0  # false where it is NaN
        if valid.all():
            return 0
        return int(np.count_nonzero(~valid & (active | np.isnan(self.contact.gap))))


class ContactContribution(NamedTuple):
    """Force and tangent of the pairs that may transmit force, between x_n and x.

    Rows and columns of given displacements are 0 unless noted otherwise.

    Attributes:
        pairs: The pairs and their kinematics.
        active: Whether a pair transmits force, shape ``(m,)``.
        rank: Number of constraints, shape ``(m,)``: 0 inactive or penalty, 1 normal, all
            components of the space normal and stick.
        columns: Force per multiplier, shape ``(m, 3, d)``; that of the normal includes the
            friction which scales with it.
        slopes: Derivative of multipliers and tractions by gap and slip, in springs and where
            nodes slide, shape ``(m, 3, 3)`` [N/m]: columns^T slopes gradients is a part of the
            derivative of the forces.
        residual: Contact forces of the pair, shape ``(m, d)`` [N].
        tangent: The other part, at fixed multipliers and tractions, by `PairBlocks`, shape
            ``(p, 3 k, 3 k)`` [N/m].
        force: The forces without regard to given displacements, shape ``(m, d)`` [N].
        changed: Pairs that changed their segment, became active or inactive, began to stick or
            to slide, or should.
        failed: Pairs that could not be evaluated, active or not, and active ones whose normal
            has turned by more than 90 degrees.
    """

    pairs: PairKinematics
    active: Flags
    rank: Ints
    columns: Floats
    slopes: Floats
    residual: Floats
    tangent: Floats
    force: Floats
    changed: int
    failed: int

    @property
    def violations(self) -> Floats:
        """Largest violation of a constraint of each pair, shape ``(m,)`` [m]."""
        counts = np.arange(3) < self.rank[:, None]
        largest: Floats = np.where(counts, np.abs(self.pairs.excess), 0.0).max(axis=1, initial=0.0)
        return largest

    @property
    def constraint_error(self) -> float:
        """Largest violation of a constraint on this rank [m]."""
        return _kernels.largest_violation(self.pairs.excess, self.rank)


def changes_by(pairs: PairKinematics, ways: Floats) -> Floats:
    """Changes of gaps and slips by ways of all nodes, also given ones, ``(m, 3)`` [m]. Local.

    ``ways`` are those of the nodes of the pairs, shape ``(m, d)`` [m].
    """
    changes = np.zeros((len(ways), 3))
    changes[:, 0] = np.einsum("md,md->m", pairs.contact.gradient, ways)
    if "slip" in vars(pairs):  # there is friction
        changes[:, 1:] = np.einsum("mid,md->mi", pairs.slip.gradient, ways)
    return changes


def changed(pairs: PairKinematics, changes: Floats) -> PairKinematics:
    """Copy in which constraints see gaps and slips after changes, ``(m, 3)`` [m]. Local."""
    after = copy(pairs)
    after.excess = pairs.excess + changes
    return after
