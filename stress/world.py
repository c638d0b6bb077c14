"""Mesh, bodies, contact pairs and stepper made of parts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import create_mesh, meshtags

import dolfinx_nts as nts
from dolfinx_nts import compat
from stress.parts import Array, Ints, Part

__all__ = ["NODAL", "Frame", "Touch", "World"]

# The rows of the suite use node-to-segment contact with elastic impact.
NODAL: dict[str, Any] = {"enforcement": nts.LagrangeMultiplier(), "method": "node-to-segment"}


@dataclass(frozen=True)
class Touch:
    """A contact pair by the names of its surfaces, ``part.side``, joined by ``+``.

    Attributes:
        nodes: Surface whose nodes may touch.
        segments: The other surface, or a rigid obstacle.
        how: Arguments of `ContactPair`: enforcement, friction, method; `NODAL` where not given.
        both: Whether nodes of both sides touch, in two half passes.
    """

    nodes: str
    segments: Any
    how: Mapping[str, Any] = field(default_factory=dict)
    both: bool = False


@dataclass(frozen=True)
class Frame:
    """Transformation of a scene: a rotation matrix, and a factor of all lengths.

    Velocities and materials stay, so that times grow with the lengths and
    all is similar.
    """

    turn: Array = field(default_factory=lambda: np.eye(3))
    length: float = 1.0

    def of(self, part: Part) -> Part:
        """Transformed part."""
        velocity = part.velocity

        def flying(x: Array) -> Any:
            return self.turn @ velocity(self.turn.T @ x / self.length)

        return replace(
            part,
            X=self.length * part.X @ self.turn.T,
            velocity=flying if callable(velocity) else self.turn @ velocity,
        )


class World:
    """A distributed mesh of parts; collective, as its methods.

    Args:
        comm: Communicator.
        parts: Parts by name.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for parts of one grid.
        degree: Of the displacement.
        frame: How the parts are seen.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        parts: Mapping[str, Part],
        cell: str = "hexahedron",
        degree: int = 1,
        frame: Frame | None = None,
    ) -> None:
        """Distribute the mesh and make the bodies."""
        self.frame = Frame() if frame is None else frame
        parts = {name: self.frame.of(part) for name, part in parts.items()}
        self.parts, self._sides = parts, {}
        X, cells, owner, first = [], [], [], 0
        for number, (name, part) in enumerate(parts.items()):
            own, sides = part.cells, part.sides
            if cell == "tetrahedron":
                own, sides = part.tetrahedra()
            self._sides |= {f"{name}.{side}": first + f for side, f in sides.items()}
            X.append(part.X)
            cells.append(first + own)
            owner.append(np.full(len(own), number))
            first += len(part.X)
        rows = slice(None) if comm.rank == 0 else slice(0)
        # As of meshes by gmsh, with which they share kernels.
        equispaced = basix.LagrangeVariant.equispaced
        element = basix.ufl.element("Lagrange", cell, 1, equispaced, shape=(3,))
        mesh = create_mesh(comm=comm, cells=np.vstack(cells)[rows], x=np.vstack(X)[rows], e=element)
        for dims in ((2, 0), (2, 3), (3, 2)):
            mesh.topology.create_connectivity(*dims)
        tags = np.concatenate(owner)[mesh.topology.original_cell_index].astype(np.int32)
        cell_tags = meshtags(mesh, 3, np.arange(len(tags), dtype=np.int32), tags)
        self.V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        self._facet_ids = self._facets()
        self.bodies = {
            name: nts.Body(self.V, cell_tags, number, part.material)
            for number, (name, part) in enumerate(parts.items())
        }

    def _facets(self) -> Ints:
        """Input numbers of the nodes of local facets, sorted."""
        mesh = self.V.mesh
        topology, nodes = mesh.topology, compat.geometry_nodes(mesh)
        ids = np.empty(
            topology.index_map(0).size_local + topology.index_map(0).num_ghosts, dtype=np.int64
        )
        to_vertex = topology.connectivity(3, 0).array.reshape(nodes.shape)
        ids[to_vertex] = mesh.geometry.input_global_indices[nodes]
        k = {"hexahedron": 4, "tetrahedron": 3}[topology.cell_name()]
        return np.sort(ids[topology.connectivity(2, 0).array.reshape(-1, k)], axis=1)

    def surface(self, names: str) -> nts.Surface:
        """Surface ``part.side``, or several joined by ``+``."""
        wanted = np.sort(np.vstack([self._sides[name] for name in names.split("+")]), axis=1)
        both = np.concatenate([wanted, self._facet_ids])
        _, number = np.unique(both, axis=0, return_inverse=True)
        number = number.ravel()
        local = np.flatnonzero(np.isin(number[len(wanted) :], number[: len(wanted)]))
        local = local.astype(np.int32)
        tags = meshtags(self.V.mesh, 2, local, np.ones(len(local), dtype=np.int32))
        return nts.Surface(self.V, tags, 1)

    def dofs(self, names: str) -> Any:
        """Nodes of a surface, local block indices, owned and ghost."""
        surface = self.surface(names)
        return np.unique(np.concatenate([surface.nodes, surface.segments.ravel()]))

    def stepper(
        self,
        touches: Sequence[Touch],
        dt: float | None,
        scheme: Any = nts.EnergyMomentum,
        gravity: Any = None,
        pairs: Sequence[nts.ContactPair] = (),
        **options: Any,
    ) -> Any:
        """Stepper of all bodies, with the velocities of the parts and the transformed ``dt``.

        Without dt the scheme chooses it.
        """
        pairs = [*pairs, *(pair for touch in touches for pair in self._pairs(touch))]
        bodies = list(self.bodies.values())
        loads = [] if gravity is None else [nts.Gravity(bodies, gravity)]
        if dt is not None:
            options["dt"] = self.frame.length * dt
        stepper = scheme(bodies, pairs, loads=loads, **options)
        for name, body in self.bodies.items():
            velocity = self.parts[name].velocity
            if callable(velocity) or np.any(velocity):
                stepper.set_velocity(body, velocity)
        return stepper

    def _pairs(self, touch: Touch) -> list[nts.ContactPair]:
        nodes, segments = self.surface(touch.nodes), touch.segments
        if isinstance(segments, str):
            segments = nodes if segments == touch.nodes else self.surface(segments)
        if touch.both:
            return nts.two_half_passes(nodes, segments, **touch.how)
        given = {name: value for name, value in touch.how.items() if value is not None}
        return [nts.ContactPair(nodes, segments, **(NODAL | given))]
