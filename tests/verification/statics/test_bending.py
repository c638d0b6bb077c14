"""Walls that bend: stiffness by the length of the cells along the wall.

The ends of a bar turn towards each other and are free to slide and to contract. Pure bending is the
exact solution, and the moment is E I times the curvature.
"""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.at_most_two_ranks

E, WALL, LENGTH, CURVATURE = 1e6, 1.0, 6.0, 1e-4


def excess(comm, along, through, degree=1):
    """Relative error of the moment of a bar with ``along`` cells for each thickness of the wall."""

    def build(model):
        size, corner = (LENGTH, WALL, WALL), (0, -WALL / 2, -WALL / 2)
        cells = round(LENGTH / WALL * along), 2, through
        parts.add_box(model, "wall", corner=corner, size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    wall = nts.Body(V, cells, tag["wall"], nts.NeoHookean(E, 0.3, 1e3))
    bcs = []
    for axis, place in (
        *((0, lambda x, end=end: np.isclose(x[0], end)) for end in (0.0, LENGTH)),
        # The rigid motions that the ends do not hold.
        (1, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0)),
        (2, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0) & np.isclose(x[2], 0)),
    ):
        Q, _ = V.sub(axis).collapse()
        value = fem.Function(Q)
        if axis == 0:
            value.interpolate(lambda x: CURVATURE * x[0] * x[2])
        dofs = fem.locate_dofs_geometrical((V.sub(axis), Q), place)
        bcs.append(fem.dirichletbc(value, dofs, V.sub(axis)))
    (step,) = nts.QuasiStatic([wall], [], dt=1.0, bcs=bcs).run(until=1.0)
    moment = abs(step.reactions[1].moment[1])
    return moment / (E * WALL**4 / 12 * CURVATURE) - 1


def test_stiffness_depends_on_cells_along_the_wall_and_not_through_it(comm, table_row):
    half, finer, quarter = (excess(comm, *cells) for cells in ((2, 4), (2, 8), (4, 4)))
    quadratic = excess(comm, 2, 2, degree=2)
    assert 0.95 * half < finer < 1.2 * half  # more cells through the wall do not help
    assert quarter < 0.3 * half
    assert abs(quadratic) < 1e-3
    table_row(
        "bending of a wall, hexahedra of degree 1 as long as half of it and a quarter of it",
        "beam theory: moment; four and eight cells through the wall, then four",
        f"{100 * half:+.1f} %, {100 * finer:+.1f} %, {100 * quarter:+.1f} %",
    )
