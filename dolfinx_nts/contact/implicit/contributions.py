"""Kinematics, residual and tangent of pairs that may transmit force.

Arrays are over the ``m`` pairs of one contact pair on one rank; ``d`` are the coordinates of a
pair, three per node also in the plane, the node first: 3 (1+k) for segments of k vertices, three
times the nodes of the longest list in mortar contact. All functions are local.
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
# Length of the tangential part of the normal of a plane of symmetry [-] above which it is a
# direction of slip.
_TANGENTIAL = 0.5
# Relative size of a gap gradient, a force, a distance, or the square of a direction [-] that counts
# as zero.
_NO_FREEDOM = 1e-8


class PairKinematics:
    """Kinematics of pairs, before multipliers are known.

    Args:
        node: Index of the node among the nodes of the surface, shape ``(m,)``.
        segment: Candidate of the node, shape ``(m,)``.
        free: 1 at unknown displacements, otherwise 0, shape ``(m, d)``; None if all are unknown.
        contact: Gap and force of the pairs.
        blocks: Blocks of the pairs in linear systems.

    Attributes:
        node, segment, contact, blocks: The arguments.
        force: Normal and tangential force per multiplier, shape ``(m, 3, d)``.
        columns: The same, 0 at prescribed displacements.
        gradients: Gradients of gap and slip at x, 0 at prescribed displacements, ``(m, 3, d)``.
        excess: Constraint residuals: gap minus reference gap, and slip, shape ``(m, 3)`` [m].
        normal: Free part of the normal of the node, of unit length, shape ``(m, 3)``.
        fixed: Flags of nodes whose displacement cannot be eliminated, shape ``(m,)``.
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
        """Add the slip to forces, gradients and constraint residuals.

        Args:
            slip: Slips of the pairs. In prescribed directions, round-off is set to 0.
            never_sticks: Flags of pairs on an axis of symmetry, without friction, shape ``(m,)``.
            still: Slip below which a constrained node sticks, shape ``(m,)`` [m]; None for springs.
        """
        self.slip = slip
        self.force[:, 1:] = slip.force
        self.gradients[:, 1:] = slip.gradient
        if self._free is not None:
            self.columns[:, 1:] = slip.force * self._free[:, None]
            self.gradients[:, 1:] *= self._free[:, None]
            # All displacements of a sticking node are eliminated.
            self.fixed |= np.any(self._free[:, :3] != 1, axis=1) & ~never_sticks
            if still is not None and self.fixed.any():
                self._remove_prescribed_slip(self._free, still)
        self.excess[:, 1:] = slip.value

    def fixed_components(self, dim: int) -> Flags | None:
        """Flags of the fixed components of partly fixed nodes. Local.

        Returns:
            Flags of the ``dim`` components of displacements, shape ``(m, nodes, dim)``; None if no
            node of the nodal surface is partly fixed.
        """
        if self._free is None:
            return None
        is_fixed: Flags = self._free.reshape(*self.dofs.shape, 3)[:, :, :dim] == 0
        is_fixed &= ~is_fixed.all(axis=2, keepdims=True)
        return is_fixed if is_fixed[:, 0].any() else None

    def remove_slip_across(self, is_fixed: Flags, on_segments: Flags, x: Floats) -> None:
        """Remove slip normal to planes of symmetry that contain node and segments. Local.

        Around a node on such a plane the other half of the bodies slips in the opposite direction.

        Args:
            is_fixed: See `fixed_components`.
            on_segments: Whether entries of `dofs` are nodes of segments, of the same shape.
            x: Positions of the nodes, shape ``(l, 3)`` [m].
        """
        dim = is_fixed.shape[2]
        away = np.abs(x[self.dofs, :dim] - x[self.dofs[:, :1], :dim])
        is_level = away <= _NO_FREEDOM * away.max(axis=(1, 2), keepdims=True)
        across = is_fixed[:, 0] & (is_fixed & is_level & on_segments[:, :, None]).any(axis=1)
        if not across.any():
            return
        kept = np.tile(np.eye(2), (len(self.node), 1, 1))
        for axis in range(dim):
            direction = self.slip.frame_n[:, :, axis]
            length = np.linalg.norm(direction, axis=1)
            is_tangential = across[:, axis] & (length > _TANGENTIAL)
            unit = direction[is_tangential] / length[is_tangential, None]
            kept[is_tangential] -= kept[is_tangential] @ (unit[:, :, None] * unit[:, None])
        self._keep(kept)
        self.excess[:, 1:] = self.slip.value

    def _keep(self, kept: Floats) -> None:
        """Project the slips, ``kept`` of shape ``(m, 2, 2)``."""
        slip = self.slip.value
        slip[:] = np.einsum("mij,mj->mi", kept, slip)
        for rows in (self.columns, self.gradients):
            rows[:, 1:] = kept @ rows[:, 1:]

    def _remove_prescribed_slip(self, free: Floats, still: Floats) -> None:
        """Remove slip directions without unknown displacements, or of zero length.

        Round-off would determine multipliers of directions normal to a plane of symmetry. Arguments
        are those of the class and of `add_slip`.
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
        self._keep(kept)

    @property
    def dofs(self) -> Ints:
        """Local nodes of each pair, numbered as by the scatter of the candidates."""
        return self.blocks.dofs

    @property
    def is_prescribed(self) -> Flags:
        """Whether the gap depends only on prescribed displacements, shape ``(m,)``."""
        if self._free is None:
            return np.zeros(len(self.node), dtype=bool)
        free, whole = (
            np.linalg.norm(gradient, axis=1)
            for gradient in (self._free * self.contact.gradient, self.contact.gradient)
        )
        given: Flags = free <= _NO_FREEDOM * whole
        return given

    def failures(self, active: Flags) -> int:
        """Number of degenerate pairs, and of active ones rotated by more than 90 degrees."""
        valid = self.contact.turn >= 0  # false for NaN
        if valid.all():
            return 0
        return int(np.count_nonzero(~valid & (active | np.isnan(self.contact.gap))))


class ContactContribution(NamedTuple):
    """Force and tangent of the pairs that may transmit force, between x_n and x.

    Rows and columns of prescribed displacements are 0 unless noted otherwise.

    Attributes:
        pairs: The pairs and their kinematics.
        active: Whether a pair transmits force, shape ``(m,)``.
        rank: Number of constraints, shape ``(m,)``: 0 if inactive or with springs, 1 for the normal
            constraint, the dimension of the space for normal and stick constraints.
        columns: Force per multiplier, shape ``(m, 3, d)``; the normal one includes the friction
            proportional to it.
        slopes: Derivative of multipliers and tractions with respect to gap and slip, for springs
            and sliding nodes, shape ``(m, 3, 3)`` [N/m]. columns^T slopes gradients is one term of
            the derivative of the forces.
        residual: Contact forces of the pair, shape ``(m, d)`` [N].
        tangent: The other term of the derivative, at fixed multipliers and tractions, in the blocks
            of `PairBlocks`, shape ``(p, 3 k, 3 k)`` [N/m].
        force: The forces including prescribed displacements, shape ``(m, d)`` [N].
        changed: Number of pairs that changed segment or state, or violate a condition.
        failed: Number of degenerate pairs, and of active ones rotated by more than 90 degrees.
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


def changes_by(pairs: PairKinematics, increments: Floats) -> Floats:
    """Changes of gaps and slips, ``(m, 3)`` [m], by increments of all nodes. Local.

    ``increments`` are displacement increments of the nodes of the pairs, shape ``(m, d)`` [m].
    """
    changes = np.zeros((len(increments), 3))
    changes[:, 0] = np.einsum("md,md->m", pairs.contact.gradient, increments)
    if "slip" in vars(pairs):  # there is friction
        changes[:, 1:] = np.einsum("mid,md->mi", pairs.slip.gradient, increments)
    return changes


def changed(pairs: PairKinematics, changes: Floats) -> PairKinematics:
    """Copy with gaps and slips after changes ``(m, 3)`` [m]. Local."""
    after = copy(pairs)
    after.excess = pairs.excess + changes
    return after
