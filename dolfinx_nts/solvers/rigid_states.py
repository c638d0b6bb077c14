"""Rigid bodies of a stepper: their states, which nodal displacements and velocities have."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.guides import Guides
from dolfinx_nts.solvers.linear_fields import LinearFields, combined, nearest, rigid_motions

__all__ = ["RigidStates"]

# Part of its size, or of its speed, by which a given state may deform a rigid body [-].
_NOT_RIGID = 1e-8


class RigidStates:
    """States of all rigid bodies. Collective, as are all methods.

    Vectors are nodal, over the owned nodes of the space, shape ``(n, d)``. What there is of each
    body, as the coefficients of linear fields ``(d + 1, d)``, has the bodies first, ``b`` of them:
    all are computed at once.

    Args:
        V: Space of the displacement.
        bodies: Linear fields over each rigid body.

    Attributes:
        dim: Dimension of the space, d.
        guides: What holds and leads the bodies.
        exists: Whether there are rigid bodies, on any rank.
        nodes: Owned nodes of rigid bodies, sorted.
    """

    def __init__(self, V: fem.FunctionSpace, bodies: Sequence[LinearFields]) -> None:
        """Keep the bodies, whose states are still to be given."""
        self._comm: MPI.Comm = V.mesh.comm
        self._bodies, self.guides = tuple(bodies), Guides(self._comm, bodies)
        self.dim, self.exists = dimension(V), bool(bodies)
        none = np.empty(0, dtype=np.int32)
        self._at: Ints = np.concatenate([none, *(body.nodes for body in bodies)])
        self.nodes: Ints = np.unique(self._at)
        self._given: set[tuple[LinearFields, str]] = set()
        if not self.exists:
            return
        self._values: Floats = np.concatenate([body.values for body in bodies])
        self._counts = np.array([len(body.nodes) for body in bodies])
        self._products, self._reference = (
            np.array([getattr(body, name) for body in bodies]) for name in ("products", "reference")
        )
        # Each body has as many free motions as its guide leaves it. Rows of zeros fill the rest,
        # whose amounts are zero by equations of their own.
        k = bodies[0].free.shape[1]
        self._free: Floats = np.zeros((len(bodies), k, k))
        for i, body in enumerate(bodies):
            self._free[i, : len(body.free)] = body.free
        self._no_motion: Floats = np.eye(k) * (~np.any(self._free != 0, axis=2))[:, None]

    def given(self, body: Body, name: str) -> None:
        """Let the next `check` look at all nodes of a body, whose state was given. Local.

        ``name`` is ``"displacement"`` or ``"velocity"``.
        """
        self._given |= {(each, name) for each in self._bodies if each.body is body}

    def restored(self) -> None:
        """Take the state of all bodies as one that steps have left. Local."""
        self._given = set()

    def check(self, u: Floats, v: Floats) -> None:
        """Raise unless displacements u [m], and velocities v [m/s] that were given, are rigid.

        Raises:
            ValueError: A body is deformed, or its velocity would deform it.
        """
        if not self.exists:
            return
        # After a step velocities are rigid only in the mean of the step.
        of_u, of_v = self._sums(u, v)
        q, fields = self._positions(of_u), self._fit(of_u)
        directors, motions = q[:, 1:], rigid_motions(q)
        gram = directors @ directors.transpose(0, 2, 1)
        strains = np.abs(gram - np.eye(self.dim)).max(axis=(1, 2))
        velocities = combined(nearest(motions, self._products, of_v), motions)
        for i, body in enumerate(self._bodies):
            misfits = {"displacement": strains[i]}
            if (body, "displacement") in self._given:
                bent = self._greatest(body, u, fields[i]) / body.size
                misfits["displacement"] = max(misfits["displacement"], bent)
            if (body, "velocity") in self._given:
                rest = self._greatest(body, v, velocities[i])
                misfits["velocity"] = rest / (self._greatest(body, v, 0 * velocities[i]) or 1.0)
            for name, misfit in misfits.items():
                if misfit > _NOT_RIGID:
                    raise ValueError(
                        f"expected a {name} of the rigid {body.body.name} that moves and turns it "
                        f"as a whole from where it is, given one that deforms it by {misfit:.2g}"
                    )
        self.restored()

    def _greatest(self, body: LinearFields, values: Floats, field: Floats) -> float:
        """Greatest component of values at the nodes of a body less a field."""
        rest = values[body.nodes] - body.values @ field
        return reductions.largest(self._comm, float(np.abs(rest).max(initial=0.0)))

    def _sums(self, *vectors: Floats) -> Floats:
        """Total products of the linear fields with ``f`` vectors, ``(f, b, d + 1, d)``."""
        at_nodes = np.array([vector[self._at] for vector in vectors])
        products = self._values[:, :, None] * at_nodes[:, :, None]
        sums = np.zeros((len(vectors), len(self._bodies), *products.shape[2:]))
        has_nodes = self._counts > 0
        if has_nodes.any():
            starts = (np.cumsum(self._counts) - self._counts)[has_nodes]
            sums[:, has_nodes] = np.add.reduceat(products, starts, axis=1)
        total: Floats = reductions.total(self._comm, sums)
        return total

    def _fit(self, sums: Floats) -> Floats:
        """Coefficients of the fields that have some sums, ``(b, d + 1, d)``. Local."""
        return np.asarray(np.linalg.solve(self._products, sums), dtype=np.float64)

    def _positions(self, sums: Floats) -> Floats:
        """Coefficients of the positions by the sums of displacements, ``(b, d + 1, d)``. Local."""
        positions: Floats = self._reference + self._fit(sums)
        return positions

    def _in_freedom(self, amounts: Floats) -> Floats:
        """Part of amounts of motions, ``(b, k)``, in which guides leave the bodies free. Local."""
        free: Floats = self._free.transpose(0, 2, 1) @ (self._free @ amounts[..., None])
        return free[..., 0]

    def _put(self, fields: Floats, values: Floats) -> Floats:
        """Set values to the field of each body, ``(b, d + 1, d)``. Local."""
        of_nodes = np.repeat(fields, self._counts, axis=0)
        values[self._at] = (self._values[:, None] @ of_nodes)[:, 0]
        return values
