"""Rigid bodies of a stepper: their states, which nodal displacements and velocities have."""

from collections.abc import Iterable, Sequence

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.guides import Guides
from dolfinx_nts.solvers.linear_fields import LinearFields, nearest, rigid_motions

__all__ = ["RigidStates"]

# Part of its size, or of its speed, by which a given state may deform a rigid body [-].
_NOT_RIGID = 1e-8


class RigidStates:
    """States of all rigid bodies. Collective, as are all methods.

    Vectors are nodal, over the owned nodes of the space, shape ``(n, d)``.

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
        self.nodes: Ints = np.unique(np.concatenate([none, *(body.nodes for body in bodies)]))
        self._given: set[tuple[LinearFields, str]] = set()

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
        sums, given = self._sums(u, v), self._given
        for body, q, (of_u, of_v) in zip(self._bodies, self._positions(sums), sums, strict=True):
            directors, motions = q[1:], rigid_motions(q)
            misfits = {"displacement": np.abs(directors @ directors.T - np.eye(self.dim)).max()}
            if (body, "displacement") in given:
                bent = self._greatest(body, u, body.fit(of_u)) / body.size
                misfits["displacement"] = max(misfits["displacement"], bent)
            if (body, "velocity") in given:
                amounts = nearest(motions, body.products, of_v)
                rest = self._greatest(body, v, np.einsum("k,kmi->mi", amounts, motions))
                misfits["velocity"] = rest / (self._greatest(body, v, 0 * of_v) or 1.0)
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

    def _sums(self, *vectors: Floats) -> list[Floats]:
        """Total sums of vectors for each body, each ``(f, d + 1, d)``."""
        together = np.array(vectors)
        parts = np.array([body.sums(together) for body in self._bodies])
        return list(reductions.total(self._comm, parts))

    def _positions(self, sums: Sequence[Floats]) -> list[Floats]:
        """Coefficients of the positions by the sums of displacements."""
        return [b.reference + b.fit(s[0]) for b, s in zip(self._bodies, sums, strict=True)]

    def _put(self, fields: Iterable[Floats], values: Floats) -> Floats:
        """Set values to the fields of each body."""
        for body, coefficients in zip(self._bodies, fields, strict=True):
            values[body.nodes] = body.values @ coefficients
        return values
