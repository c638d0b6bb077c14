"""Helpers of the verification tests: quarters of balls, bars, angular momentum."""

from typing import Any

import gmsh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

import dolfinx_nts as nts

Array = npt.NDArray[np.float64]


def add_quarter_ball(
    model: Any,
    name: str,
    *,
    radius: float,
    fine: float,
    zone: float,
    growth: float,
    coarse: float,
    height: float,
    half: bool = False,
    below: bool = False,
) -> None:
    """Add a quarter of a ball in x, y > 0 that touches z = 0 at the origin. Local.

    Tetrahedra, refined towards the origin. Surfaces ``outer``, ``top`` if
    the ball is cut off, and ``x`` and ``y`` on the planes of symmetry
    x = 0 and y = 0.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        radius: Radius.
        fine: Size of the cells at the origin.
        zone: Distance from the origin up to which they have this size.
        growth: Growth of the size per distance beyond.
        coarse: Largest size.
        height: Where the ball is cut off; twice the radius for a whole one.
        half: Whether to add the other quarter in x < 0, too.
        below: Whether to mirror the ball to z < 0.
    """
    occ = model.occ
    ball = occ.addSphere(0, 0, radius, radius)
    # Poles and seam of gmsh's sphere must not be on the quarter.
    occ.rotate([(3, ball)], 0, 0, radius, 1, -1, 0, np.pi / 2)
    occ.rotate([(3, ball)], 0, 0, radius, 0, 0, 1, np.pi)
    left = -2 * radius if half else 0.0
    box = occ.addBox(left, 0, -radius, 2 * radius - left, 2 * radius, height + radius)
    (volume,), _ = occ.intersect([(3, ball)], [(3, box)])
    if below:
        occ.mirror([volume], 0, 0, 1, 0)
    occ.synchronize()
    model.addPhysicalGroup(3, [volume[1]], name=name)
    sides: dict[str, list[int]] = {}
    for _, surface in model.getBoundary([volume], oriented=False):
        x, y, z = occ.getCenterOfMass(2, surface)
        flat = {"x": abs(x), "y": abs(y), "top": abs(abs(z) - height)}
        side = min(flat, key=lambda name: flat[name])
        if flat[side] > 1e-9 * radius or (half and side == "x"):
            side = "outer"
        sides.setdefault(side, []).append(surface)
    for side, tags in sides.items():
        model.addPhysicalGroup(2, tags, name=f"{name}_{side}")
    size = f"Min({coarse}, {fine} + {growth} * Max(0, Sqrt(x*x + y*y + z*z) - {zone}))"
    field = model.mesh.field.add("MathEval")
    model.mesh.field.setString(field, "F", size)
    model.mesh.field.setAsBackgroundMesh(field)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    # Existing meshes are kept; then gmsh has to be called for each dimension.
    gmsh.option.setNumber("Mesh.MeshOnlyEmpty", 1)
    for dimension in (1, 2, 3):
        model.mesh.generate(dimension)


def linear_in_stretch(E: float, nu: float, rho: float) -> nts.Hyperelastic:
    """Material whose stress is linear in stretches along the axes.

    psi = lambda/2 tr(e)^2 + mu e:e with e_ii = sqrt(C_ii) - 1 and shear
    as in linear elasticity; P = (lambda + 2 mu) (F_11 - 1) in uniaxial
    strain, P = E (F_11 - 1) in uniaxial stress.
    """

    def psi(C: Any, lmbda: Any, mu: Any) -> Any:
        e = [ufl.sqrt(C[i, i]) - 1 for i in range(3)]
        # Products of both halves of C, so that the derivative is symmetric.
        shear = C[0, 1] * C[1, 0] + C[1, 2] * C[2, 1] + C[0, 2] * C[2, 0]
        return lmbda / 2 * sum(e) ** 2 + mu * sum(x**2 for x in e) + mu / 2 * shear

    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    return nts.Hyperelastic(psi, rho=rho, lmbda=lmbda, mu=mu)


def rollers(V: fem.FunctionSpace, facets: Any, tags: list[int], axis: int) -> fem.DirichletBC:
    """Hold a component of the displacement on surfaces. Collective."""
    held = np.sort(np.concatenate([facets.find(tag) for tag in tags]))
    dofs = fem.locate_dofs_topological(V.sub(axis), 2, held)
    return fem.dirichletbc(np.float64(0.0), dofs, V.sub(axis))


def spin(stepper: nts.EnergyMomentum, body: nts.Body) -> Array:
    """Angular momentum of a body about its centre of mass. Collective."""
    mesh = stepper.u.function_space.mesh
    centre = fem.Constant(mesh, nts.Diagnostics(stepper).centre_of_mass(body))
    rho = fem.Constant(mesh, body.material.rho)
    x = ufl.SpatialCoordinate(mesh) + stepper.u
    density = rho * ufl.cross(x - centre, stepper.v)
    regions = [(0, np.sort(body.cells))]
    metadata = {"quadrature_degree": 2}
    dx = ufl.Measure("dx", domain=mesh, subdomain_data=regions, metadata=metadata)(0)
    parts = [fem.assemble_scalar(fem.form(density[i] * dx)) for i in range(3)]
    return np.array(mesh.comm.allreduce(np.array(parts)))
