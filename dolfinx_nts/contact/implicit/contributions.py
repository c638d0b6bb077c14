"""Pairs that may transmit force: kernel values, residual, tangent.

Arrays over the pairs of one contact pair on one rank; d stands for the
3(1+k) coordinates of a pair, its node first.
"""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Array, Flags, Floats, Ints
from dolfinx_nts.contact.slip import Slip

__all__ = ["ContactContribution", "PairKinematics"]


class ContactContribution(NamedTuple):
    """Pairs that may transmit force, evaluated between x_n and x.

    ``d`` stands for the 3(1+k) coordinates of a pair; rows and columns of
    given displacements are 0 unless noted otherwise.

    Attributes:
        node: Position in the surface's nodes, shape ``(m,)``.
        segment: Segment in the neighbourhood, shape ``(m,)``.
        dofs: Nodes of the pair in the neighbourhood's index map, shape
            ``(m, 1+k)``.
        active: Whether the pair transmits force, shape ``(m,)``.
        rank: Number of constraints: 0 inactive or penalty, 1 normal, 3
            normal and stick, shape ``(m,)``.
        excess: What the constraints should make zero: gap minus its
            reference, slip; shape ``(m, 3)`` [m].
        gradients: Gradients of gap and slip at x, shape ``(m, 3, d)``.
        columns: Force per multiplier, shape ``(m, 3, d)``; that of the
            normal includes the friction which scales with it.
        residual: Contact forces of the pair, ``(m, d)`` [N].
        tangent: Its derivative at fixed multipliers, ``(m, d, d)`` [N/m].
        normal: Free part of the node's normal, unit, shape ``(m, 3)``.
        fixed: Whether the node cannot give up what the constraints
            determine, shape ``(m,)``.
        force: All of ``residual``, given displacements or not.
        changed: Pairs that changed their segment; that became active or
            inactive, began to stick or to slide, or should.
        failed: Pairs that could not be evaluated, active or not, and active
            ones whose normal has turned by more than 90 degrees.
    """

    node: Ints
    segment: Ints
    dofs: Ints
    active: Flags
    rank: Ints
    excess: Floats
    gradients: Floats
    columns: Floats
    residual: Floats
    tangent: Floats
    normal: Floats
    fixed: Flags
    force: Floats
    changed: int
    failed: int

    @property
    def constraint_error(self) -> float:
        """Largest violation of a constraint on this rank [m]."""
        rows = np.arange(3) < self.rank[:, None]
        return float(np.abs(self.excess[rows]).max(initial=0.0))


class PairKinematics:
    """Kernel values of pairs, before multipliers are known.

    Args:
        node: Position in the surface's nodes, shape ``(m,)``.
        segment: Segment in the neighbourhood, shape ``(m,)``.
        dofs: Nodes of the pair in the index map, shape ``(m, 1+k)``.
        free: 1 where the displacement is unknown, otherwise 0, shape
            ``(m, d)``; None if all are unknown.
        values: What `SegmentCandidates.contact` gives.

    Attributes:
        gap_n, gap: Gap at t_n and at x [m].
        tangent: Derivative of the normal force, shape ``(m, d, d)``.
        force: Normal and tangential force per multiplier, ``(m, 3, d)``.
        columns: The same, 0 where the displacement is given.
        gradients: Of gap and slip at x, 0 where it is given, ``(m, 3, d)``.
        excess: What constraints make zero, shape ``(m, 3)`` [m].
        normal: Free part of the node's normal, unit, shape ``(m, 3)``.
        valid: Whether the kernel could be evaluated and the normal has
            turned by less than 90 degrees, shape ``(m,)``.
        fixed: Whether the node cannot give up what constraints determine,
            shape ``(m,)``.
        slip: Slip of the pairs, with friction only.
    """

    slip: Slip

    def __init__(
        self,
        node: Ints,
        segment: Ints,
        dofs: Ints,
        free: Floats | None,
        values: tuple[Array, ...],
    ) -> None:
        """Complete the normal parts; the tangential ones are zero."""
        self.node, self.segment, self.dofs, self.free = node, segment, dofs, free
        self.gap_n, self.gap, F, G, self.tangent, turn, _ = values
        m, d = F.shape
        self.force, self.gradients = np.zeros((2, m, 3, d))
        self.excess = np.zeros((m, 3))
        self.valid: Flags = turn >= 0  # not if it is NaN
        self.force[:, 0], self.gradients[:, 0] = F, G
        self.columns, self.normal = self.force, G[:, :3].copy()
        self.fixed: Flags = np.zeros(m, dtype=bool)
        if free is not None:
            self.columns = self.force * free[:, None]
            self.gradients[:, 0] *= free
            self.normal *= free[:, :3]
            length = np.linalg.norm(self.normal, axis=1)
            self.normal /= np.where(length > 0, length, 1.0)[:, None]
            self.fixed = ~(length > 0.5)

    def add_slip(self, slip: Slip) -> None:
        """Fill the tangential parts."""
        self.slip = slip
        self.excess[:, 1:] = self.slip.value
        self.force[:, 1:] = self.slip.force
        self.gradients[:, 1:] = self.slip.gradient
        if self.free is not None:
            self.columns[:, 1:] = self.slip.force * self.free[:, None]
            self.gradients[:, 1:] *= self.free[:, None]
            # A sticking node gives up all its displacements.
            self.fixed |= np.any(self.free[:, :3] != 1, axis=1)
