"""Rigid motions of a group of bodies: those that its supports leave, and those that they lead."""

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["GroupMotions"]

# Mean square of a rigid motion at supports, relative to that of all of them [-], that is none.
_NO_MOTION = 1e-12


class GroupMotions:
    """Motions as factors of the fields 1 and x - centre, ``(1 + d, d)``. Local, as its methods.

    Args:
        motions: Independent ones, shape ``(k, 1 + d, d)``.
        gram: Products of the fields with regard to the mass, shape ``(1 + d, 1 + d)``.
        at_supports: Products of the fields at nodes that are held in a direction, one direction
            after the other, shape ``(1 + d, d (1 + d))``.
    """

    def __init__(self, motions: Floats, gram: Floats, at_supports: Floats) -> None:
        _, fields, d = motions.shape
        self._shape = fields, d
        self._basis = basis = motions.reshape(len(motions), -1)
        held = np.einsum("aib,kbi->kai", at_supports.reshape(fields, d, fields), motions)
        products = basis @ (gram @ motions).reshape(basis.shape).T
        weights = basis @ held.reshape(basis.shape).T
        size = np.sqrt(np.diag(products))
        scale = 1 / np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(weights * scale * scale[:, None])
        vectors *= scale[:, None]
        stays = values <= _NO_MOTION * max(values[-1], 0.0)
        self._free, self._led = vectors[:, stays], vectors[:, ~stays] / np.sqrt(values[~stays])
        self._inertia = self._free.T @ products @ self._free

    def by_impulses(self, impulses: Floats) -> Floats:
        """Motions that supports leave, by products of the fields with impulses.

        Both have the shape ``(r, 1 + d, d)``.
        """
        right = self._free.T @ self._amounts(impulses)
        return self._motions(self._free @ np.linalg.lstsq(self._inertia, right, rcond=None)[0])

    def at_supports(self, products: Floats) -> Floats:
        """Motions whose values at supports have products with the fields, ``(r, 1 + d, d)``.

        So far as supports can: a velocity of supports gives the motion nearest to it, and impulses
        give the smallest ones of supports that have their resultant and moment.
        """
        return self._motions(self._led @ (self._led.T @ self._amounts(products)))

    def _amounts(self, products: Floats) -> Floats:
        """Products with each motion, shape ``(k, r)``."""
        amounts: Floats = self._basis @ products.reshape(len(products), -1).T
        return amounts

    def _motions(self, amounts: Floats) -> Floats:
        """Sums of the motions times amounts, ``(k, r)``."""
        return (amounts.T @ self._basis).reshape(-1, *self._shape)
