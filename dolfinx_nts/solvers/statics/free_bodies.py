"""Bodies without supports, with their free rigid motions."""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from dolfinx import la

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints, indices
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["FreeBody", "find_free_bodies"]

# Stiffness against a rigid motion, relative to the nodes' [-], below which it is round-off.
_NO_RESISTANCE = 1e-10
# Tolerance for a unit motion to lie in the space of free motions [-].
_ROUNDING = 1e-6


@dataclass(frozen=True)
class FreeBody:
    """Bodies connected by shared nodes, without support by boundary conditions or loads.

    Attributes:
        bodies: The bodies.
        nodes: Their owned nodes, shape ``(n,)``.
        centre: Centre of the rotations, shape ``(3,)`` [m].
        size: Length by which rotations are divided [m].
        motions: Free motions as combinations of translations in x, y, z and rotations about these
            axes, shape ``(6, k)``; in the plane in x, y and about z, ``(3, k)``.
    """

    bodies: Sequence[Body]
    nodes: Ints
    centre: Floats
    size: float
    motions: Floats

    def at(self, x: Floats) -> Floats:
        """Free motions at positions, ``(..., 3)`` [m], shape ``(k, ..., 3)`` [-]. Local."""
        units = _rigid_motions(x, self.centre, self.size, len(self.motions) == 3)
        motions: Floats = np.einsum("ik,i...->k...", self.motions, units)
        return motions

    def __str__(self) -> str:
        part = np.linalg.norm(self.motions, axis=1)
        whole = part > 1 - _ROUNDING
        motions = []
        axes = ("xyz", "xyz") if len(part) == 6 else ("xy", "z")
        parts = whole[: len(axes[0])], whole[len(axes[0]) :]
        for kind, names, some in zip(
            ("translation in", "rotation about"), axes, parts, strict=True
        ):
            if some.any():
                motions.append(f"{kind} {', '.join(np.array(list(names))[some])}")
        if others := self.motions.shape[1] - int(np.count_nonzero(whole)):
            motions.append(f"{others} other rigid motions")
        return f"{' and '.join(body.name for body in self.bodies)} (free: {', '.join(motions)})"


def find_free_bodies(
    bodies: Sequence[Body], bulk: Bulk, tangent: Tangent, x: Floats
) -> list[FreeBody]:
    """Find the bodies with rigid motions that no boundary condition or load resists. Collective.

    Args:
        bodies: All bodies.
        bulk: Their residual and its derivative, with supports and loads.
        tangent: Matrix of the derivative, for the stiffness of the nodes.
        x: Positions of the owned nodes, shape ``(n, 3)`` [m].
    """
    comm, stiffness = bulk.comm, tangent.nodal_stiffness()
    groups = connected(bodies)
    nodes = [_owned_nodes(group) for group in groups]
    frames = [_frame(comm, x[some]) for some in nodes]
    dim = bulk.rigid.dim
    num_motions = {2: 3, 3: 6}[dim]
    motions = np.zeros((num_motions, len(x), dim))
    for some, frame in zip(nodes, frames, strict=True):
        motions[:, some] = _rigid_motions(x[some], *frame, dim == 2)[..., :dim]
    forces = np.array([bulk.action(motion) for motion in motions])
    # Supports and guides resist with the stiffness of the nodes.
    held = np.zeros((len(x), dim), dtype=bool)
    held.flat[bulk.supports.fixed] = True
    forces[:, held] = (motions * stiffness[:, None])[:, held]
    guided = np.zeros_like(motions)
    if bulk.rigid.exists:
        guided += [bulk.rigid.guides.constrained(motion) for motion in motions]
    found = []
    for group, some, frame in zip(groups, nodes, frames, strict=True):
        modes = motions[:, some].reshape(num_motions, -1)
        stretches = guided[:, some].reshape(num_motions, -1)
        weight = np.repeat(stiffness[some], dim)
        products = np.stack(
            [
                modes @ forces[:, some].reshape(num_motions, -1).T
                + stretches * weight @ stretches.T,
                modes * weight @ modes.T,
            ]
        )
        resistance, scale = reductions.total(comm, products)
        # Forces do almost no work in free motions.
        values, vectors = np.linalg.eigh((resistance + resistance.T) / 2 / np.trace(scale))
        free = vectors[:, np.abs(values) < _NO_RESISTANCE]
        if free.size:
            found.append(FreeBody(tuple(group), some, *frame, free))
    return found


def _owned_nodes(bodies: Sequence[Body]) -> Ints:
    """Owned nodes of the cells of bodies on all ranks. Collective."""
    index_map = bodies[0].V.dofmap.index_map
    # A node may be owned by a rank that has no cell of the body.
    marker = la.vector(index_map)
    for body in bodies:
        marker.array[body.nodes] = 1
    marker.scatter_reverse(la.InsertMode.add)
    return indices(marker.array[: index_map.size_local])


def _frame(comm: MPI.Comm, x: Floats) -> tuple[Floats, float]:
    """Centre of nodes and largest distance from it [m]. Collective."""
    *total, count = reductions.total(comm, np.array([*x.sum(axis=0), len(x)]))
    centre = np.array(total) / count
    size = _kernels.largest_size(x - centre)
    return centre, reductions.largest(comm, size) or 1.0


def _rigid_motions(x: Floats, centre: Floats, size: float, is_plane: bool) -> Floats:
    """Translations and rotations at positions, ``(6, ..., 3)``, three in the plane [-]. Local."""
    units = np.broadcast_to(np.eye(3).reshape(3, *[1] * (x.ndim - 1), 3), (3, *x.shape))
    motions: Floats = np.concatenate([units, np.cross(units, (x - centre) / size)])
    return motions.take([0, 1, 5], axis=0) if is_plane else motions
