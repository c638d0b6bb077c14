"""Hexahedra of degree 1 in NumPy: energy, forces, stiffness, mass."""

from typing import NamedTuple

import numpy as np

from benchmarks.peers.scene import NU, RHO, E, Floats, Ints

__all__ = ["Hexahedra"]

LMBDA, MU = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
# Corners of the reference cell in the order of gmsh.
_CORNERS = np.array(
    [
        *((-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)),
        *((-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)),
    ]
)
_POINTS = _CORNERS / np.sqrt(3)


class Hexahedra(NamedTuple):
    """Shape functions and their gradients at the Gauss points of each cell.

    Attributes:
        cells: Nodes, shape ``(c, 8)``.
        phi: Shape functions, shape ``(q, 8)``: point, node.
        gradient: Their reference gradients, shape ``(c, q, 8, 3)``: cell, point, node [1/m].
        weight: Volumes of the points, shape ``(c, q)`` [m^3].
    """

    cells: Ints
    phi: Floats
    gradient: Floats
    weight: Floats

    @classmethod
    def of(cls, X: Floats, cells: Ints) -> "Hexahedra":
        """Make the cells of given nodes, with 2 x 2 x 2 Gauss points."""
        factors = 1 + _POINTS[:, None] * _CORNERS
        phi = factors.prod(axis=2) / 8
        slopes = [_CORNERS[:, d] * np.delete(factors, d, axis=2).prod(axis=2) / 8 for d in range(3)]
        slope = np.stack(slopes, axis=2)
        jacobian = np.einsum("cai,qad->cqid", X[cells], slope)
        gradient = np.einsum("qad,cqdi->cqai", slope, np.linalg.inv(jacobian))
        return cls(cells, phi, gradient, np.linalg.det(jacobian))

    @classmethod
    def of_one_point(cls, X: Floats, cells: Ints) -> "Hexahedra":
        """The same cells with one point, at which gradients are the cell means."""
        full = cls.of(X, cells)
        volume = full.weight.sum(axis=1, keepdims=True)
        mean = np.einsum("cq,cqai->cai", full.weight / volume, full.gradient)
        return cls(cells, full.phi.mean(axis=0, keepdims=True), mean[:, None], volume)

    def mass(self) -> Floats:
        """Consistent mass of each cell, shape ``(c, 8, 8)`` [kg]."""
        return RHO * np.einsum("cq,qa,qb->cab", self.weight, self.phi, self.phi)

    def momentum(self, v: Floats, is_lumped: bool = False) -> Floats:
        """Mass, consistent or lumped, times nodal velocities, shape ``(n, 3)`` [kg m/s]."""
        mass = self.mass()
        some = mass.sum(axis=2)[..., None] * v[self.cells] if is_lumped else mass @ v[self.cells]
        return self._nodal(some, len(v))

    def _nodal(self, values: Floats, n: int) -> Floats:
        result = np.zeros((n, 3))
        np.add.at(result, self.cells, values)
        return result

    def _state(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Deformation gradient, Green-Lagrange strain and stress at the points."""
        F = np.einsum("cai,cqaj->cqij", x[self.cells], self.gradient)
        strain = (np.einsum("cqki,cqkj->cqij", F, F) - np.eye(3)) / 2
        trace = np.einsum("cqii->cq", strain)
        return F, strain, LMBDA * trace[..., None, None] * np.eye(3) + 2 * MU * strain

    def energy(self, x: Floats) -> float:
        """Energy of St. Venant and Kirchhoff [J]."""
        return self.energy_of_volume(x) + self.energy_of_shape(x)

    def energy_of_volume(self, x: Floats) -> float:
        """Volumetric term of the energy, of the trace of the strain [J]."""
        trace = np.einsum("cqii->cq", self._state(x)[1])
        return float(LMBDA / 2 * np.vdot(self.weight, trace**2))

    def energy_of_shape(self, x: Floats) -> float:
        """Deviatoric term of the energy, of the square of the strain [J]."""
        strain = self._state(x)[1]
        return float(MU * np.einsum("cq,cqij,cqij->", self.weight, strain, strain))

    def forces(self, x: Floats) -> Floats:
        """Gradient of the energy, shape ``(n, 3)`` [N]."""
        F, _, S = self._state(x)
        P = np.einsum("cq,cqij,cqjk->cqik", self.weight, F, S)
        return self._nodal(np.einsum("cqik,cqak->cai", P, self.gradient), len(x))

    def stiffness(self, x: Floats) -> Floats:
        """Hessian of the energy cell by cell, shape ``(c, 24, 24)`` [N/m]."""
        F, _, S = self._state(x)
        # Variation of the strain by node a in direction i.
        strain = np.einsum("cqik,cqaj->cqaijk", F, self.gradient)
        strain = (strain + strain.swapaxes(-1, -2)) / 2
        c, q, a = strain.shape[:3]
        strain = strain.reshape(c, q, 3 * a, 9)
        volume = strain[..., ::4].sum(axis=3)
        material = 2 * MU * strain @ strain.swapaxes(-1, -2)
        material += LMBDA * volume[..., :, None] * volume[..., None, :]
        initial = np.einsum("cqaj,cqjk,cqbk->cqab", self.gradient, S, self.gradient)
        whole = material.reshape(c, q, a, 3, a, 3)
        for d in range(3):
            whole[:, :, :, d, :, d] += initial
        return np.einsum("cq,cqaibj->caibj", self.weight, whole).reshape(c, 24, 24)
