"""One box, hollow or not, loaded and supported; shared by several tests."""

from dataclasses import replace
from itertools import permutations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models import box_meshes
from helpers.scene import gathered

Array = npt.NDArray[np.float64]

SIZE = (1.0, 0.8, 0.6)
VOLUME, RHO = float(np.prod(SIZE)), 10.0
RUBBER = nts.SaintVenantKirchhoff(1.0e3, 0.3, RHO)

# Displacements and energies of order one, after Newton's tolerance.
SOLVED = 1e-9
# Energy without a cause, relative: round-off of sums of some thousand terms.
CLOSED = 1e4 * np.finfo(float).eps


class Box:
    """A box of n x n x n cells with a corner at the origin.

    Its surfaces are ``bottom 0`` and ``top 0``, and ``cavity`` around the
    middle cell, which is left out of 3 x 3 x 3 cells if ``hollow``.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        cell: str = "hexahedron",
        material: nts.Hyperelastic = RUBBER,
        *,
        shape: tuple[int, int, int] = (2, 2, 2),
        size: tuple[float, float, float] = SIZE,
        hollow: bool = False,
    ) -> None:
        """Distribute the mesh. Collective."""
        self.comm, self.cell = comm, cell
        data = box_meshes.boxes([(3, 3, 3) if hollow else shape], [size], cell)
        if hollow:
            grid = np.arange(64).reshape(4, 4, 4)
            self.corners = grid[1:3, 1:3, 1:3].ravel()
            keep = ~np.isin(data.cells, self.corners).all(axis=1)
            surfaces = data.surfaces | {"cavity": self.corners}
            data = replace(data, cells=data.cells[keep], body=data.body[keep], surfaces=surfaces)
        self.mesh, self.cells, self.facets, self.tag = box_meshes.distribute(comm, data)
        self.V = fem.functionspace(self.mesh, ("Lagrange", 1, (3,)))
        self.body = nts.Body(self.V, self.cells, self.tag["body 0"], material)

    def surface(self, name: str) -> nts.Surface:
        """Surface by name. Collective."""
        return nts.Surface(self.V, self.facets, self.tag[name])

    def dofs(self, axis: int) -> npt.NDArray[np.int32]:
        """Nodes of the face through the origin across an axis."""
        found: npt.NDArray[np.int32] = fem.locate_dofs_geometrical(
            self.V, lambda X: np.isclose(X[axis], 0)
        )
        return found

    def positions(self, stepper: nts.EnergyMomentum | nts.Midpoint) -> Array:
        """Positions of all nodes, by number in the input. Collective."""
        return gathered(self.V, stepper.x)

    def cavity_volume(self, stepper: nts.EnergyMomentum | nts.Midpoint) -> float:
        """Volume enclosed by the facets of the cavity. Collective."""
        x = self.positions(stepper)[self.corners]
        if self.cell == "tetrahedron":
            chains = [[0, 1 << a, (1 << a) + (1 << b), 7] for a, b, _ in permutations(range(3))]
            return sum(abs(np.linalg.det(x[chain[1:]] - x[chain[0]])) / 6 for chain in chains)
        points, weights = np.polynomial.legendre.leggauss(3)
        volume = 0.0
        for i, j, k in np.ndindex(3, 3, 3):
            # Trilinear shape functions of [0, 1]^3, first axis fastest.
            s = [(1 + points[m]) / 2 for m in (i, j, k)]
            phi, slope = [np.array([1 - t, t]) for t in s], np.array([-1.0, 1.0])
            factors = [[slope if a == b else phi[b] for b in range(3)] for a in range(3)]
            gradient = [np.einsum("k,j,i->kji", f[2], f[1], f[0]).ravel() @ x for f in factors]
            volume += weights[[i, j, k]].prod() / 8 * np.linalg.det(gradient)
        return float(volume)


def swirl(X: Array) -> Array:
    """Velocity field that deforms and turns the box strongly."""
    x, y, z = X
    return 3 * np.array([np.sin(2 * y) + z, 0.5 * x * z - y, np.cos(x) - 0.3 * z])


class Ledger:
    """Energy of a stepper against the sum of the works of its steps."""

    def __init__(self, stepper: nts.EnergyMomentum | nts.Midpoint) -> None:
        """Start at the present state. Collective."""
        self.stepper, self.diagnostics = stepper, nts.Diagnostics(stepper)
        self.start = self.diagnostics.balance()
        self.reports: list[nts.StepReport] = []
        self.scale = self.start.kinetic_energy + self.start.strain_energy
        self.given = 0.0

    def run(self, num_steps: int) -> None:
        """Advance and add up. Collective."""
        for _ in range(num_steps):
            report = self.stepper.advance()
            self.reports.append(report)
            contact = report.contact_work
            works = [self.diagnostics.bulk_defect(), contact.persistent, contact.activation]
            works += [contact.facet_change, contact.friction, report.load_work]
            works += [report.support_work, report.damping_work, report.solver_work]
            self.given += sum(works)
            self.scale = max(self.scale, *np.abs(works))

    @property
    def gained(self) -> float:
        """Kinetic and strain energy gained since the start [J]. Collective."""
        return self.diagnostics.balance().total_energy - self.start.total_energy

    @property
    def error(self) -> float:
        """Change of energy that the works do not explain, relative. Collective."""
        return abs(self.gained - self.given) / self.scale

    def total(self, name: str) -> float:
        """Sum of a work over the steps [J]."""
        return sum(getattr(report, name) for report in self.reports)


def check_loss(comm, cell, material, scheme):
    """Let a box swirl; its material only dissipates. Return the ledger."""
    box = Box(comm, cell, material)
    stepper = scheme([box.body], dt=0.02)
    stepper.set_velocity(box.body, swirl)
    ledger = Ledger(stepper)
    ledger.run(10)
    works = [report.damping_work for report in ledger.reports]
    assert max(works) < 0
    assert sum(works) < -0.01 * ledger.start.kinetic_energy
    assert ledger.error <= CLOSED
    return ledger


def check_dissipation(comm, cell, material, scheme):
    """Let a box swirl; its material only dissipates, and the ledger is closed."""
    ledger = check_loss(comm, cell, material, scheme)
    if scheme is not nts.EnergyMomentum:
        return
    # Only dissipation reduces the energy.
    assert abs(ledger.gained - ledger.total("damping_work")) <= 1e-10 * ledger.scale
    start, end = ledger.start, ledger.diagnostics.balance()
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(start, name), getattr(end, name)
        np.testing.assert_allclose(after, before, atol=1e-11 * np.linalg.norm(before))
