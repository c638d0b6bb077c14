"""A stepper with its bodies, and its energies and momenta by the equations."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import compat
from dolfinx_nts.fem.jit import assembled, compile_form
from reference.bulk import rotation

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Motion:
    """Rigid motion of a whole scene, x -> Q x + c."""

    Q: Array
    c: Array

    @classmethod
    def random(cls, rng: np.random.Generator) -> "Motion":
        """Draw any rotation, and a shift of about one."""
        return cls(rotation(rng.normal(size=3), rng.uniform(1, 3)), rng.normal(size=3))

    @classmethod
    def none(cls) -> "Motion":
        """Identity."""
        return cls(np.eye(3), np.zeros(3))

    def __call__(self, x: Array) -> Array:
        """Move points, shape (n, 3)."""
        return x @ self.Q.T + self.c


@dataclass(frozen=True)
class Scene:
    """A stepper, its bodies by name, and their material numbers."""

    stepper: Any
    bodies: dict[str, nts.Body]
    numbers: tuple[float, float, float]

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the mesh."""
        return self.stepper.u.function_space.mesh.comm

    def positions(self) -> Array:
        """Positions of all nodes, by number in the input. Collective."""
        return gathered(self.stepper.u.function_space, self.stepper.x)

    def run(self, num_steps: int) -> "History":
        """Advance and keep energies and momenta. Collective."""
        totals = Totals(self)
        history = History([totals.row()], [])
        for _ in range(num_steps):
            history.reports.append(self.stepper.advance())
            history.rows.append(totals.row())
        return history


def gathered(V: fem.FunctionSpace, values: Array) -> Array:
    """Nodal values (l, 3) of V by input number, on all ranks. Collective."""
    ids = input_ids(V)
    owned = V.dofmap.index_map.size_local
    parts = V.mesh.comm.allgather((ids[:owned], values[:owned]))
    result = np.full((V.dofmap.index_map.size_global, 3), np.nan)
    for number, value in parts:
        result[number] = value
    return result


def input_ids(V: fem.FunctionSpace) -> Ints:
    """Return the input number of every local node of V."""
    index_map = V.dofmap.index_map
    ids = np.full(index_map.size_local + index_map.num_ghosts, -1, dtype=np.int64)
    for dofs, nodes in zip(V.dofmap.list, compat.geometry_nodes(V.mesh), strict=True):
        ids[dofs] = V.mesh.geometry.input_global_indices[nodes]
    return ids


class Totals:
    """Mass, energies and momenta of a scene, each over all bodies.

    St. Venant-Kirchhoff: psi = lambda/2 tr(E)^2 + mu E:E, by the rule of
    the bulk, as its sum over the points is conserved.
    """

    def __init__(self, scene: Scene) -> None:
        """Compile the forms."""
        self._scene = scene
        self._v, u = scene.stepper.v, scene.stepper.u
        V = u.function_space
        mesh = V.mesh
        E, nu, rho = (fem.Constant(mesh, number) for number in scene.numbers)
        lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
        F = ufl.Identity(3) + ufl.grad(u)
        strain = (F.T * F - ufl.Identity(3)) / 2
        psi = lmbda / 2 * ufl.tr(strain) ** 2 + mu * ufl.inner(strain, strain)
        x = ufl.SpatialCoordinate(mesh) + u
        p, L = rho * self._v, rho * ufl.cross(x, self._v)
        parts = [rho, ufl.inner(p, self._v) / 2, psi, *(p[i] for i in range(3))]
        parts += [L[i] for i in range(3)]
        twice = 2 * V.ufl_element().degree
        least = 2 if mesh.topology.cell_name() == "tetrahedron" else twice
        # One kernel computes all integrals of a cell.
        eta = ufl.TestFunction(fem.functionspace(mesh, ("DG", 0, (len(parts),))))
        terms = [(part * eta[i], least if part is psi else twice) for i, part in enumerate(parts)]
        self._form = compile_form(
            sum(term * ufl.dx(metadata={"quadrature_degree": degree}) for term, degree in terms)
        )
        self._num = len(parts)

    def row(self) -> Array:
        """Mass, K, V, linear (3) and angular (3) momentum. Collective."""
        values = assembled(self._form).reshape(-1, self._num).sum(axis=0)
        return self._scene.comm.allreduce(values)


@dataclass
class History:
    """Rows of `Totals` at the start and after every step, and reports."""

    rows: list[Array]
    reports: list[nts.StepReport]

    @property
    def kinetic(self) -> Array:
        """Kinetic energy (n,)."""
        return np.array(self.rows)[:, 1]

    @property
    def strain(self) -> Array:
        """Strain energy (n,)."""
        return np.array(self.rows)[:, 2]

    @property
    def energy(self) -> Array:
        """Total energy (n,)."""
        return self.kinetic + self.strain

    @property
    def energy_error(self) -> float:
        """Largest change of the total energy, relative to the start."""
        return float(np.abs(self.energy / self.energy[0] - 1).max())

    @property
    def linear_drift(self) -> float:
        """Largest change of the linear momentum, relative to the start."""
        p = np.array(self.rows)[:, 3:6]
        return float(np.linalg.norm(p - p[0], axis=1).max() / np.linalg.norm(p[0]))

    @property
    def angular_drift(self) -> float:
        """Largest change of the angular momentum, relative to the start."""
        L = np.array(self.rows)[:, 6:]
        return float(np.linalg.norm(L - L[0], axis=1).max() / np.linalg.norm(L[0]))

    @property
    def iterations(self) -> list[int]:
        """Newton iterations of each step."""
        return [report.newton_iterations for report in self.reports]

    @property
    def num_active(self) -> list[int]:
        """Active pairs of each step."""
        return [report.num_active for report in self.reports]


def local_momentum(scene: Scene, name: str) -> Callable[[], tuple[float, Array]]:
    """Return a function that gives mass and linear momentum of one body."""
    mesh, v = scene.stepper.u.function_space.mesh, scene.stepper.v
    rho = fem.Constant(mesh, scene.numbers[2])
    dx = ufl.Measure(
        "dx",
        domain=mesh,
        subdomain_data=[(0, scene.bodies[name].cells)],
        metadata={"quadrature_degree": 2},
    )(0)
    forms = [fem.form(part * dx) for part in (rho, rho * v[0], rho * v[1], rho * v[2])]

    def evaluate() -> tuple[float, Array]:
        values = scene.comm.allreduce(np.array([fem.assemble_scalar(form) for form in forms]))
        return float(values[0]), values[1:]

    return evaluate
