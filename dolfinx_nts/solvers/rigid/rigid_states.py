"""Displacements and velocities of the rigid bodies of a stepper, and their checks."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.rigid.guides import Guides
from dolfinx_nts.solvers.rigid.linear_fields import LinearFields, combined, rigid_motions
from dolfinx_nts.solvers.rigid.rigid_fields import RigidFields

__all__ = ["RigidStates"]

# Largest deformation of a rigid body in a given state, relative to its size or speed [-].
_NOT_RIGID = 1e-8


class RigidStates:
    """States of all rigid bodies. Collective, as are all methods.

    Vectors are nodal, over the owned nodes of the space, shape ``(n, d)``.

    Args:
        V: Space of the displacement.
        bodies: Linear fields over each rigid body.

    Attributes:
        dim: Dimension of the space, d.
        guides: Guides of the bodies.
        exists: Whether there are rigid bodies, on any rank.
        nodes: Owned nodes of rigid bodies, sorted.
    """

    def __init__(self, V: fem.FunctionSpace, bodies: Sequence[LinearFields]) -> None:
        self._comm: MPI.Comm = V.mesh.comm
        self._bodies, self.guides = tuple(bodies), Guides(self._comm, bodies)
        self.dim, self.exists = dimension(V), bool(bodies)
        self._is_axisymmetric = is_axisymmetric(V.mesh)
        self._were_set: set[tuple[LinearFields, str]] = set()
        none = np.empty(0, dtype=np.int32)
        self.nodes: Ints = np.unique(np.concatenate([none, *(body.nodes for body in bodies)]))
        if self.exists:
            self._fields = RigidFields(self._comm, bodies)

    def mark_set(self, body: Body, name: str) -> None:
        """Mark a body whose state the user has set, so that `check` includes all its nodes. Local.

        ``name`` is ``"displacement"`` or ``"velocity"``.
        """
        self._were_set |= {(each, name) for each in self._bodies if each.body is body}

    def restored(self) -> None:
        """Treat the state of all bodies as the result of a step, not as set by the user. Local."""
        self._were_set = set()

    def check(self, u: Floats, v: Floats) -> None:
        """Raise unless displacements u [m], and velocities v [m/s] that have been set, are rigid.

        Raises:
            ValueError: A body is deformed, or its velocity would deform it.
        """
        if not self.exists:
            return
        # After a step, velocities are rigid only with respect to the midpoint of the step.
        of_u, of_v = self._fields.sums(u, v)
        q, fields = self._fields.positions(of_u), self._fields.fit(of_u)
        directors, motions, how = q[:, 1:], rigid_motions(q), "moves and rotates it as a whole"
        if self._is_axisymmetric:  # rotations of the section would deform the body
            fields = combined(self._fields.nearest(motions, of_u), motions)
            how = "moves it along the axis y as a whole"
        gram = directors @ directors.transpose(0, 2, 1)
        strains = np.abs(gram - np.eye(self.dim)).max(axis=(1, 2))
        velocities = combined(self._fields.nearest(motions, of_v), motions)
        for i, body in enumerate(self._bodies):
            misfits = {"displacement": strains[i]}
            if (body, "displacement") in self._were_set:
                bent = self._greatest(body, u, fields[i]) / body.size
                misfits["displacement"] = max(misfits["displacement"], bent)
            if (body, "velocity") in self._were_set:
                rest = self._greatest(body, v, velocities[i])
                misfits["velocity"] = rest / (self._greatest(body, v, 0 * velocities[i]) or 1.0)
            for name, misfit in misfits.items():
                if misfit > _NOT_RIGID:
                    raise ValueError(
                        f"expected a {name} of the rigid {body.body.name} that {how} from its "
                        f"current position, given one that deforms it by {misfit:.2g}"
                    )
        self.restored()

    def _greatest(self, body: LinearFields, values: Floats, field: Floats) -> float:
        """Largest component of the difference of nodal values of a body and a linear field."""
        rest = values[body.nodes] - body.values @ field
        return reductions.largest(self._comm, _kernels.largest_size(rest))
