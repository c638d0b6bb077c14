r"""Mass matrix with massless surface nodes, and residual and tangent with it.

With the matrix P that extrapolates values from the nodes below the surface, see `extrapolation`,
and the consistent mass M, the mass matrix is

.. math:: M_r = P^T M P .

Rows and columns of massless nodes are zero. The matrix is positive definite on all others, and all
affine motions have the same momentum and energy as with M. Loads act as :math:`P^T f`, so that a
body in free fall has no strain.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem, la

from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.jit import compile_bilinear_form
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.extrapolation import Extrapolation
from dolfinx_nts.parallel.communication import exchanged, joined, rows_by_rank
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.linear.block_csr import BlockCSR, entries_of_rows, starts
from dolfinx_nts.solvers.nodal_sum import NodalSum
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["MassForce", "RedistributedBulk", "RedistributedMass", "RedistributedTangent"]


class RedistributedMass:
    """Products with the redistributed mass, and transfer of forces to nodes with mass. Collective.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        below: The massless nodes, and the nodes that carry their mass.
        factor: Returns a factor on the density of a material; None: 1.

    Attributes:
        dim: Components of nodal values.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        below: Extrapolation,
        factor: Callable[[Hyperelastic], float] | None = None,
    ) -> None:
        V = bodies[0].V
        trial, test = ufl.TrialFunction(V), ufl.TestFunction(V)

        def integrand(material: Hyperelastic, _: Any, rho: Any) -> Any:
            # A constant, so that zero entries stay in the sparsity pattern.
            part = 1.0 if factor is None else fem.Constant(V.mesh, float(factor(material)))
            return part * rho * ufl.inner(trial, test)

        form = bulk_form(bodies, integrand)
        matrix = fem.assemble_matrix(compile_bilinear_form(form))
        matrix.scatter_reverse()
        index_map = V.dofmap.index_map
        self._mass = _assembled(index_map, _triple(matrix, below))
        self.dim = dim = dimension(V)
        self._times_mass = _Product(self._mass, dim)
        P = _extrapolating(index_map, below)
        self._restrict = _Product(_assembled(index_map, _Entries(P.column, P.row, P.value)), dim)

    def times(self, values: Floats) -> Floats:
        """Multiply values at the owned nodes by the mass, both ``(n, d)``."""
        return self._times_mass.of(values)

    def carried(self, forces: Floats) -> Floats:
        """Transfer forces at the owned nodes to nodes with mass, both ``(n, d)`` [N]."""
        return self._restrict.of(forces)

    def entries(self, index_map: Any) -> tuple[Ints, Ints, Floats]:
        """Rows, columns and values of the owned rows, all of shape ``(b,)`` [kg]. Local.

        Columns are local nodes of the map, or -1 for nodes that are not on this rank.
        """
        start, column, value = self._mass.getValuesCSR()
        row = np.repeat(np.arange(len(start) - 1, dtype=np.int32), np.diff(start))
        local = np.asarray(index_map.global_to_local(column.astype(np.int64)))
        return row, local, value


class MassForce(NamedTuple):
    """Mass times a rate that depends on the displacement, such as the inertia force.

    Attributes:
        mass: The mass; all masses of one stepper have the same sparsity.
        rate: Returns the rate at the local dofs, shape ``(d l,)``.
        factor: Returns the derivative of the rate with respect to u.
    """

    mass: RedistributedMass
    rate: Callable[[], Floats]
    factor: Callable[[], float]


class _Product:
    """Product of a scalar matrix with a few vectors.

    Args:
        matrix: The matrix.
        width: Number of columns.
    """

    def __init__(self, matrix: Any, width: int) -> None:
        self._matrix = matrix
        size = (matrix.getSizes()[1], (None, width))
        self._columns = PETSc.Mat().createDense(size, comm=matrix.comm)
        self._columns.setUp()
        self._columns.assemble()
        # PETSc stores the symbolic product in the result matrix.
        self._result = matrix.matMult(self._columns)
        self._given, self._product = (
            dense.getDenseArray() for dense in (self._columns, self._result)
        )

    def of(self, values: Floats) -> Floats:
        """Multiply values at the owned nodes, both ``(n, width)``. Collective."""
        self._given[:] = values
        self._matrix.matMult(self._columns, result=self._result)
        return np.ascontiguousarray(self._product)


