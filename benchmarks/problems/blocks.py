"""Blocks that lean, slide to rest, or are pressed."""

from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from benchmarks.scenes import ELEMENTS, SCHEMES, Scene
from dolfinx_nts.meshing.parts import add_box

__all__ = ["braking_block", "paraboloid", "pressed_block"]

_UP = (0.0, 0.0, 1.0)


def pressed_block(comm: MPI.Comm, scheme: str, h: float | None, *, n: int, element: str) -> Scene:
    """Soft block that leans and slides on a rigid plane, and never parts.

    Its weight holds it down, and it starts close to equilibrium under it; all nodes
    at the bottom touch from the start. Collective.
    """

    def build(model: Any) -> None:
        cells = {"cells": (n, n, n), "cell": ELEMENTS[element].cell}
        add_box(model, "block", corner=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1.0), **cells)

    mesh, tags, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", ELEMENTS[element].degree, (3,)))
    block = nts.Body(V, tags, tag["block"], nts.SaintVenantKirchhoff(1e4, 0.0, 10.0))
    # Without overlap, so that round-off does not decide which nodes touch.
    plane = nts.RigidPlane((0.0, 0.0, 1e-14), _UP)
    pair = SCHEMES[scheme].pair(nts.Surface(V, facets, tag["block_bottom"]), plane)
    weight = nts.Gravity([block], (0.0, 0.0, -20.0))
    stepper = SCHEMES[scheme].integrator([block], [pair], dt=h, loads=[weight])
    g, stiffness = 20.0, 1e4 / 10.0  # E / rho
    stepper.set_displacement(
        block, lambda x: [0.0 * x[2], 0.0 * x[2], -g / stiffness * (x[2] - x[2] ** 2 / 2)]
    )
    # No node moves across the plane at its height.
    stepper.set_velocity(block, lambda x: [1.0 + 0.3 * x[2], 0.1 * x[2], 0.0 * x[2]])
    return Scene(stepper, block)


def braking_block(comm: MPI.Comm, scheme: str, h: float | None, *, n: int, element: str) -> Scene:
    """Flat stiff block that slides on a rigid plane until friction stops it.

    The sliding distance is relative to v^2/(2 mu g). Collective.
    """

    def build(model: Any) -> None:
        cells = {"cells": (n, n, max(1, n // 2)), "cell": ELEMENTS[element].cell}
        add_box(model, "block", corner=(0.0, 0.0, 0.0), size=(1.0, 1.0, 0.25), **cells)

    speed, mu, g = 2.0, 0.3, 10.0
    mesh, tags, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", ELEMENTS[element].degree, (3,)))
    material = nts.SaintVenantKirchhoff(1e7, 0.3, 1e3, one_point=ELEMENTS[element].one_point)
    block = nts.Body(V, tags, tag["block"], material)
    bottom = nts.Surface(V, facets, tag["block_bottom"])
    pair = SCHEMES[scheme].pair(bottom, nts.RigidPlane((0, 0, 0), _UP), nts.Coulomb(mu))
    weight = nts.Gravity([block], (0.0, 0.0, -g))
    stepper = SCHEMES[scheme].integrator([block], [pair], dt=h, loads=[weight])
    stepper.set_velocity(block, (speed, 0.0, 0.0))
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.centre_of_mass(block)[0]

    def judge() -> dict[str, float]:
        way = diagnostics.centre_of_mass(block)[0] - start
        return {"way": float(way / (speed**2 / (2 * mu * g)))}

    return Scene(stepper, block, judge, t_end=1.5 * speed / (mu * g))


def paraboloid(comm: MPI.Comm, scheme: str, h: float | None, *, n: int, element: str) -> Scene:
    """Block with a round face that is pressed on another block, by hexahedra.

    A quarter of the scene, with cells that grow from the contact and do not match. Judged is
    the nodal pressure within 0.85 of the contact radius, relative to the greatest one of
    Hertz' theory for the force (Johnson, Contact Mechanics, chapter 4). Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step, of which the way is done at 1.
        n: Cells along an edge of the upper block; the lower one has three quarters of them.
        element: Key of `ELEMENTS`.
    """
    modulus, ratio, radius, depth = 1.0, 0.3, 4.0, 0.02

    def build(model: Any) -> None:
        # The upper block is separate, so that its nodes can be identified.
        for name, z, cells in (("low", 0.0, 3 * n // 4), ("up", 2.0, n)):
            shape = {"size": (1.0, 1.0, 1.0), "cells": (cells, cells, max(4, cells // 2))}
            add_box(model, name, corner=(0.0, 0.0, z), **shape)

    mesh, tags, facets, tag = nts.read_mesh(build, comm)
    X, is_up = mesh.geometry.x, mesh.geometry.x[:, 2] > 1.5
    X[is_up, 2] -= 2.0
    X[:] = 0.8 * X**2.2 + 0.2 * X
    X[is_up, 2] += (1 - X[is_up, 2]) * (X[is_up, :2] ** 2).sum(axis=1) / 2 / radius
    X[~is_up, 2] *= -1
    V = fem.functionspace(mesh, ("Lagrange", ELEMENTS[element].degree, (3,)))
    material = nts.SaintVenantKirchhoff(modulus, ratio, 1.0, one_point=ELEMENTS[element].one_point)
    bodies = [nts.Body(V, tags, tag[name], material) for name in ("up", "low")]
    # The surfaces named bottom were the lower ends when the boxes were created.
    faces = (nts.Surface(V, facets, tag[name]) for name in ("up_bottom", "low_bottom"))
    down, zero, bcs = fem.Constant(mesh, 0.0), np.float64(0.0), []
    ends = [facets.find(tag[name]) for name in ("up_top", "low_top")]
    for axis, sides in enumerate((("up_left", "low_left"), ("up_front", "low_front"))):
        held = np.unique(np.concatenate([*ends, *(facets.find(tag[name]) for name in sides)]))
        dofs = fem.locate_dofs_topological(V.sub(axis), 2, held)
        bcs.append(fem.dirichletbc(zero, dofs, V.sub(axis)))
    for value, end in zip((down, zero), ends, strict=True):
        dofs = fem.locate_dofs_topological(V.sub(2), 2, end)
        bcs.append(fem.dirichletbc(value, dofs, V.sub(2)))

    def update(t: float) -> None:
        down.value = -depth * t

    pair = SCHEMES[scheme].pair(*faces)
    stepper = SCHEMES[scheme].integrator(bodies, [pair], dt=h, bcs=bcs, update=update)

    def judge() -> dict[str, float]:
        (contact,) = stepper.contacts
        force = -4 * comm.allreduce(contact.history.lambda_N.sum())
        a = (1.5 * force * radius * (1 - ratio**2) / modulus) ** (1 / 3)
        r = np.linalg.norm(stepper.x[contact.nodes.nodes, :2], axis=1) / a
        within = r < 0.85
        greatest = 1.5 * force / np.pi / a**2
        errors = contact.pressure[within] / greatest - np.sqrt(1 - r[within] ** 2)
        square, number = comm.allreduce(np.array([errors @ errors, len(errors)]))
        return {"pressure, rms error": float(np.sqrt(square / number))}

    return Scene(stepper, bodies[0], judge, t_end=1.0)
