"""Closed forms of revolution: uniform stress, a thick tube, and rigid tools pressed into a body.

With 1/E* = (1 - nu^2)/E, see K. L. Johnson, Contact Mechanics, chapters 3 to 5 (Boussinesq,
Hertz, Sneddon); Lame's tube as in S. P. Timoshenko and J. N. Goodier, Theory of Elasticity. Forces
are those of whole rings.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from mpi4py import MPI

import gmsh
import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from benchmarks.rings import impact as rings_impact
from dolfinx_nts.compat import geometry_nodes
from helpers.models.plane import block
from helpers.models.rings import half_disc, round_block
from helpers.models.round import plane_mesh, tagged

pytestmark = pytest.mark.serial

E = 1.0  # Pa


def held(data: Any, V: fem.FunctionSpace, axis: int, *names: str) -> fem.DirichletBC:
    """Hold a component of the displacement on curves."""
    facets = np.sort(np.concatenate([data.facets.find(data.tag[name]) for name in names]))
    dofs = fem.locate_dofs_topological(V.sub(axis), 1, facets)
    return fem.dirichletbc(0.0, dofs, V.sub(axis))


# --- uniform stress ----------------------------------------------------


@pytest.mark.parametrize(
    ("cell", "degree", "nu"),
    [
        *(("quadrilateral", 1, 0.2), ("quadrilateral", 1, 0.49), ("triangle", 1, 0.3)),
        *(("quadrilateral", 2, 0.3), ("triangle", 2, 0.3)),
    ],
)
def test_uniform_stress_is_exact_on_distorted_cells(cell, degree, nu, table_row):
    """Radial and axial tractions on a round block: u = (a x, b y), the same stress everywhere."""
    data, V = round_block((4, 3), cell, degree, skew=0.06)
    law = nts.NeoHookean(E, nu, 1.0, volumetric="quadratic")
    body = nts.Body(V, data.cells, data.tag["block"], law)
    sides = {s: nts.Surface(V, data.facets, data.tag[f"block_{s}"]) for s in ("right", "top")}
    p, q = 0.2, -0.1
    loads = [nts.Traction(sides["right"], (p, 0.0)), nts.Traction(sides["top"], (0.0, q))]
    stepper = nts.QuasiStatic([body], dt=1.0, bcs=[held(data, V, 1, "block_bottom")], loads=loads)
    (reaction,) = stepper.advance().reactions
    X, u = V.tabulate_dof_coordinates(), stepper.u.x.array.reshape(-1, 2)
    a, b = (float(u[:, i] @ X[:, i] / (X[:, i] @ X[:, i])) for i in (0, 1))
    assert np.abs(u - X[:, :2] * [a, b]).max() < 1e-9
    # Piola's stress of the law at these stretches equals the loads.
    t, s = 1 + a, 1 + b
    lmbda, mu, J = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu)), t * t * s
    assert mu * (t - 1 / t) + lmbda * (J - 1) * J / t == pytest.approx(p, abs=1e-9)
    assert mu * (s - 1 / s) + lmbda * (J - 1) * J / s == pytest.approx(q, abs=1e-9)
    assert reaction.force[0] == pytest.approx(-q * np.pi, rel=1e-9)
    stress = nts.Fields(stepper).cauchy_stress().x.array.reshape(-1, 3, 3)
    expected = np.diag([p / (t * s), q / t**2, p / (t * s)])
    error = np.abs(stress - expected).max()
    table_row(
        f"axisymmetric: uniform stress on distorted {cell}s of degree {degree}, nu = {nu:g}",
        "radial and axial tractions: the same stress everywhere",
        f"largest error {error:.0e} of the moduli",
    )
    assert error < 1e-8


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cells", [(4, 6), (6, 4)])
def test_axisymmetric_patch_test_is_passed_by_mortar(cells, degree, table_row):
    """Round blocks with non-matching meshes, compressed and widened equally: uniform pressure."""
    lower, upper = (
        block((0.0, z), (1.0, 1.0), (n, 2)) for z, n in ((-1.0, cells[0]), (0.0, cells[1]))
    )
    domain = plane_mesh(MPI.COMM_SELF, lower, upper)
    nts.axisymmetric(domain)
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    tags, law = tagged(domain, lambda x: x[:, 1] < 0), nts.NeoHookean(E, 0.3, 1.0)
    bodies = [nts.Body(V, tags, tag, law) for tag in (1, 2)]
    sides = [nts.boundary_of(body, where=lambda x: abs(x[1]) < 1e-9) for body in bodies]
    pair = nts.ContactPair(*sides, method="mortar", enforcement=nts.LagrangeMultiplier())
    amounts, bcs, whole = (0.004, -0.01), [], fem.Function(V)
    whole.interpolate(lambda x: np.array([a * x[i] for i, a in enumerate(amounts)]))
    for axis in (0, 1):
        part = V.sub(axis)
        given = fem.Function(part.collapse()[0])
        given.interpolate(lambda x, axis=axis: amounts[axis] * x[axis])
        at_end = fem.locate_dofs_geometrical(
            (part, given.function_space), lambda x, axis=axis: np.isclose(abs(x[axis]), 1.0)
        )
        bcs.append(fem.dirichletbc(given, at_end, part))
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs)
    stepper.advance()
    pressure = stepper.contacts[0].pressure
    spread = np.ptp(pressure) / pressure.mean()
    moved = np.abs(stepper.u.x.array - whole.x.array).max()
    table_row(
        f"axisymmetric: patch test by mortar, {cells[0]}:{cells[1]} cells, degree {degree}",
        "uniform strain and pressure",
        f"error {moved:.0e}, spread {spread:.0e}",
    )
    assert moved <= 1e-11
    assert spread <= 1e-9
    # The multipliers are forces of whole rings: the stress of the law times the section.
    t, s = 1 + amounts[0], 1 + amounts[1]
    lmbda, mu = E * 0.3 / (1.3 * 0.4), E / 2.6
    stress = mu * (s - 1 / s) + lmbda * np.log(t * t * s) / s
    force = stepper.contacts[0].history.lambda_N.sum()
    assert force == pytest.approx(stress * np.pi, rel=1e-9)


# --- a tube ------------------------------------------------------------


@pytest.mark.parametrize(
    ("cell", "degree", "nu", "margin"),
    [
        *(("quadrilateral", 1, 0.3, 0.003), ("quadrilateral", 1, 0.4999, 0.003)),
        *(("triangle", 1, 0.3, 0.01), ("quadrilateral", 2, 0.3, 1e-4), ("triangle", 2, 0.3, 1e-4)),
    ],
)
def test_thick_tube_under_pressure_widens_as_lame_says(cell, degree, nu, margin, table_row):
    """Plane strain along the axis: u_r = (1 + nu) p a^2/(E (b^2 - a^2)) ((1 - 2 nu) r + b^2/r)."""
    a, b, p, n = 1.0, 2.0, 1e-5, 10
    data, V = round_block((n, 2), cell, degree, corner=(a, 0.0), size=(b - a, 0.2))
    body = nts.Body(V, data.cells, data.tag["block"], nts.SaintVenantKirchhoff(E, nu, 1.0))
    inside = nts.Surface(V, data.facets, data.tag["block_left"])
    ends = held(data, V, 1, "block_bottom", "block_top")
    load = nts.Pressure(inside, p)
    stepper = nts.QuasiStatic([body], dt=1.0, bcs=[ends], loads=[load])
    stepper.advance()
    r, u = V.tabulate_dof_coordinates()[:, 0], stepper.u.x.array[::2]
    scale = (1 + nu) * p * a**2 / (E * (b**2 - a**2))
    exact = scale * ((1 - 2 * nu) * r + b**2 / r)
    error = np.abs(u / exact - 1).max()
    table_row(
        f"axisymmetric: tube of {n} {cell}s of degree {degree}, nu = {nu:g}, inner pressure",
        "Lame: radial displacement",
        f"largest error {100 * error:.2g} %",
    )
    assert error <= margin


# --- an impact in space ------------------------------------------------


def test_ball_rebounds_as_one_of_tetrahedra(table_row):
    """The same ball and plate, meshed in space with cells of the same size."""
    fine, rings, space = rings_impact(16, 2), rings_impact(6, 2), rings_impact(6, 3)
    table_row(
        "axisymmetric: ball on a plate, 6 cells in its radius",
        "the same bodies of tetrahedra in space, and 16 cells: rebound",
        f"{rings.rebound:.3f}, in space {space.rebound:.3f}, with 16 cells {fine.rebound:.3f}",
    )
    assert abs(rings.rebound - fine.rebound) < 0.5 * abs(space.rebound - fine.rebound)
    assert abs(space.rebound - fine.rebound) < 0.015
    assert space.mass / rings.mass == pytest.approx(1, abs=0.02)
    assert space.unknowns > 20 * rings.unknowns


def test_rigid_ball_rebounds_as_one_in_space(table_row):
    """A rigid ball on the same plate, which gives the nodes."""
    rings, space = rings_impact(8, 2, rigid=True), rings_impact(6, 3, rigid=True)
    table_row(
        "axisymmetric: rigid ball on a plate, 8 cells in its radius",
        "tetrahedra in space, 6 cells: rebound, greatest force",
        f"{rings.rebound:.3f}, {rings.greatest / 1e3:.1f} kN, "
        f"in space {space.rebound:.3f}, {space.greatest / 1e3:.1f} kN",
    )
    assert abs(rings.rebound - space.rebound) < 0.01
    assert rings.greatest == pytest.approx(space.greatest, rel=0.03)
    assert rings.mass == pytest.approx(space.mass, rel=0.01)


def test_resolved_force_of_a_ball_is_that_in_space(table_row):
    """Nodes without mass: the force has no jumps, so that it can be compared."""
    rings, space = (rings_impact(6, dim, law="resolved") for dim in (2, 3))
    table_row(
        "axisymmetric: ball on a plate by resolved impact, 6 cells in its radius",
        "the same in tetrahedra: rebound, greatest force",
        f"{rings.rebound:.3f}, {rings.greatest / 1e3:.1f} kN, "
        f"in space {space.rebound:.3f}, {space.greatest / 1e3:.1f} kN",
    )
    assert abs(rings.rebound - space.rebound) < 0.01
    assert rings.greatest == pytest.approx(space.greatest, rel=0.02)


# --- rigid tools -------------------------------------------------------

FAR, NU = 400.0, 0.3  # ratio of the radii of body and contact
NEAR = "0.02 + 0.1 * Max(0, Sqrt(x * x + y * y) - 1.3)"  # 50 cells in the radius of contact


def half_ball(model: Any, size: str, edge: float) -> None:
    """Add the body, whose flat top has its middle at the origin, with a node at the edge.

    Args:
        model: Model of gmsh, without a mesh.
        size: Size of cells as a formula of gmsh [m].
        edge: Radius up to which nodes may touch [m].
    """
    occ = model.occ
    ball = half_disc(occ, 0.0, FAR)
    below = occ.addRectangle(0, -2 * FAR, 0, 2 * FAR, 2 * FAR)
    ((_, half),), _ = occ.intersect([(2, ball)], [(2, below)])
    if np.isfinite(edge):
        occ.fragment([(2, half)], [(0, occ.addPoint(edge, 0, 0))])
    occ.synchronize()
    model.addPhysicalGroup(2, [half], name="body")
    field = model.mesh.field.add("MathEval")
    model.mesh.field.setString(field, "F", size)
    model.mesh.field.setAsBackgroundMesh(field)
    for option in ("ExtendFromBoundary", "FromPoints"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)


class HalfBall(NamedTuple):
    """The body, the contact surface at its top, and the clamp of its round side."""

    body: nts.Body
    top: nts.Surface
    clamp: fem.DirichletBC

    @classmethod
    def of(cls, V: fem.FunctionSpace, data: Any, edge: float) -> "HalfBall":
        """Make it of a mesh with `half_ball`."""
        body = nts.Body(V, data.cells, data.tag["body"], nts.NeoHookean(E, NU, 1.0))
        reach = min(edge, 3.0) * (1 + 1e-9)
        top = nts.boundary_of(body, where=lambda x: (x[1] > -1e-9) & (x[0] < reach))
        far = fem.locate_dofs_geometrical(V, lambda x: np.hypot(x[0], x[1]) > FAR * (1 - 1e-3))
        return cls(body, top, fem.dirichletbc(np.zeros(2), far, V))


def pressed(
    tool: Any, depth: float, size: str, edge: float = np.inf
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Press a moving tool into the flat top of half a ball with a clamped round side.

    Args:
        tool: Obstacle that touches the top at the origin.
        depth: How far it moves [m]; contact has a radius of about 1 m.
        size: Size of cells as a formula of gmsh [m].
        edge: Radius up to which nodes may touch [m].

    Returns:
        Force on the tool [N]; radii [m], forces [N] and pressures [Pa] of the contact nodes.
    """

    def build(model: Any) -> None:
        half_ball(model, size, edge)
        model.mesh.generate(2)

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    nts.axisymmetric(data.mesh)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    body, top, clamp = HalfBall.of(V, data, edge)
    pair = nts.ContactPair(
        top,
        tool.moving(nts.Motion(lambda t: (0.0, -depth * t))),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.QuasiStatic([body], [pair], dt=0.5, bcs=[clamp])
    for _ in stepper.run(1.0):
        pass
    (on,) = nts.Diagnostics(stepper).obstacles().values()
    r = stepper.x[top.nodes, 0]
    order = np.argsort(r)
    return float(on.force[0]), r[order], -pair.history.lambda_N[order], pair.pressure[order]


RIM = 1.5  # radius of meshed tools [m]


def pressed_by_body(
    profile: Callable[[np.ndarray], np.ndarray],
    size: str,
    edge: float = np.inf,
    *,
    depth: float = 0.0,
    force: float | None = None,
) -> tuple[float, float]:
    """Press a meshed rigid tool into the same body, by its guide or by a force in one step.

    Args:
        profile: Height of the tool over the radius, 0 on the axis [m].
        size: Size of cells as a formula of gmsh [m].
        edge: Radius up to which nodes may touch [m].
        depth: How far the guide moves the tool [m].
        force: Load of the tool that replaces the guide [N].

    Returns:
        Depth of the tool [m], and the force on it [N].
    """

    def build(model: Any) -> None:
        half_ball(model, size, edge)
        tool = model.occ.addRectangle(0, 0, 0, RIM, 0.2)
        model.occ.synchronize()
        model.addPhysicalGroup(2, [tool], name="tool")
        for _, line in model.getBoundary([(2, tool)], oriented=False):
            low, high = np.array(model.getBoundingBox(1, line)).reshape(2, 3)
            model.mesh.setTransfiniteCurve(line, 76 if high[0] - low[0] > 1 else 2)
        model.mesh.setTransfiniteSurface(tool)
        model.mesh.generate(2)

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    of_tool = np.unique(geometry_nodes(data.mesh)[data.cells.find(data.tag["tool"])])
    x = data.mesh.geometry.x
    x[of_tool, 1] += profile(x[of_tool, 0])
    nts.axisymmetric(data.mesh)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    body, top, clamp = HalfBall.of(V, data, edge)
    motion = nts.Motion(lambda t: (0.0, -depth * t))
    guide = nts.Guide(motion=motion) if force is None else None
    tool = nts.RigidBody(V, data.cells, data.tag["tool"], 1.0, guide)
    face = nts.boundary_of(tool, where=lambda x: x[1] < profile(x[0]) + 0.01)
    loads = [] if force is None else [nts.Force(tool, (0.0, -force))]
    stepper = nts.QuasiStatic(
        [body, tool],
        [
            nts.ContactPair(
                top, face, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
            )
        ],
        dt=1.0,
        bcs=[clamp],
        loads=loads,
    )
    held, *of_guide = stepper.advance().reactions
    on_tool = -of_guide[0].force[0] if force is None else force
    assert held.force[0] == pytest.approx(on_tool, rel=1e-6)
    return -float(stepper.u.x.array.reshape(-1, 2)[tool.nodes[0], 1]), float(on_tool)


E_STAR = E / (1 - NU**2)


def test_flat_punch_has_the_force_of_boussinesq(table_row):
    """F = 2 a E* d, for a smooth flat end of radius a; pressure 1/sqrt(a^2 - r^2) inside."""
    depth, a = 1e-3, 1.0
    # Fine at the edge, where the pressure has no bound.
    size = "0.002 + 0.06 * Sqrt((x - 1) * (x - 1) + y * y)"
    F, r, _, pressure = pressed(nts.RigidPlane((0, 0), (0, -1)), depth, size, a)
    error = F / (2 * a * E_STAR * depth) - 1
    inside = r < 0.9
    shape = E_STAR * depth / np.pi / np.sqrt(a**2 - r[inside] ** 2)
    worst = np.abs(pressure[inside] / shape - 1).max()
    table_row(
        "axisymmetric: flat punch",
        "Boussinesq: force, pressure up to 0.9 of the radius",
        f"{100 * error:+.2f} %, within {100 * worst:.1f} %",
    )
    assert abs(error) <= 0.01
    assert worst <= 0.02


def test_sphere_has_force_and_radius_of_hertz(table_row):
    """F = 4/3 E* sqrt(R) d^(3/2), a = sqrt(R d), p0 = 2 E* a/(pi R)."""
    a, R = 1.0, 100.0
    depth = a**2 / R
    F, r, p, pressure = pressed(nts.RigidSphere((0, R), R), depth, NEAR)
    # Hertz' pressure has sum p r^2 = 2/5 F a^2.
    radius = np.sqrt(2.5 * p @ r**2 / p.sum())
    force, greatest = 4 / 3 * E_STAR * np.sqrt(R) * depth**1.5, 2 * E_STAR * a / (np.pi * R)
    errors = F / force - 1, radius / a - 1, pressure.max() / greatest - 1
    table_row(
        "axisymmetric: sphere pressed into a body, 50 cells in a",
        "Hertz: force, radius, greatest pressure",
        ", ".join(f"{100 * error:+.2f} %" for error in errors),
    )
    assert np.abs(errors).max() <= 0.01


def test_cone_has_the_force_of_sneddon(table_row):
    """F = 2/pi E* tan(half angle) d^2, a = 2/pi tan(half angle) d."""
    steep = np.radians(0.5)  # angle between the cone and the surface
    depth = np.pi / 2 * np.tan(steep)
    cone = nts.RigidCone((0, 0), np.pi / 2 - steep)
    F, r, p, _ = pressed(cone, depth, NEAR)
    force = 2 / np.pi * E_STAR / np.tan(steep) * depth**2
    # Sneddon's pressure, arcosh(a/r), has sum p r^2 = F a^2/3.
    radius = np.sqrt(3 * p @ r**2 / p.sum())
    table_row(
        "axisymmetric: cone pressed into a body, 50 cells in a",
        "Sneddon: force, radius",
        f"{100 * (F / force - 1):+.2f} %, {100 * (radius - 1):+.2f} %",
    )
    assert abs(F / force - 1) <= 0.01
    assert abs(radius - 1) <= 0.01


BODIES = {
    "flat punch": (
        lambda r: 0 * r,
        "0.002 + 0.06 * Sqrt((x - 1) * (x - 1) + y * y)",
        1.0,
        1e-3,
        2 * E_STAR * 1e-3,
    ),
    "sphere": (
        lambda r: 100.0 - np.sqrt(100.0**2 - np.minimum(r, RIM) ** 2),
        NEAR,
        np.inf,
        1e-2,
        4 / 3 * E_STAR * 10.0 * 1e-3,
    ),
}


@pytest.mark.parametrize("name", BODIES)
def test_rigid_body_under_the_force_of_a_prescribed_motion_makes_this_motion(name, table_row):
    """A meshed tool: moved by its guide it has the force of the closed form, and the reverse."""
    profile, size, edge, depth, exact = BODIES[name]
    went, force = pressed_by_body(profile, size, edge, depth=depth)
    assert went == pytest.approx(depth, rel=1e-12)
    error = force / exact - 1
    reached, _ = pressed_by_body(profile, size, edge, force=force)
    table_row(
        f"axisymmetric: {name} as a rigid body, moved by a guide, then under the force it had",
        {"flat punch": "Boussinesq", "sphere": "Hertz"}[name] + ": force; the travel of the guide",
        f"{100 * error:+.2f} %, the same travel within 1e-8",
    )
    assert abs(error) <= 0.01
    assert abs(reached / depth - 1) < 1e-8
