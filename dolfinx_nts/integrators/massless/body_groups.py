"""Groups of bodies that share nodes."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints, indices
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.extrapolation import group_of_nodes
from dolfinx_nts.parallel import reductions

__all__ = ["BodyGroups"]


class BodyGroups:
    """Owned nodes by the groups of connected bodies. Collective, as is `sums`.

    Args:
        bodies: Bodies of one space, which fill the mesh.

    Attributes:
        comm: Communicator of the mesh.
        number_of: Group number of each owned node, shape ``(n,)``.
        nodes: Owned nodes of each of the g groups.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        V = bodies[0].V
        self.comm: MPI.Comm = V.mesh.comm
        self.number_of: Ints = group_of_nodes(bodies)[: V.dofmap.index_map.size_local]
        numbers = range(1 + reductions.largest(self.comm, int(self.number_of.max(initial=0))))
        self.nodes = [indices(self.number_of == each) for each in numbers]

    def sums(self, nodes: Ints | slice, values: Floats) -> Floats:
        """Sum values at owned nodes, ``(k,)``, by groups; shape ``(g,)``, of all ranks."""
        sums = np.zeros(len(self.nodes))
        np.add.at(sums, self.number_of[nodes], values)
        return reductions.total(self.comm, sums)
