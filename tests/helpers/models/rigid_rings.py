"""Scenes of rigid bodies of revolution: a dome above a soft round block."""

from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinx_nts as nts
from helpers.laws import NODAL
from helpers.models.plane import block
from helpers.models.rings import RUBBER
from helpers.models.round import plane_mesh, tagged

__all__ = ["DOME_MASS", "STIFFNESS", "DomeOnBlock", "dome_on_block", "spring_of"]

RIM, HIGH, ROUND, DENSITY = 0.7, 0.4, 0.2, 2.0e3  # m, m, 1/m, kg/m^3
# All points of the dome are lifted by the same function of the radius.
DOME_MASS = np.pi * RIM**2 * HIGH * DENSITY
STIFFNESS = 4.0e4  # of the spring [N/m]


class DomeOnBlock(NamedTuple):
    """A round block 1 m in radius and 0.5 m high, and a rigid dome above it."""

    V: fem.FunctionSpace
    block: nts.Body
    dome: nts.RigidBody
    surfaces: list[nts.Surface]

    @property
    def bodies(self) -> list[nts.Body]:
        """Both bodies."""
        return [self.block, self.dome]

    @property
    def clamp(self) -> fem.DirichletBC:
        """Condition that clamps the bottom of the block."""
        foot = fem.locate_dofs_geometrical(self.V, lambda x: x[1] < -0.5 + 1e-9)
        return fem.dirichletbc(np.zeros(2), foot, self.V)

    def pair(self, *, rigid_nodes: bool = False, **laws: Any) -> nts.ContactPair:
        """Nodes of the block against the dome, or vice versa."""
        surfaces = self.surfaces[::-1] if rigid_nodes else self.surfaces
        return nts.ContactPair(*surfaces, **(NODAL | laws))


def dome_on_block(
    comm: MPI.Comm,
    guide: nts.Guide | None = None,
    *,
    cell: str = "quadrilateral",
    degree: int = 1,
    inner: float = 0.0,
    both_rigid: bool = False,
) -> DomeOnBlock:
    """Mesh both bodies.

    Args:
        comm: Communicator of the mesh.
        guide: That of the dome.
        cell: Shape of cells.
        degree: That of the displacement.
        inner: Radius of a hole along the axis of the dome [m].
        both_rigid: Whether the block does not deform either.
    """
    lower = block((0.0, -0.5), (1.0, 0.5), (8, 4))
    points, quads = block((inner, 0.02), (RIM - inner, HIGH), (5, 2))
    points[:, 1] += ROUND * (points[:, 0] ** 2 - inner**2)
    domain = plane_mesh(comm, lower, (points, quads), cell=cell)
    nts.axisymmetric(domain)
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    tags = tagged(domain, lambda x: x[:, 1] > 0)
    soft: nts.Body = nts.Body(V, tags, 1, nts.NeoHookean(**RUBBER))
    if both_rigid:
        soft = nts.RigidBody(V, tags, 1, RUBBER["rho"])
    dome = nts.RigidBody(V, tags, 2, DENSITY, guide)
    top = nts.boundary_of(soft, where=lambda x: x[1] > -1e-9)
    bottom = nts.boundary_of(dome, where=lambda x: x[1] < 0.03 + ROUND * (x[0] ** 2 - inner**2))
    return DomeOnBlock(V, soft, dome, [top, bottom])


def spring_of(scene: DomeOnBlock) -> nts.FormLoad:
    """A spring along the axis from the dome to a base that moves down, spread over its cells."""
    domain, cells = scene.V.mesh, np.sort(scene.dome.cells)
    tags = mesh.meshtags(domain, 2, cells, np.ones(len(cells), dtype=np.int32))
    r, dx = ufl.SpatialCoordinate(domain)[0], ufl.Measure("dx", domain, subdomain_data=tags)(1)
    per_volume = STIFFNESS / (DOME_MASS / DENSITY)  # N/m^4
    return nts.FormLoad(
        scene.V,
        lambda u, eta, t: -per_volume * (u[1] + 0.1 * t) * eta[1] * 2 * np.pi * r * dx,
    )
