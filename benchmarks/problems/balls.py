"""Balls and tori that strike something."""

from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from benchmarks.scenes import ELEMENTS, SCHEMES, Scene, ball_on_plate
from dolfinx_nts.meshing.parts import add_torus

__all__ = ["ball", "ball_on_wall", "tori"]

# Solid ball in dimensionless units: modulus, Poisson's ratio, radius, flattening.
_E, _NU, _RADIUS, _FLAT = 1.0, 0.3, 1.0, 1e-3


def ball(
    comm: MPI.Comm, scheme: str, h: float | None, *, n: int, element: str, E: float = 1e5
) -> Scene:
    """Hollow ball on a plate, see `scenes.ball_on_plate`. Collective."""
    scene = ball_on_plate(comm, scheme, h, n=n, E=E, element=element)
    return _moving(scene.stepper, scene.body)


def tori(comm: MPI.Comm, scheme: str, h: float | None, *, n: int, element: str) -> Scene:
    """Soft torus that falls on another torus, after Yang and Laursen (2008). Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step [s]; None: what central differences choose.
        n: Cells around the tube; three times as many are along it.
        element: Key of `ELEMENTS`.
    """

    def build(model: Any) -> None:
        shape = {"radius": 76.0, "inner_radius": 19.5, "outer_radius": 24.0}
        cells = {"cells": (3 * n, n, 1), "cell": ELEMENTS[element].cell}
        add_torus(model, "lower", centre=(0, 0, 0), **shape, **cells)
        add_torus(model, "upper", centre=(20, 0, 110), axis=(0, -1, 1), **shape, **cells)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", ELEMENTS[element].degree, (3,)))
    material = nts.NeoHookean(2250.0, 0.3, 0.1, one_point=ELEMENTS[element].one_point)
    upper, lower = (nts.Body(V, cells, tag[name], material) for name in ("upper", "lower"))
    outer = (nts.Surface(V, facets, tag[f"{name}_outer"]) for name in ("upper", "lower"))
    stepper = SCHEMES[scheme].integrator([upper, lower], [SCHEMES[scheme].pair(*outer)], dt=h)
    stepper.set_velocity(upper, (0.0, 0.0, -30.0))
    return _moving(stepper, upper)


def ball_on_wall(comm: MPI.Comm, scheme: str, h: float | None, *, n: int, element: str) -> Scene:
    """Solid ball that strikes a rigid wall so slowly that Hertz' theory holds.

    A quarter of it, whose cells grow away from the contact. Greatest force and duration are
    relative to theory for the mass of the mesh (Johnson, Contact Mechanics, chapter 11).
    Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step, relative to the duration; None: what central differences choose.
        n: Cells in the greatest radius of contact.
        element: Key of `ELEMENTS`, of tetrahedra.
    """
    mesh, cells, facets, tag = nts.read_mesh(lambda model: _add_quarter(model, n), comm)
    V = fem.functionspace(mesh, ("Lagrange", ELEMENTS[element].degree, (3,)))
    body = nts.Body(V, cells, tag["ball"], nts.SaintVenantKirchhoff(_E, _NU, 1.0))
    mass = comm.allreduce(
        fem.assemble_scalar(fem.form(fem.Constant(mesh, 4.0) * ufl.dx(domain=mesh)))
    )
    stiffness = _E / (1 - _NU**2) * np.sqrt(_RADIUS)
    greatest = 4 / 3 * stiffness * _FLAT**1.5
    speed = np.sqrt(16 / 15 * stiffness * _FLAT**2.5 / mass)
    duration = 2.868 * (mass**2 / (stiffness**2 * speed)) ** 0.2
    bcs = []
    for axis, name in enumerate(("ball_x", "ball_y")):
        dofs = fem.locate_dofs_topological(V.sub(axis), 2, facets.find(tag[name]))
        bcs.append(fem.dirichletbc(np.float64(0.0), dofs, V.sub(axis)))
    wall = nts.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    pair = SCHEMES[scheme].pair(nts.Surface(V, facets, tag["ball_outer"]), wall)
    dt = None if h is None else h * duration
    stepper = SCHEMES[scheme].integrator([body], [pair], dt=dt, bcs=bcs)
    stepper.set_velocity(body, (0.0, 0.0, -speed))
    diagnostics = nts.Diagnostics(stepper)
    times, velocities, forces = [0.0], [-speed], []

    def record() -> None:
        times.append(stepper.t)
        velocities.append(float(diagnostics.body_velocity(body)[2]))
        forces.append(4 * float(diagnostics.contact_force()[2]))

    def judge() -> dict[str, float]:
        # Multipliers of elastic nodes alternate from step to step.
        smooth = np.convolve(forces, [0.25, 0.5, 0.25], mode="valid")
        rest = np.interp(0.0, velocities, times)  # after half of the time
        values = {"greatest force": smooth.max() / greatest, "duration": 2 * rest / duration}
        return {name: float(value) for name, value in values.items()}

    return Scene(stepper, body, judge, record, t_end=1.1 * duration)


def _add_quarter(model: Any, n: int) -> None:
    """Add a quarter of a ball in x, y > 0, which touches z = 0 at the origin. Local."""
    occ = model.occ
    whole = occ.addSphere(0, 0, _RADIUS, _RADIUS)
    # Poles and seam of gmsh's sphere must not be on the quarter.
    occ.rotate([(3, whole)], 0, 0, _RADIUS, 1, -1, 0, np.pi / 2)
    occ.rotate([(3, whole)], 0, 0, _RADIUS, 0, 0, 1, np.pi)
    box = occ.addBox(0, 0, -_RADIUS, 2 * _RADIUS, 2 * _RADIUS, 4 * _RADIUS)
    (volume,), _ = occ.intersect([(3, whole)], [(3, box)])
    occ.synchronize()
    model.addPhysicalGroup(3, [volume[1]], name="ball")
    for _, surface in model.getBoundary([volume], oriented=False):
        x, y, _ = occ.getCenterOfMass(2, surface)
        side = "x" if abs(x) < 1e-9 else "y" if abs(y) < 1e-9 else "outer"
        model.addPhysicalGroup(2, [surface], name=f"ball_{side}")
    a = np.sqrt(_FLAT * _RADIUS)
    near = f"Max(0, Sqrt(x*x + y*y + z*z) - {1.5 * a})"
    field = model.mesh.field.add("MathEval")
    model.mesh.field.setString(field, "F", f"Min({1 / n}, {a / n} + {1.5 / n} * {near})")
    model.mesh.field.setAsBackgroundMesh(field)
    model.mesh.generate(3)


def _moving(stepper: Any, body: nts.Body) -> Scene:
    """Scene whose result is the final velocity of a body."""
    diagnostics = nts.Diagnostics(stepper)

    def judge() -> dict[str, float]:
        _, v_y, v_z = diagnostics.body_velocity(body)
        return {"v_y": float(v_y), "v_z": float(v_z)}

    return Scene(stepper, body, judge)
