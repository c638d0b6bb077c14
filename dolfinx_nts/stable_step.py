r"""Largest stable step of central differences, an estimate on the safe side.

With lumped mass no frequency of an assembly exceeds the highest one of its
parts (Irons and Treharne 1971). That of a cell is bounded by
:math:`2 c / h`, with the speed :math:`c = \sqrt{\kappa/\rho_0}` of the largest
modulus at C = 1 (that of the P-wave if there is no lateral contraction,
more otherwise: a single cell also swells) and the length h of the cell.
Contact springs add their own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_nts.bodies import Body
from dolfinx_nts.materials import Hyperelastic

__all__ = [
    "Damping",
    "cell_length",
    "largest_step",
    "smallest_cell",
    "squared_frequency",
    "wave_speed",
]

Floats = npt.NDArray[np.float64]


def cell_length(x: Floats) -> Floats:
    r"""Length of cells for waves along their thinnest direction.

    Twice the least radius of gyration of the vertices,
    :math:`h^2 = 4 \lambda_{min}(\sum_a r_a \otimes r_a)/k`: the edge of a
    cube. The lumped mass of the cell then makes 2 c/h its highest frequency
    of uniform strain. Local.

    Args:
        x: Vertices, shape ``(c, k, 3)`` [m].

    Returns:
        Length, shape ``(c,)`` [m].
    """
    r = x - x.mean(axis=1, keepdims=True)
    moments = np.einsum("cai,caj->cij", r, r) / x.shape[1]
    length: Floats = 2 * np.sqrt(np.maximum(np.linalg.eigvalsh(moments)[:, 0], 0.0))
    return length


def wave_speed(material: Hyperelastic) -> float:
    """Speed of the stiffest strain at C = 1 [m/s]."""
    return float(np.sqrt(np.linalg.eigvalsh(material.moduli())[-1] / material.rho))


def squared_frequency(bodies: Sequence[Body], x: Floats) -> float:
    """Bound of the highest squared frequency of bodies [1/s^2]. Collective.

    Args:
        bodies: The bodies.
        x: Positions of the local nodes, shape ``(l, 3)`` [m].
    """
    highest = 0.0
    for body in bodies:
        if len(body.cells):
            h = cell_length(x[body.V.dofmap.list[body.cells]]).min()
            speed = 2 * wave_speed(body.material)
            highest = max(highest, (speed / h) ** 2 if h > 0 else np.inf)
    return float(bodies[0].V.mesh.comm.allreduce(highest, op=MPI.MAX))


def smallest_cell(bodies: Sequence[Body], x: Floats) -> float:
    """Least length of a cell of bodies [m]. Collective.

    Args:
        bodies: The bodies.
        x: Positions of the local nodes, shape ``(l, 3)`` [m].
    """
    lengths = [cell_length(x[body.V.dofmap.list[body.cells]]) for body in bodies]
    smallest = np.concatenate(lengths).min(initial=np.inf)
    return float(bodies[0].V.mesh.comm.allreduce(smallest, op=MPI.MIN))


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

    From :math:`\omega^2 \Delta t^2/4 + (\alpha + \beta \omega^2) \Delta t/2 = 1`,
    as damping lags half a step behind.

    Args:
        squared: Highest squared frequency without damping [1/s^2].
        damping: The damping.
    """
    c = (damping.mass + damping.stiffness * squared) / 2
    return float(2 / (c + np.sqrt(c**2 + squared)))
