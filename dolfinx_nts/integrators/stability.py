r"""Stability of central differences: the longest step, and energy that must not grow.

Largest stable step of central differences, an estimate on the safe side.

With lumped mass no frequency of an assembly exceeds the highest one of its parts (Irons and
Treharne 1971). That of a cell of degree 1 is taken from its uniform strains, with the moduli at
C = 1: 2 c/h, c the speed of the P-wave in a cell of length h that can move in one direction
only, and more in one that can swell. That of a cell of degree 2 is an eigenvalue. When cells
deform it changes as 1/h. Contact springs add their own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import basix
import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.explicit.penalty import ContactSprings
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.lumped_mass import nodal_parts
from dolfinx_nts.parallel import reductions

__all__ = ["Cells", "Damping", "Stability", "cell_frequency", "highest_frequency", "largest_step"]


# Parts of the estimate: the default step, and the longest step where springs are to be chosen,
# which need what is left.
_DEFAULT, _WITH_SPRINGS = 0.7, 0.9
_GROWTH = 0.25  # of the energy that is taken for an instability
_ROUNDING = 1e-20  # energy relative to that of one cell a step


class Stability:
    """What limits the step. Collective.

    Args:
        bodies: The bodies.
        springs: Springs of the contact pairs.
        mass: Of all bodies [kg].

    Attributes:
        smallest: Length of the smallest cell when it was last looked at [m].
    """

    def __init__(
        self, bodies: Sequence[Body], springs: Sequence[ContactSprings], mass: float
    ) -> None:
        """Compute the frequencies of the cells."""
        self._cells, self._damping = Cells(bodies), Damping.of(bodies)
        self._springs, self._mass = springs, mass
        self.smallest = 0.0
        # Since the state was set: energy then, work since, and its turnover [J].
        self._energy = self._worked = self._turnover = 0.0

    def serialize(self, archive: Archive) -> None:
        """Serialize the energies and the smallest cell."""
        totals = np.array([self._energy, self._worked, self._turnover, self.smallest])
        totals = archive.same("watch", totals)
        self._energy, self._worked, self._turnover, self.smallest = (float(t) for t in totals)

    def longest_step(self, x: Floats) -> float:
        """Estimate of the largest stable step [s].

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
        """
        return largest_step(self._squared_frequency(x), self._damping)

    def room(self, x: Floats) -> tuple[float, float]:
        """Longest step and default [s], with room for springs that are open."""
        estimate = self.longest_step(x)
        part = _WITH_SPRINGS if any(springs.is_open for springs in self._springs) else 1.0
        return part * estimate, _DEFAULT * estimate

    def choose_penalties(self, x: Floats, dt: float) -> float:
        """Choose springs that are open, as stiff as a step allows.

        Args:
            x: As of `longest_step`.
            dt: The step [s].

        Returns:
            The longest step with them [s].
        """
        squared = (self._damping.highest(dt) - self._squared_frequency(x)) / 2
        for springs in self._springs:
            springs.choose_penalty(squared)
        return self.longest_step(x)

    def start(self, energy: float) -> None:
        """Count energy from now on. Local.

        Args:
            energy: Of the state that was set [J].
        """
        self._energy, self._worked, self._turnover = energy, 0.0, 0.0

    def count(self, driven: Sequence[float], lost: float) -> None:
        """Count the work of a step. Local.

        Args:
            driven: Work of loads and of supports [J].
            lost: Of damping and friction [J].
        """
        self._worked += sum(driven) + lost
        self._turnover += sum(map(abs, driven))

    def growth(self, energy: float, dt: float) -> str:
        """What is wrong with an energy; empty if nothing is. Local.

        Args:
            energy: Present energy [J].
            dt: The step [s].
        """
        grown = energy - self._energy - self._worked
        # Round-off of a body at rest is no growth.
        whole = self._mass * (self.smallest / dt) ** 2
        if grown <= _GROWTH * (self._energy + self._turnover) + _ROUNDING * whole:
            return ""
        return f"the energy has grown by {grown:.3g} J"

    def _squared_frequency(self, x: Floats) -> float:
        """Highest squared frequency at positions [1/s^2]."""
        contact = max((springs.squared_frequency for springs in self._springs), default=0.0)
        bulk, self.smallest = self._cells.limits(x)
        return bulk + contact


_SHORTEST_TIME = 1e-150  # of a wave through a cell, whose square is a number [s]
# Cells that are looked at together, of degree 1 and 2.
_BLOCK, _MATRICES = 4096, 64


def cell_frequency(material: Hyperelastic, x: Floats) -> Floats:
    r"""Highest squared frequency of the uniform strains of cells.

    With displacements u = H r of the vertices and lumped mass, the largest value of
    :math:`H : D : H / (\rho_0\, H : H G)`, where D are the moduli at C = 1 and
    :math:`G = \sum_a r_a \otimes r_a / k`. Local.

    Args:
        material: Material of the cells.
        x: Vertices, shape ``(c, k, 3)`` [m, reference].

    Returns:
        Squared frequency, shape ``(c,)`` [1/s^2].
    """
    basis = Hyperelastic.strain_basis()
    D = np.einsum("aij,ab,bmn->ijmn", basis, material.moduli, basis)
    squared: Floats = np.empty(len(x))
    for block in np.split(np.arange(len(x)), range(_BLOCK, len(x), _BLOCK)):
        values, axes = np.linalg.eigh(_moments(x[block]))
        S = axes / np.sqrt(values)[:, None, :]
        K = np.einsum("cjk,ijmn,cnl->cikml", S, D, S, optimize=True)
        squared[block] = np.linalg.eigvalsh(K.reshape(-1, 9, 9))[:, -1] / material.rho
    return squared


def highest_frequency(material: Hyperelastic, element: Element, x: Floats) -> Floats:
    r"""Highest squared frequency of cells with the moduli at C = 1. Local.

    Args:
        material: Material of the cells.
        element: Their element.
        x: Vertices, shape ``(c, k, 3)`` [m, reference].

    Returns:
        Squared frequency, shape ``(c,)`` [1/s^2].
    """
    basis, moduli = Hyperelastic.strain_basis(), material.moduli
    points, weights = basix.make_quadrature(basix.CellType[element.cell], element.stress_degree)
    slopes = element.basix.tabulate(1, points)[1:, :, :, 0]
    linear = Element(element.cell, 1).basix.tabulate(1, points)[1:, :, :, 0]
    squared: Floats = np.empty(len(x))
    for block in np.split(np.arange(len(x)), range(_MATRICES, len(x), _MATRICES)):
        J = np.einsum("jqv,cvi->cqij", linear, x[block])
        gradient = np.einsum("jqa,cqji->cqai", slopes, np.linalg.inv(J))
        volume = np.abs(np.linalg.det(J)) * weights
        scale = 1 / np.sqrt(material.rho * nodal_parts(element, x[block]))
        gradient *= np.sqrt(volume)[:, :, None, None] * scale[:, None, :, None]
        strain = np.einsum("sij,cqaj->cqsai", basis, gradient).reshape(*volume.shape, 6, -1)
        stress = moduli @ strain
        shape = len(block), -1, strain.shape[-1]
        K = strain.reshape(shape).swapaxes(1, 2) @ stress.reshape(shape)
        squared[block] = np.linalg.eigvalsh(K)[:, -1]
    return squared


def _moments(x: Floats) -> Floats:
    """Mean products of the positions of vertices about their centre."""
    r = x - x.mean(axis=1, keepdims=True)
    moments: Floats = r.transpose(0, 2, 1) @ r / x.shape[1]
    return moments


class Cells:
    """The cells of bodies, as far as they limit the step.

    The length of a cell is twice the least radius of gyration of its nodes, the edge of a cube
    of degree 1 (`cpp/nts/geometry/cell_length.h`).

    Args:
        bodies: The bodies, of one space.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        """Compute the speed in each cell, half of its frequency times length."""
        V = bodies[0].V
        self._comm: MPI.Comm = V.mesh.comm
        X, element = V.tabulate_dof_coordinates(), Element.of(V)
        nodes, k = V.dofmap.list, element.pieces.shape[1]
        cells = {
            material: np.concatenate([b.cells for b in bodies if b.material is material])
            for material in dict.fromkeys(body.material for body in bodies)
        }
        self._nodes = np.concatenate([nodes[part] for part in cells.values()])
        squared = []
        for material, part in cells.items():
            x = X[nodes[part, :k]]
            if element.degree == 1:
                squared.append(cell_frequency(material, x))
            else:
                squared.append(highest_frequency(material, element, x))
        self._speed = np.sqrt(np.concatenate(squared)) * _kernels.cell_lengths(X, self._nodes) / 2

    def limits(self, x: Floats) -> tuple[float, float]:
        """Highest squared frequency [1/s^2] and least length [m]. Collective.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
        """
        length = _kernels.cell_lengths(x, self._nodes)
        time = float((length / self._speed).min(initial=np.inf))
        limits = [time, float(length.min(initial=np.inf))]
        least, shortest = reductions.least(self._comm, limits)
        # A cell without any length has no frequency that a number can hold.
        return (2 / least) ** 2 if least > _SHORTEST_TIME else math.inf, shortest


