"""Waves at the surface of bodies, which steps have to resolve for impact to be resolved in time."""

import logging

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["SurfaceWaves"]

_logger = logging.getLogger("dolfinx_nts")

# Cells that waves cross in a step [-] above which a step does not resolve them.
_RESOLVED = 1.0


class SurfaceWaves:
    """How fast waves cross cells at the surface.

    In a chain of springs k between masses m they cross sqrt(k/m) springs a second, and the last
    mass, which is m/2, has the stiffness k. Collective.

    Args:
        comm: Communicator.
        stiffness: That of owned nodes of the surface, shape ``(m,)`` [N/m].
        mass: Lumped mass of these, shape ``(m,)`` [kg].
        degree: Degree of the cells: waves cross halves of those of degree 2.
    """

    def __init__(self, comm: MPI.Comm, stiffness: Floats, mass: Floats, degree: int) -> None:
        ratio = stiffness / (2 * mass)
        fastest = reductions.largest(comm, ratio.max(initial=0.0))
        self._cells_per_second = float(np.sqrt(fastest))
        self._is_told = comm.rank != 0
        self._cell = "cells" if degree == 1 else "halves of cells"

    def tell(self, dt: float) -> None:
        """Say once if a step dt [s] does not resolve what waves do in a cell. Local."""
        crossings = self._cells_per_second * dt
        if self._is_told or crossings <= _RESOLVED:
            return
        self._is_told = True
        _logger.warning(
            "waves cross %.2g %s at the surface in a step, too many for impact 'resolved' "
            "to be of second order in time: harmless, as the energy is exact nevertheless, "
            "but 'elastic' does as well in less time; take dt <= %.2g s to resolve impact",
            crossings,
            self._cell,
            _RESOLVED / self._cells_per_second,
        )
