"""Effect of facets of a round surface on forces: a point that is dragged over a cylinder.

Facets of the length l are up to l^2/8R below an arc of radius R, which is compared with how deep
the point is pressed in; on curved cells of second order they are half as long. Smooth segments
follow the arc.
"""

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.box_meshes import boxes, distribute
from reference.bulk import rotation

pytest.importorskip("gmsh")
pytestmark = pytest.mark.serial

DEPTH, SIDE = 0.0071, 0.1  # over the radius 1
FACET = np.pi / 32


def scene(model: Any, order: int) -> None:
    """Add a disc of 16 cells a quarter, and a triangle that stands on it."""
    occ = model.occ
    disc = occ.addDisk(0, 0, 0, 1, 1)
    corners = [(0, 1 + 1e-6), (-SIDE, 1 + SIDE), (SIDE, 1 + SIDE)]
    points = [occ.addPoint(*corner, 0) for corner in corners]
    lines = [occ.addLine(points[i], points[i - 2]) for i in range(3)]
    tip = occ.addPlaneSurface([occ.addCurveLoop(lines)])
    occ.synchronize()
    (_, rim), *_ = model.getBoundary([(2, disc)], oriented=False)
    for surface, name in ((disc, "disc"), (tip, "tip")):
        model.addPhysicalGroup(2, [surface], name=name)
    model.addPhysicalGroup(1, [rim], name="rim")
    model.addPhysicalGroup(1, [lines[0], lines[2]], name="sides")
    model.mesh.setTransfiniteCurve(rim, 65)
    for line in lines:
        model.mesh.setTransfiniteCurve(line, 2)
    model.mesh.generate(2)
    model.mesh.setOrder(order)


def dragged(order: int, smooth: bool = False) -> np.ndarray:
    """Forces while the point goes over two facets, with displacements of the order of cells."""
    mesh, cells, facets, tag = nts.read_mesh(lambda model: scene(model, order), MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", order, (2,)))
    disc = nts.Body(V, cells, tag["disc"], nts.NeoHookean(1e9, 0.3, 1e3))
    tip = nts.Body(V, cells, tag["tip"], nts.NeoHookean(1e5, 0.3, 1e3))
    X = V.tabulate_dof_coordinates()[:, :2]
    core = np.flatnonzero(np.linalg.norm(X, axis=1) < 0.5).astype(np.int32)
    top = np.flatnonzero(np.abs(X[:, 1] - 1 - SIDE) < 1e-9).astype(np.int32)
    held, moved = fem.Function(V), fem.Function(V)

    def move(t: float) -> None:
        """Press the tip in until t = 1, and turn it about the axis until t = 11."""
        angle = 2 * FACET * max(t - 1, 0) / 10
        Q = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        travel = (X[top] - (0, DEPTH * min(t, 1))) @ Q.T - X[top]
        moved.x.array.reshape(-1, 2)[top] = travel

    move(0.0)
    bcs = [fem.dirichletbc(held, core), fem.dirichletbc(moved, top)]
    rim = nts.Surface(V, facets, tag["rim"], smooth=smooth)
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["sides"]),
        rim,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.QuasiStatic([disc, tip], [pair], dt=0.5, bcs=bcs, update=move)
    diagnostics, forces = nts.Diagnostics(stepper), []
    for step in stepper.run(11):
        assert step.num_active == 1
        if step.t >= 1:
            forces.append(np.linalg.norm(diagnostics.contact_force()))
    return np.array(forces)


def dragged_in_space(cell: str, smooth: bool) -> np.ndarray:
    """Forces while the corner of a cube goes over two facets around a cylinder in space."""
    data = boxes([(10, 3, 1), (1, 1, 1)], [(10.0, 0.3, 0.5), (1.0, 1.0, 1.0)], cell)
    arc, cube = (np.unique(data.cells[data.body == body]) for body in (0, 1))
    x, y, z = data.X[arc].T
    angle = FACET * (x - 4.0)
    data.X[arc] = np.column_stack([(0.5 + z) * np.sin(angle), y - 0.13, (0.5 + z) * np.cos(angle)])
    # The corner at the origin points down.
    on_corner = rotation([1.0, -1.0, 0.0], np.arccos(1 / np.sqrt(3)))
    data.X[cube] = SIDE * data.X[cube] @ on_corner.T + [0.0, 0.0, 1 + 1e-6]
    mesh, cells, _, tag = distribute(MPI.COMM_WORLD, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    cylinder = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e9, 0.3, 1e3))
    tip = nts.Body(V, cells, tag["body 1"], nts.NeoHookean(1e5, 0.3, 1e3))
    X = V.tabulate_dof_coordinates()
    radius = np.hypot(X[:, 0], X[:, 2])
    core = np.flatnonzero(radius < 0.5 + 1e-9).astype(np.int32)
    above = np.flatnonzero(radius > 1 + 2e-6).astype(np.int32)
    held, moved = fem.Function(V), fem.Function(V)

    def move(t: float) -> None:
        """Press the cube in until t = 1, and turn it about the axis until t = 11."""
        turn = rotation([0.0, 1.0, 0.0], 2 * FACET * max(t - 1, 0) / 10)
        travel = (X[above] - (0, 0, DEPTH * min(t, 1))) @ turn.T - X[above]
        moved.x.array.reshape(-1, 3)[above] = travel

    move(0.0)
    bcs = [fem.dirichletbc(held, core), fem.dirichletbc(moved, above)]
    outer = nts.boundary_of(cylinder, where=lambda x: np.hypot(x[0], x[2]) > 0.999, smooth=smooth)
    pair = nts.ContactPair(
        nts.boundary_of(tip), outer, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = nts.QuasiStatic([cylinder, tip], [pair], dt=0.5, bcs=bcs, update=move)
    diagnostics, forces = nts.Diagnostics(stepper), []
    for step in stepper.run(11):
        assert step.num_active == 1
        if step.t >= 1:
            forces.append(np.linalg.norm(diagnostics.contact_force()))
    return np.array(forces)


def ripple(forces: np.ndarray) -> float:
    """Variation of a force relative to its mean [%]."""
    return float(100 * np.ptp(forces) / forces.mean())


def test_curved_cells_and_smooth_segments_smooth_the_force_of_sliding(
    table_row,
):
    straight, curved, smooth = ripple(dragged(1)), ripple(dragged(2)), ripple(dragged(1, True))
    table_row(
        "drag over a cylinder, 16 cells a quarter, 0.7 % of the radius deep",
        "the same force everywhere",
        f"ripple of {straight:.0f} % on straight cells, {curved:.1f} % on curved ones",
    )
    table_row(
        "the same on straight cells with `smooth=True`",
        "the same force everywhere",
        f"ripple of {smooth:.1g} %",
    )
    sag = 100 * FACET**2 / 8 / DEPTH
    assert smooth < 0.1
    assert straight == pytest.approx(sag, rel=0.2)
    assert curved == pytest.approx(sag / 4, rel=0.2)


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_smooth_segments_in_space_see_a_cylinder(cell, table_row):
    flat, smooth = (ripple(dragged_in_space(cell, smooth)) for smooth in (False, True))
    kind = {"hexahedron": "quadrilaterals", "tetrahedron": "triangles"}[cell]
    table_row(
        f"the same in space, facets of {kind}",
        "the same force everywhere",
        f"ripple of {flat:.0f} %, with `smooth=True` {smooth:.1g} %",
    )
    assert smooth < 0.1 < 10 < flat