class _Entries(NamedTuple):
    """Entries of a matrix with global row and column numbers, shape ``(b,)`` each."""

    row: GlobalInts
    column: GlobalInts
    value: Floats


def _extrapolating(index_map: Any, below: Extrapolation) -> _Entries:
    """Entries of the extrapolation P in the owned rows. Local."""
    first, n = index_map.local_range[0], index_map.size_local
    others = first + np.setdiff1d(np.arange(n), below.node)
    rows = first + np.repeat(below.node.astype(np.int64), np.diff(below.start))
    return _Entries(
        np.concatenate([others, rows]),
        np.concatenate([others, below.column]),
        np.concatenate([np.ones(len(others)), below.weight]),
    )


def _triple(matrix: la.MatrixCSR, below: Extrapolation) -> _Entries:
    """Entries of P^T M P, in any rows. Collective.

    PETSc's matrix products add in an order that varies from run to run.
    """
    M = BlockCSR(matrix)
    index_map = M.index_map
    first = index_map.local_range[0]
    rows = [first + below.node.astype(np.int64), np.diff(below.start), below.column, below.weight]
    node, length, column, weight = (joined(index_map.comm, part) for part in rows)
    order = np.argsort(node)
    start, places = entries_of_rows(starts(length), order)
    node, column, weight = node[order], column[places], weight[places]

    def expanded(keys: GlobalInts, *others: Any) -> tuple[Any, ...]:
        """Replace massless nodes in a list by the nodes that carry their mass, with weights."""
        place = np.minimum(np.searchsorted(node, keys), len(node) - 1)
        follows = node[place] == keys
        _, these = entries_of_rows(start, place[follows])
        counts = np.diff(start)[place[follows]]
        return (
            np.concatenate([keys[~follows], column[these]]),
            np.concatenate([np.ones(np.count_nonzero(~follows)), weight[these]]),
            *(np.concatenate([o[~follows], np.repeat(o[follows], counts)]) for o in others),
        )

    row = first + np.repeat(np.arange(len(M.start) - 1, dtype=np.int64), np.diff(M.start))
    columns, factor, row, value = expanded(M.global_columns, row, M.value[:: M.dim**2])
    row, second, columns, value = expanded(row, columns, factor * value)
    return _Entries(row, columns, second * value)


def _assembled(index_map: Any, entries: _Entries) -> Any:
    """PETSc matrix of the sums of entries, sent to the owners of their rows. Collective."""
    comm, n = index_map.comm, index_map.size_local
    first = index_map.local_range[0]
    row, column, value = entries
    ends = np.array(comm.allgather(first + n))
    owner = np.searchsorted(ends, row, side="right")
    parts = {rank: (row[k], column[k], value[k]) for rank, k in rows_by_rank(comm, owner).items()}
    received = exchanged(comm, parts).values()
    row, column, value = (np.concatenate(arrays) for arrays in zip(*received, strict=True))
    order = np.lexsort((column, row))
    row, column, value = row[order], column[order], value[order]
    begins = np.ones(len(row), dtype=bool)
    begins[1:] = (np.diff(row) != 0) | (np.diff(column) != 0)
    begin = np.flatnonzero(begins)
    sums: Floats = np.add.reduceat(value, begin) if len(begin) else value
    start = starts(np.bincount(row[begin] - first, minlength=n))
    csr = start.astype(PETSc.IntType), column[begin].astype(PETSc.IntType), sums
    return PETSc.Mat().createAIJ(((n, None), (n, None)), csr=csr, comm=comm)