@dataclass(frozen=True)
class Damping:
    """Largest coefficients of Rayleigh damping of several bodies.

    Attributes:
        mass: Coefficient alpha [1/s].
        stiffness: Coefficient beta [s].
    """

    mass: float
    stiffness: float

    @classmethod
    def of(cls, bodies: Sequence[Body]) -> "Damping":
        """Largest coefficients of the bodies' materials."""
        materials = [body.material for body in bodies]
        return cls(
            max(material.mass_damping for material in materials),
            max(material.stiffness_damping for material in materials),
        )

    def highest(self, dt: float) -> float:
        """Squared frequency for which a step is just stable [1/s^2]."""
        return (1 - dt * self.mass / 2) / (dt**2 / 4 + dt * self.stiffness / 2)


def largest_step(squared: float, damping: Damping) -> float:
    r"""Largest stable step [s].

    From :math:`\omega^2 \Delta t^2/4 + (\alpha + \beta \omega^2) \Delta t/2 = 1`, as damping
    lags half a step behind; 0 where the frequency is infinite.

    Args:
        squared: Highest squared frequency without damping [1/s^2].
        damping: The damping.
    """
    if math.isinf(squared):
        return 0.0
    c = (damping.mass + damping.stiffness * squared) / 2
    return float(2 / (c + np.sqrt(c**2 + squared)))
