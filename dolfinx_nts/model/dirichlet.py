"""Supports: Dirichlet conditions of the displacement, which may change in time.

In axisymmetric meshes an additional condition keeps nodes of the axis on the axis.
"""

import logging
from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts import compat
from dolfinx_nts.common.arguments import instances
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.axisymmetry import axis_nodes, is_axisymmetric
from dolfinx_nts.fem.components import dimension, moments, resultants
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.reaction import Reaction, total_reactions
from dolfinx_nts.parallel import reductions

__all__ = ["Supports"]

_logger = logging.getLogger("dolfinx_nts")

# Relative difference of two prescribed displacements of one dof [-] that counts as round-off.
_ROUND_OFF = 1e-12


class Supports:
    """All Dirichlet conditions of the displacement, checked and applied together.

    Collective, as are all its methods.

    Args:
        V: Space of the displacement.
        bcs: The conditions. Their values may be changed between steps.

    Attributes:
        conditions: The conditions in their order, then the condition of the axis if any.
        fixed: Owned scalar dofs with a condition, sorted, shape ``(f,)``.
        of_user: Owned scalar dofs with a condition in ``bcs``, sorted.

    Raises:
        TypeError: Something in the list is not a condition.
        ValueError: A condition belongs to another space.
    """

    def __init__(self, V: fem.FunctionSpace, bcs: Sequence[fem.DirichletBC]) -> None:
        given = instances(fem.DirichletBC, bcs)
        for i, bc in enumerate(given):
            if not V._cpp_object.contains(compat.cpp_object(bc.function_space)):
                raise ValueError(
                    f"expected bcs on the space of the bodies, given bcs[{i}] on another: pass "
                    "the V of the bodies, or V.sub(i) for one direction, to locate_dofs_... and "
                    "to dirichletbc"
                )
        self._names = [f"bcs[{i}]" for i in range(len(given))]
        self.conditions = given
        if is_axisymmetric(V.mesh):
            self.conditions = (*given, fem.dirichletbc(0.0, 2 * axis_nodes(V), V.sub(0)))
            self._names.append("the axis")
        self._V = V
        self._u, self._X = fem.Function(V), reference_positions(V)
        self._comm: MPI.Comm = V.mesh.comm
        self._dim = dimension(V)
        # The number of owned dofs that DOLFINx 0.9 also returns is wrong for blocked spaces.
        size = self._dim * V.dofmap.index_map.size_local
        each = [dofs[dofs < size] for dofs in (bc.dof_indices()[0] for bc in self.conditions)]
        owned = np.concatenate([np.empty(0, dtype=np.int32), *each])
        self.fixed, first, count = np.unique(owned, return_index=True, return_counts=True)
        self._shared = reductions.anywhere(self._comm, bool((count > 1).any()))
        ends = np.cumsum([len(dofs) for dofs in each])
        # Number of the first condition of each fixed dof.
        number = np.searchsorted(ends, first, side="right")
        self._number: Ints = np.asarray(number, dtype=np.int32)
        self.of_user: Ints = self.fixed[self._number < len(self)]

    def warn_of_empty(self) -> None:
        """Warn of conditions without dofs, such as from a predicate that is false everywhere."""
        given = self.conditions[: len(self)]
        flags = np.array([len(bc.dof_indices()[0]) > 0 for bc in given], dtype=bool)
        for i, holds in enumerate(reductions.anywhere(self._comm, flags)):
            if not holds and self._comm.rank == 0:
                _logger.warning(
                    "bcs[%d] has no dof: harmless if that is intended; otherwise correct the "
                    "function or the tag by which its dofs were located",
                    i,
                )

    def __len__(self) -> int:
        """Number of conditions in ``bcs``. Local."""
        return len(self.conditions) - is_axisymmetric(self._V.mesh)

    @property
    def exist(self) -> bool:
        """Whether there are conditions on any rank. Local."""
        return bool(self.conditions)

    def dofs_of(self, number: int) -> Ints:
        """Owned scalar dofs of a condition, without those of conditions before it. Local."""
        dofs: Ints = self.fixed[self._number == number]
        return dofs

    def constants(self) -> list[tuple[str, Floats]]:
        """Names and current values [m] of conditions that are constant in space. Local."""
        values = (getattr(bc.g, "value", None) for bc in self.conditions)
        both = zip(self._names, values, strict=True)
        return [(name, np.asarray(value)) for name, value in both if value is not None]

    def check(self) -> None:
        """Check that the current values are finite and do not conflict.

        Raises:
            ValueError: A value is not finite, or two conditions prescribe different values for
                a dof.
        """
        if not self.conditions:
            return
        self._u.x.array[:] = np.nan
        values = [self._u.x.array.copy() for _ in self.conditions] if self._shared else []
        for bc, value in zip(self.conditions, values, strict=False):
            bc.set(value)
        text = ""
        for i, value in enumerate(values):
            for j, other in enumerate(values[:i]):
                a, b = other[self.fixed], value[self.fixed]
                wrong = np.abs(a - b) > _ROUND_OFF * np.maximum(np.abs(a), np.abs(b))
                if wrong.any() and not text:
                    k = int(np.argmax(wrong))
                    dof = self.fixed[k]
                    text = (
                        f"expected one displacement per dof, given {a[k]:g} m by {self._names[j]} "
                        f"and {b[k]:g} m by {self._names[i]} in direction "
                        f"{'xyz'[dof % self._dim]} near "
                        f"{np.round(self._X[dof // self._dim], 6)}"
                    )
        given = self.applied(self._u.x.array)[self.fixed]
        if len(bad := given[~np.isfinite(given)]):
            text = f"expected finite displacements in bcs, given {bad[0]}"
        if reductions.anywhere(self._comm, bool(text)):
            raise ValueError(max(self._comm.allgather(text)))

    def reactions(
        self, force: Floats, x: Floats, du: Floats, mean: Floats | None = None
    ) -> tuple[Reaction, ...]:
        """Sum the forces of a step for each condition.

        A dof with several conditions counts for the first of them.

        Args:
            force: Forces of the supports on the fixed dofs, shape ``(f,)`` [N].
            x: Positions of the local nodes at which they act, shape ``(l, 3)`` [m].
            du: Displacements of the fixed dofs in the step, shape ``(f,)`` [m].
            mean: Forces that do the work, shape ``(f,)`` [N]; None for ``force``.

        Returns:
            The reactions of the conditions in ``bcs``, in their order.
        """
        d, V = self._dim, self._V
        vectors = np.zeros((len(force), 3))
        vectors[np.arange(len(force)), self.fixed % d] = force
        turning = moments(np.cross(x[self.fixed // d], vectors), V)
        resultant = resultants(vectors, V)
        work = (force if mean is None else mean) * du
        parts = np.column_stack([resultant, turning, work])
        sums = np.zeros((len(self.conditions), parts.shape[1]))
        np.add.at(sums, self._number, parts)
        return total_reactions(self._comm, sums[: len(self)], resultant.shape[1])

    def applied(self, values: Floats) -> Floats:
        """Apply the current values of the conditions to displacements.

        Args:
            values: Displacements of the local scalar dofs, owned then ghost, shape ``(d l,)``
                [m].

        Returns:
            A copy with the values of the conditions.
        """
        applied = values.copy()
        if self.conditions:
            for bc in self.conditions:
                bc.set(applied)
            # Ghosts are updated, as the user may have located owned dofs only.
            self._u.x.array[:] = applied
            self._u.x.scatter_forward()
            applied[:] = self._u.x.array
        return applied