class RedistributedBulk(Bulk):
    """Residual of bodies whose forms have no inertia, with the inertia of a redistributed mass.

    Args:
        residual, u, bcs, loads: Arguments of `Bulk`.
        inertia: Inertia, and other forces of masses.
        jumps: Argument of `Bulk`.
    """

    def __init__(
        self,
        residual: ufl.Form,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form],
        inertia: Sequence[MassForce],
        *,
        jumps: bool = False,
    ) -> None:
        super().__init__(residual, u, bcs, loads, jumps=jumps)
        self._inertia, self._mass = inertia, inertia[0].mass
        self._has_loads = bool(loads)

    def forces(self) -> Floats:
        R = self._residual.assembled_bodies()
        for mass, rate, _ in self._inertia:
            R += mass.times(self._by_node(rate()[: self.num_owned])).ravel()
        for load in self.loads():
            R -= load
        return R

    def loads(self) -> list[Floats]:
        """Forces of each load at u, transferred to owned nodes with mass [N]. Collective."""
        return [self._mass.carried(self._by_node(f)).ravel() for f in super().loads()]

    def _forces_by(self, action: NodalSum, direction: Floats) -> Floats:
        y = action.assembled_bodies()
        for mass, _, factor in self._inertia:
            y += factor() * mass.times(self._by_node(direction)).ravel()
        if self._has_loads:
            y += self._mass.carried(self._by_node(action.assembled_loads())).ravel()
        return y

    def _by_node(self, values: Floats) -> Floats:
        """View of dof values by nodes, shape ``(n, d)``. Local."""
        return values.reshape(-1, dimension(self.u.function_space))


class RedistributedTangent(Tangent):
    """Matrix of the bodies with a redistributed mass, for preconditioners.

    Args:
        residual, u, bcs, loads, nearby, bodies: Arguments of `Tangent`.
        inertia: Argument of `RedistributedBulk`.
        dt: Length of a step, on which the factors of the masses depend [s].
    """

    def __init__(
        self,
        residual: ufl.Form,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form],
        nearby: ufl.Form,
        bodies: Sequence[Ints],
        inertia: Sequence[MassForce],
        dt: fem.Constant,
    ) -> None:
        super().__init__(residual, u, bcs, loads, nearby, bodies)
        self._inputs.append(dt.value)
        self._inertia = inertia
        V = u.function_space
        index_map = V.dofmap.index_map
        parts = [mass.entries(index_map) for mass, *_ in inertia]
        row, column, _ = parts[0]
        value: Floats = np.array([values for *_, values in parts])
        # Entries with columns on other ranks are added to the diagonal, which keeps the matrix
        # definite.
        unknown = column < 0
        column, value = np.where(unknown, row, column), np.where(unknown, np.abs(value), value)
        self._entries = row, column, value
        self._diagonal: Any = [
            np.bincount(row, values * (row == column), index_map.size_local) for values in value
        ]
        dim = dimension(V)
        free = la.vector(index_map, dim)
        free.array[:] = 1
        for bc in self._supports.conditions:
            free.array[bc.dof_indices()[0]] = 0
        self._free: Floats = free.array.reshape(-1, dim)
        self._place: Ints | None = None

    def _created(self, form: fem.Form) -> la.MatrixCSR:
        row, column, _ = self._entries
        pattern = fem.create_sparsity_pattern(form)
        rows, begin = np.unique(row, return_index=True)
        for number, some in zip(rows, np.split(column, begin)[1:], strict=True):
            pattern.insert(np.array([number]), some)
        pattern.finalize()
        return la.matrix_csr(pattern)

    def _add_to(self, rows: BlockCSR) -> Floats:
        row, column, value = self._entries
        if self._place is None:
            columns = rows.matrix.index_map(1)
            width = columns.size_local + columns.num_ghosts
            known = np.repeat(np.arange(len(rows.start) - 1), np.diff(rows.start)) * width
            known += rows.column
            order = np.argsort(known)
            self._place = order[
                np.searchsorted(known[order], row.astype(np.int64) * width + column)
            ]
        d = self._free.shape[1]
        blocks = rows.value.reshape(-1, d * d)[:, :: d + 1]
        factors = [factor() for *_, factor in self._inertia]
        added = (factors @ value)[:, None] * self._free[row] * self._free[column]
        np.add.at(blocks, self._place, added)
        stiffness: Floats = factors @ np.array(self._diagonal)
        return stiffness
