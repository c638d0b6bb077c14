"""Rigid tools of revolution above the flat top of a large body, in space: a quarter of both."""

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import gmsh
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts

__all__ = ["TOOL_TOP", "press"]

# Height of the tools [m], small compared to the body.
TOOL_TOP = 1.0
_RIM = 1.5  # radius of the tools [m]
# Sectors of their facets: between them a circle is flat to a part in a thousand.
_SECTORS = 32


def press(
    profile: Callable[[float], float],
    size: str,
    *,
    E: float,
    nu: float,
    edge: float,
    far: float,
    rings: int = 1,
    depth: float = 0.0,
    force: float | None = None,
) -> tuple[float, float, Any, Any]:
    """Press a rigid tool into half a ball with a clamped round side; both are cut by x = 0, y = 0.

    Displacements have degree 2. The tool is a `nts.RigidBody`, moved by its guide or loaded by a
    force in one step.

    Args:
        profile: Height of the tool over the radius, 0 on the axis [m].
        size: Size of the cells of the body as a formula of gmsh [m].
        E: Young's modulus of the body [Pa].
        nu: Its Poisson ratio.
        edge: Radius up to which nodes may touch [m], the radius of a circle of edges.
        far: Radius of the body [m].
        rings: Rings of facets of the tool; one is enough where the profile is a line.
        depth: How far the guide moves the tool [m].
        force: Load of the whole tool that replaces the guide [N].

    Returns:
        Depth of the tool [m] and force on it [N]; radii [m] and forces [N] of the nodes.
    """

    def build(model: Any) -> None:
        _add_body(model, size, edge, far)
        _add_tool(model, profile, rings)

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(data.mesh, ("Lagrange", 2, (3,)))
    body = nts.Body(V, data.cells, data.tag["body"], nts.NeoHookean(E, nu, 1.0))
    motion = nts.Motion(lambda t: (0.0, 0.0, -depth * t))
    guide = nts.Guide(motion=motion) if force is None else nts.Guide(slides="z")
    tool = nts.RigidBody(V, data.cells, data.tag["tool"], 1.0, guide)
    sides = {name: data.facets.find(data.tag[name]) for name in ("x", "y", "far")}
    bcs = [fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, sides["far"]), V)]
    for axis in (0, 1):
        dofs = fem.locate_dofs_topological(V.sub(axis), 2, sides["xy"[axis]])
        bcs.append(fem.dirichletbc(0.0, dofs, V.sub(axis)))
    top = nts.Surface(V, data.facets, data.tag["top"])
    pair = nts.ContactPair(
        top,
        nts.boundary_of(tool, where=lambda x: x[2] < TOOL_TOP / 2),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    loads = [] if force is None else [nts.Force(tool, (0.0, 0.0, -force / 4))]
    stepper = nts.QuasiStatic([body, tool], [pair], dt=1.0, bcs=bcs, loads=loads)
    report = stepper.advance()
    reached = -float(stepper.u.x.array.reshape(-1, 3)[tool.nodes[0], 2])
    on_tool = -4 * report.reactions[-1].force[2] if force is None else force
    r = np.hypot(*stepper.x[top.nodes, :2].T)
    return reached, on_tool, r, -4 * pair.history.lambda_N


def _add_body(model: Any, size: str, edge: float, far: float) -> None:
    """Add the quarter of half a ball below z = 0, with surfaces ``x``, ``y``, ``far``, ``top``."""
    occ = model.occ
    quarter = occ.addSphere(0, 0, 0, far, angle1=-np.pi / 2, angle2=0.0, angle3=np.pi / 2)
    arc = occ.addCircle(0, 0, 0, edge, angle1=0.0, angle2=np.pi / 2)
    parts, _ = occ.fragment([(3, quarter)], [(1, arc)])
    occ.synchronize()
    (volume,) = (part for part in parts if part[0] == 3)
    model.addPhysicalGroup(3, [volume[1]], name="body")
    for _, surface in model.getBoundary([volume], oriented=False):
        low, high = np.reshape(model.getBoundingBox(2, surface), (2, 3))
        flat = high - low < 1e-3 * edge
        if not flat.any():
            model.addPhysicalGroup(2, [surface], name="far")
        elif not flat[2]:
            model.addPhysicalGroup(2, [surface], name="xy"[int(flat.argmax())])
        elif high.max() < 2 * edge:
            model.addPhysicalGroup(2, [surface], name="top")
    field = model.mesh.field.add("MathEval")
    model.mesh.field.setString(field, "F", size)
    model.mesh.field.setAsBackgroundMesh(field)
    for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
    model.mesh.generate(3)


def _add_tool(model: Any, profile: Callable[[float], float], rings: int) -> None:
    """Add the quarter of a tool: tetrahedra between facets of its underside and a point above."""
    angles = np.linspace(0.0, np.pi / 2, _SECTORS + 1)
    radii = _RIM * np.arange(1, rings + 1) / rings
    points = [(0.0, 0.0, TOOL_TOP), (0.0, 0.0, profile(0.0))]
    points += [(r * np.cos(a), r * np.sin(a), profile(r)) for r in radii for a in angles]
    node = 2 + np.arange(rings * len(angles)).reshape(rings, -1)
    facets = [(1, *pair) for pair in zip(node[0], node[0, 1:], strict=False)]
    for i, j in np.ndindex(rings - 1, _SECTORS):
        inner, outer = node[i, j : j + 2], node[i + 1, j : j + 2]
        facets += [(inner[0], *outer), (inner[0], outer[1], inner[1])]
    tool = model.addDiscreteEntity(3)
    first = int(model.mesh.getMaxNodeTag()) + 1
    tags = np.arange(first, first + len(points))
    model.mesh.addNodes(3, tool, tags, np.ravel(points))
    cells = np.column_stack([facets, np.zeros(len(facets), dtype=int)])
    model.mesh.addElementsByType(tool, 4, [], first + cells.ravel())
    model.addPhysicalGroup(3, [tool], name="tool")
