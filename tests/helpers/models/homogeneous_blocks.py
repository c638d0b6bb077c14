"""Patch test: two stacked blocks that deform as one homogeneous body."""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models import box_meshes

Array = npt.NDArray[np.float64]
SIDES = {"x0": (0, 0), "x1": (0, 1), "y0": (1, 0), "y1": (1, 1)}


def deform(
    cells: tuple[int, int],
    F: Array,
    *,
    cell: str = "hexahedron",
    friction: nts.Coulomb | None = None,
    slope: float = 0.0,
    Q: Array | None = None,
    degree: int = 1,
) -> tuple[nts.QuasiStatic, float, Array]:
    """Deform a cube of two blocks by surface-to-surface contact. Collective.

    Top and bottom have the displacement of the deformation, the other sides its tractions.

    Args:
        cells: Cells along an edge of the lower block and of the upper one.
        F: Deformation gradient.
        cell: Kind of the cells.
        friction: Law of friction.
        slope: Of the surface between the blocks, along the first axis.
        Q: Turns everything before the start.
        degree: Of the displacement.

    Returns:
        The stepper after its step, largest error of the displacement [m], and the first
        Piola-Kirchhoff stress [Pa].
    """
    Q = np.eye(3) if Q is None else Q
    data = box_meshes.boxes([(n, n, 2) for n in cells], [(1, 1, 0.5)] * 2, cell)
    X = data.X
    X[np.unique(data.cells[data.body == 1]), 2] += 0.5
    for side, (axis, place) in SIDES.items():
        data.surfaces[side] = np.flatnonzero(X[:, axis] == place)
    X[:, 2] += slope * (X[:, 0] - 0.5) * (1 - np.abs(2 * X[:, 2] - 1))
    X[:] = X @ Q.T
    mesh, tags, facets, tag = box_meshes.distribute(MPI.COMM_WORLD, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    material = nts.SaintVenantKirchhoff(1.0, 0.3, 1.0)
    bodies = [nts.Body(V, tags, tag[f"body {number}"], material) for number in (0, 1)]
    surfaces = {name: nts.Surface(V, facets, tag[name]) for name in data.surfaces}
    pair = nts.ContactPair(
        surfaces["bottom 1"],
        surfaces["top 0"],
        friction=friction,
        method="mortar",
        enforcement=nts.LagrangeMultiplier(),
    )
    strain = (F.T @ F - np.eye(3)) / 2
    lmbda, mu = 0.3 / (1.3 * 0.4), 1 / 2.6
    stress = F @ (lmbda * np.trace(strain) * np.eye(3) + 2 * mu * strain)
    F, stress = Q @ F @ Q.T, Q @ stress @ Q.T
    loads = [
        nts.Traction(surfaces[side], stress @ Q[:, axis] * (2 * place - 1))
        for side, (axis, place) in SIDES.items()
    ]
    whole = fem.Function(V)
    whole.interpolate(lambda x: (F - np.eye(3)) @ x)
    ends = [fem.locate_dofs_topological(V, 2, facets.find(tag[s])) for s in ("bottom 0", "top 1")]
    bcs = [fem.dirichletbc(whole, np.concatenate(ends))]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, loads=loads)
    stepper.advance()
    return stepper, float(np.abs(stepper.u.x.array - whole.x.array).max()), stress
