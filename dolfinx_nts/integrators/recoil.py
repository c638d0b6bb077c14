"""Recoil: rigid motions that bodies have by forces of contact, and the energy of these."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["Recoil"]


class Recoil(NamedTuple):
    r"""Velocities :math:`d_i` that groups of bodies get as if rigid, by impulses of contact.

    Impulses of pair and counterpart have no resultant, so that no multiple changes the momenta. The
    kinetic energy less the work of moving supports and obstacles changes by
    :math:`\alpha \cdot b + \alpha \cdot a \alpha / 2` with :math:`\sum \alpha_i d_i`.

    Attributes:
        fields: Values of 1 and x - centre at the owned nodes of each group, ``(n, 1 + d)``.
        rigid: The velocities as factors of these, by the group whose nodes touch, then by that
            which moves, shape ``(g, g, 1 + d, d)``.
        held: Impulses of supports that these take, at the fixed dofs, likewise.
        linear: The numbers b, shape ``(g,)`` [J].
        square: The matrix a, shape ``(g, g)`` [J].
    """

    fields: Sequence[Floats]
    rigid: Floats
    held: Floats
    linear: Floats
    square: Floats

    @property
    def energy(self) -> Floats:
        """Energy of the motion of groups towards or from each other, ``(g,)`` [J]. Local."""
        a = np.diag(self.square)
        energy: Floats = np.divide(self.linear**2, 2 * a, out=np.zeros_like(a), where=a > 0)
        return energy

    @property
    def most(self) -> Floats:
        """Most energy that factors from -1 to 1 give, shape ``(g,)`` [J]. Local."""
        most: Floats = np.abs(self.linear) + np.diag(self.square) / 2
        return most

    def factors(self, wanted: Floats) -> tuple[Floats, Floats]:
        """Factors by which groups get energy, from -1 to 1, so that no contact pulls. Local.

        Args:
            wanted: Energy that each group should get by its contact, shape ``(g,)`` [J].

        Returns:
            The factors, and the energy that the groups get [J], both ``(g,)``.
        """
        factors, given = np.zeros_like(wanted), np.zeros_like(wanted)
        for i, a in enumerate(np.diag(self.square)):
            if not a > 0:
                continue
            b = self.linear[i] + self.square[i] @ factors
            size = abs(b)
            least = size - a / 2 if size > a else size**2 / (2 * a)
            given[i] = np.clip(wanted[i], -least, size + a / 2)
            root = np.sqrt(max(size**2 + 2 * a * given[i], 0.0))
            if size + root > 0:
                factors[i] = np.copysign(2 * given[i] / (size + root), b * given[i])
        return factors, given

    def velocities(self, factors: Floats) -> list[Floats]:
        """Sum of the velocities times factors, ``(g,)``; of each group ``(n, d)`` [m/s]. Local."""
        return self.at_nodes(np.einsum("i,igcd->gcd", factors, self.rigid))

    def at_nodes(self, parts: Floats) -> list[Floats]:
        """Fields times factors, ``(g, 1 + d, d)``, of each group ``(n, d)``. Local."""
        return [field @ part for field, part in zip(self.fields, parts, strict=True)]
