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

__all__ = ["Cells", "Damping", "cell_length", "largest_step", "wave_speed"]

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


class Cells:
    """The cells of bodies, as far as they limit the step.

    Args:
        bodies: The bodies, of one space.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        """Compute the speed in each cell."""
        V = bodies[0].V
        self._comm: MPI.Comm = V.mesh.comm
        cells = np.concatenate([body.cells for body in bodies])
        self._vertices = V.dofmap.list[cells]
        materials = {body.material for body in bodies}
        speeds = {material: wave_speed(material) for material in materials}
        self._speed = np.concatenate(
            [np.full(len(body.cells), speeds[body.material]) for body in bodies]
        )

    def limits(self, x: Floats) -> tuple[float, float]:
        """Highest squared frequency [1/s^2] and least length [m]. Collective.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
        """
        length = cell_length(x[self._vertices])
        time = (length / self._speed).min(initial=np.inf)
        limits = np.array([time, length.min(initial=np.inf)])
        self._comm.Allreduce(MPI.IN_PLACE, limits, op=MPI.MIN)
        with np.errstate(divide="ignore"):
            return float((2 / limits[0]) ** 2), float(limits[1])


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
