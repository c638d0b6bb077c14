"""A shrink fit of round parts: interference far smaller than the sagitta of the facets.

Lame's closed form, any textbook on machine elements. Cells are of second order, or surfaces are
smooth, so that both are round to a part of the interference, while chords of nodes are not.
"""

from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts

pytest.importorskip("gmsh")
pytestmark = pytest.mark.serial

E, NU = 200e9, 0.3  # Pa, -
INNER, JOINT, OUTER, OVER, THICKNESS = 0.025, 0.05, 0.10, 5e-6, 0.005  # m
# Of each nodal pressure, on curved cells and on straight ones with smooth surfaces.
TOLERANCE, SMOOTH_TOLERANCE = 0.03, 0.005


def rings(model: Any, cell: str, edges: dict[str, int], order: int) -> None:
    """Add quarters of shaft and hub about the axis z, with facets along the quarter of each."""
    dim = 3 if cell in ("tetrahedron", "hexahedron") else 2
    for name, (a, b) in {"shaft": (INNER, JOINT + OVER), "hub": (JOINT, OUTER)}.items():
        n, corners = edges[name], [(a, 0), (b, 0), (0, b), (0, a)]
        points = [model.occ.addPoint(*corner, 0) for corner in corners]
        centre = model.occ.addPoint(0, 0, 0)
        sides = [
            model.occ.addLine(*points[:2]),
            model.occ.addCircleArc(points[1], centre, points[2]),
            model.occ.addLine(*points[2:]),
            model.occ.addCircleArc(points[3], centre, points[0]),
        ]
        face = model.occ.addPlaneSurface([model.occ.addCurveLoop(sides)])
        model.occ.remove([(0, centre)])
        model.occ.synchronize()
        for number, side in enumerate(sides):
            model.mesh.setTransfiniteCurve(side, 1 + (n if number % 2 else n // 2))
        model.mesh.setTransfiniteSurface(face, "Left" if name == "hub" else "Right")
        recombine = cell in ("quadrilateral", "hexahedron")
        if recombine:
            model.mesh.setRecombine(2, face)
        joint = sides[1] if name == "shaft" else sides[3]
        whole = face
        if dim == 3:
            above = model.occ.extrude(
                [(2, face)], 0, 0, THICKNESS, numElements=[1], recombine=recombine
            )
            model.occ.synchronize()
            whole, joint = above[1][1], above[2 + sides.index(joint)][1]
        model.addPhysicalGroup(dim, [whole], name=name)
        model.addPhysicalGroup(dim - 1, [joint], name=f"{name}_joint")
    model.mesh.generate(dim)
    model.mesh.setOrder(order)


def pressed(cell: str, by: str, order: int = 2, smooth: tuple[str, ...] = ()) -> np.ndarray:
    """Fit both, with the nodes of one; pressure at its nodes, relative to Lame's."""
    other = "hub" if by == "shaft" else "shaft"
    data = nts.read_mesh(
        partial(rings, cell=cell, edges={"shaft": 12, "hub": 16}, order=order), MPI.COMM_WORLD
    )
    dim = data.mesh.topology.dim
    V = fem.functionspace(data.mesh, ("Lagrange", order, (dim,)))
    steel = nts.NeoHookean(E=E, nu=NU, rho=7800)
    bodies = [nts.Body(V, data.cells, data.tag[name], steel) for name in ("shaft", "hub")]
    nodes, segments = (
        nts.Surface(V, data.facets, data.tag[f"{name}_joint"], smooth=name in smooth)
        for name in (by, other)
    )
    pair = nts.ContactPair(nodes, segments, method="mortar")
    planes = [(0, 0.0), (1, 0.0)] + [(2, 0.0), (2, THICKNESS)] * (dim == 3)
    bcs = []
    for axis, at in planes:
        space, _ = V.sub(axis).collapse()
        dofs = fem.locate_dofs_geometrical(
            (V.sub(axis), space), lambda x, axis=axis, at=at: np.isclose(x[axis], at, atol=1e-9)
        )
        bcs.append(fem.dirichletbc(fem.Function(space), dofs, V.sub(axis)))
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs)
    stepper.advance()
    wider = ((1 - 2 * NU) * JOINT**2 + OUTER**2) / (OUTER**2 - JOINT**2)
    narrower = ((1 - 2 * NU) * JOINT**2 + INNER**2) / (JOINT**2 - INNER**2)
    return pair.pressure * (JOINT * (1 + NU) / E * (wider + narrower)) / OVER


@pytest.mark.parametrize("by", ["shaft", "hub"])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_shrink_fit_has_the_pressure_of_lame_at_each_node(cell, by, told):
    ratio = pressed(cell, by)
    told(
        f"shrink fit of {cell[:-2] + 'a' if cell.endswith('hedron') else cell + 's'} of degree 2 "
        f"on curved cells, nodes of the {by}, mortar",
        "Lame: pressure at each node",
        f"{ratio.min():.3f} to {ratio.max():.3f} of it",
    )
    assert ratio == pytest.approx(1, abs=TOLERANCE)


@pytest.mark.parametrize("by", ["shaft", "hub"])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_shrink_fit_of_straight_cells_has_it_with_smooth_surfaces(cell, by, told):
    ratio = pressed(cell, by, order=1, smooth=("shaft", "hub"))
    told(
        f"shrink fit of straight {cell[:-2] + 'a' if cell.endswith('hedron') else cell + 's'}, "
        f"smooth surfaces, nodes of the {by}, mortar",
        "Lame: pressure at each node",
        f"{ratio.min():.3f} to {ratio.max():.3f} of it",
    )
    assert ratio == pytest.approx(1, abs=SMOOTH_TOLERANCE)
