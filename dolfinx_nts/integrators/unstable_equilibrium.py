"""Equilibria of statics that bodies would leave, as a straight column beyond its buckling load."""

import logging
from collections.abc import Sequence
from itertools import chain

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.model.bodies import Body

__all__ = ["UnstableEquilibrium"]

_logger = logging.getLogger("dolfinx_nts")


class UnstableEquilibrium:
    """Tells when equilibria begin to be unstable, and again after stable ones. Collective.

    Args:
        comm: Communicator.
        bodies: All bodies.
    """

    def __init__(self, comm: MPI.Comm, bodies: Sequence[Body]) -> None:
        self._comm, self._bodies, self._is_told = comm, bodies, False

    def look(self, motion: Floats | None, X: Floats, t: float) -> None:
        """Look at an equilibrium.

        Args:
            motion: Motion of the owned nodes along which the energy falls, shape ``(n, d)``; None
                if there is none.
            X: Their reference positions, shape ``(n, 3)`` [m].
            t: Time [s].
        """
        is_new, self._is_told = motion is not None and not self._is_told, motion is not None
        if motion is None or not is_new:
            return
        size = np.linalg.norm(motion, axis=1)
        found = [
            (size[node], self._comm.rank, self._names(node), X[node], in_space(motion)[node])
            for node in np.argsort(size)[-1:]
        ]
        every = chain(*self._comm.allgather(found))
        largest, _, name, place, way = max(every, key=lambda each: each[:2])
        if self._comm.rank == 0:
            _logger.warning(
                "at t = %g the equilibrium is unstable, as in buckling: there is a motion, of %s "
                "most near (%s) along (%s), along which the energy of bodies and loads falls, and "
                "bodies would leave it at the least disturbance; a small force or imperfection in "
                "that direction, and smaller steps, lead to what they do instead",
                *(t, name, _listed(place), _listed(way / largest)),
            )

    def _names(self, node: int) -> str:
        """Bodies with an owned node. Local."""
        return " and ".join(body.name for body in self._bodies if node in body.nodes)


def _listed(values: Floats) -> str:
    """Components to two digits of the largest. Local."""
    digits = 1 - int(np.floor(np.log10(np.abs(values).max() or 1.0)))
    return ", ".join(f"{value:g}" for value in np.round(values, digits) + 0.0)
