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
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import dolfinx_nts as nts

pytest.importorskip("gmsh")
pytestmark = pytest.mark.serial

E, NU = 200e9, 0.3  # Pa, -
INNER, JOINT, OUTER, OVER, THICKNESS = 0.025, 0.05, 0.10, 5e-6, 0.005  # m
# Tolerances of each nodal pressure, on curved cells and on straight ones with smooth surfaces.
TOLERANCE, SMOOTH_TOLERANCE = 0.03, 0.005


# Radii of both parts [m].
FIT = {"shaft": (INNER, JOINT + OVER), "hub": (JOINT, OUTER)}


def rings(
    model: Any,
    cell: str,
    edges: dict[str, int],
    order: int,
    radii: dict[str, tuple[float, float]] = FIT,
    thickness: float = THICKNESS,
) -> None:
    """Add quarters of shaft and hub about the axis z, with facets along the quarter of each."""
    dim = 3 if cell in ("tetrahedron", "hexahedron") else 2
    for name, (a, b) in radii.items():
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
                [(2, face)], 0, 0, thickness, numElements=[1], recombine=recombine
            )
            model.occ.synchronize()
            whole, joint = above[1][1], above[2 + sides.index(joint)][1]
        model.addPhysicalGroup(dim, [whole], name=name)
        model.addPhysicalGroup(dim - 1, [joint], name=f"{name}_joint")
    model.mesh.generate(dim)
    model.mesh.setOrder(order)


def guided(V: fem.FunctionSpace, thickness: float) -> list[fem.DirichletBC]:
    """Supports on planes of symmetry, and of plane strain in space."""
    planes = [(0, 0.0), (1, 0.0)] + [(2, 0.0), (2, thickness)] * (V.mesh.topology.dim == 3)
    bcs = []
    for axis, at in planes:
        space, _ = V.sub(axis).collapse()
        dofs = fem.locate_dofs_geometrical(
            (V.sub(axis), space), lambda x, axis=axis, at=at: np.isclose(x[axis], at, atol=1e-9)
        )
        bcs.append(fem.dirichletbc(fem.Function(space), dofs, V.sub(axis)))
    return bcs


def pressed(cell: str, by: str, order: int = 2, smooth: tuple[str, ...] = ()) -> np.ndarray:
    """Fit both, with contact nodes on one body; nodal pressure relative to Lame's."""
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
    pair = nts.ContactPair(nodes, segments, method="mortar", enforcement=nts.LagrangeMultiplier())
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=guided(V, THICKNESS))
    stepper.advance()
    wider = ((1 - 2 * NU) * JOINT**2 + OUTER**2) / (OUTER**2 - JOINT**2)
    narrower = ((1 - 2 * NU) * JOINT**2 + INNER**2) / (JOINT**2 - INNER**2)
    return pair.pressure * (JOINT * (1 + NU) / E * (wider + narrower)) / OVER


@pytest.mark.parametrize("by", ["shaft", "hub"])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_shrink_fit_has_the_pressure_of_lame_at_each_node(cell, by, table_row):
    ratio = pressed(cell, by)
    table_row(
        f"shrink fit of {cell[:-2] + 'a' if cell.endswith('hedron') else cell + 's'} of degree 2 "
        f"on curved cells, nodes of the {by}, mortar",
        "Lame: pressure at each node",
        f"{ratio.min():.3f} to {ratio.max():.3f} of it",
    )
    assert ratio == pytest.approx(1, abs=TOLERANCE)


@pytest.mark.parametrize("by", ["shaft", "hub"])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_shrink_fit_of_straight_cells_has_it_with_smooth_surfaces(cell, by, table_row):
    ratio = pressed(cell, by, order=1, smooth=("shaft", "hub"))
    table_row(
        f"shrink fit of straight {cell[:-2] + 'a' if cell.endswith('hedron') else cell + 's'}, "
        f"smooth surfaces, nodes of the {by}, mortar",
        "Lame: pressure at each node",
        f"{ratio.min():.3f} to {ratio.max():.3f} of it",
    )
    assert ratio == pytest.approx(1, abs=SMOOTH_TOLERANCE)


# Facets along the quarter of a shaft of radius 1 m in a hub, and their length [m].
NUM_FACETS = 16
FACET = np.pi / 2 / NUM_FACETS
SHEAR = 1e6  # Pa


def nominal_pressure(radii: dict[str, tuple[float, float]]) -> float:
    """Force per undeformed area of the shaft, relative to the shear modulus [-].

    Equilibrium of thick neo-Hookean tubes at large strains, without lateral contraction: with the
    principal stretches ``a = dr/dR`` and ``b = r/R``, ``d(R P_a)/dR = P_b`` and ``P = a - 1/a``.
    """

    def slope(R, state):
        r, a = state
        b = r / R
        return a, (b - 1 / b - (a - 1 / a)) / R / (1 + 1 / a**2)

    def end(free: float, joint: float, r: float) -> tuple[float, float]:
        """Radius and stress P_a at the joint from the radius of the free surface."""
        path = solve_ivp(slope, (free, joint), (r, 1.0), rtol=1e-10, atol=1e-12)
        r, a = path.y[:, -1]
        return r, a - 1 / a

    (inner, shaft), (hub, outer) = radii["shaft"], radii["hub"]

    def mismatch(free):
        (r, p), (s, q) = end(inner, shaft, free[0]), end(outer, hub, free[1])
        return r - s, p * shaft - q * hub

    free = fsolve(mismatch, (inner, outer), xtol=1e-12)
    return -end(inner, shaft, free[0])[1]


@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
@pytest.mark.parametrize("facets_inside", [0.2, 0.6, 1.0, 2.0, 3.0])
def test_press_fit_that_starts_facets_deep_has_the_pressure_of_thick_tubes(
    cell, method, facets_inside
):
    over = facets_inside * FACET
    radii = {"shaft": (0.4, 1 + over), "hub": (1.0, 2.0)}
    edges = dict.fromkeys(radii, NUM_FACETS)
    shape = {"edges": edges, "order": 1, "radii": radii, "thickness": FACET}
    data = nts.read_mesh(partial(rings, cell=cell, **shape), MPI.COMM_WORLD)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (data.mesh.topology.dim,)))
    rubber = nts.NeoHookean(E=2 * SHEAR, nu=0.0, rho=1e3)
    bodies = [nts.Body(V, data.cells, data.tag[name], rubber) for name in radii]
    nodes, segments = (nts.Surface(V, data.facets, data.tag[f"{n}_joint"]) for n in radii)
    pair = nts.ContactPair(nodes, segments, method=method, enforcement=nts.LagrangeMultiplier())
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=guided(V, FACET))
    stepper.advance()
    # Facets of both are chords between nodes on circles.
    length = 2 * NUM_FACETS * np.sin(FACET / 2) * radii["shaft"][1]
    area = length * (FACET if cell == "hexahedron" else 1.0)
    mean = -pair.history.lambda_N.sum() / area
    ratio = mean / (SHEAR * nominal_pressure(radii))
    assert ratio == pytest.approx(1, abs=0.002)  # 0.0013 at most
