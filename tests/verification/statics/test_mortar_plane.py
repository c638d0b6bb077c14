"""Surface-to-surface contact in two dimensions: patch tests, and Hertz's line contact."""

from dataclasses import dataclass
from functools import cache
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from dolfinx_nts.compat import geometry_nodes
from helpers.models.plane import turning

pytestmark = pytest.mark.serial

E, NU = 1.0, 0.3


def pressed_blocks(cells, F, *, cell, slope=0.0, angle=0.0, friction=None, degree=1):
    """Deform two blocks of 1 x 0.5 m as one: stepper, errors of displacement and stress.

    Bottom and top have the displacement of the deformation gradient, the sides its tractions.
    """

    def build(model: Any) -> None:
        for name, y, n in zip(("lower", "upper"), (0.0, 0.5), cells, strict=True):
            box = {"corner": (0, y), "size": (1, 0.5), "cells": (n, n // 2)}
            meshing.add_rectangle(model, name, cell=cell, **box)

    mesh, tags, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    X, Q = mesh.geometry.x, turning(angle)
    X[:, 1] += slope * (X[:, 0] - 0.5) * (1 - np.abs(2 * X[:, 1] - 1))
    X[:, :2] = X[:, :2] @ Q.T
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    material = nts.SaintVenantKirchhoff(E, NU, 1.0)
    bodies = [nts.Body(V, tags, tag[name], material) for name in ("lower", "upper")]
    surfaces = {
        f"{body}_{side}": nts.Surface(V, facets, tag[f"{body}_{side}"])
        for body in ("lower", "upper")
        for side in ("left", "right", "bottom", "top")
    }
    strain = (F.T @ F - np.eye(2)) / 2
    lmbda, mu = E * NU / (1 + NU) / (1 - 2 * NU), E / 2 / (1 + NU)
    stress = Q @ F @ (lmbda * np.trace(strain) * np.eye(2) + 2 * mu * strain) @ Q.T
    F = Q @ F @ Q.T
    loads = [
        nts.Traction(surfaces[f"{body}_{side}"], stress @ Q @ [out, 0.0])
        for body in ("lower", "upper")
        for side, out in (("left", -1.0), ("right", 1.0))
    ]
    whole = fem.Function(V)
    whole.interpolate(lambda x: (F - np.eye(2)) @ x[:2])
    sides = ("lower_bottom", "upper_top")
    ends = [fem.locate_dofs_topological(V, 1, facets.find(tag[side])) for side in sides]
    pair = nts.ContactPair(
        surfaces["upper_bottom"],
        surfaces["lower_top"],
        friction=friction,
        method="mortar",
        enforcement=nts.LagrangeMultiplier(),
    )
    bcs = [fem.dirichletbc(whole, np.concatenate(ends))]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, loads=loads)
    stepper.advance()
    moved = np.abs(stepper.u.x.array - whole.x.array).max()
    cauchy = nts.Fields(stepper).cauchy_stress().x.array.reshape(-1, 3, 3)[:, :2, :2]
    expected = stress @ F.T / np.linalg.det(F)
    return stepper, moved, np.abs(cauchy - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
@pytest.mark.parametrize("cells", [(4, 6), (6, 4)])
@pytest.mark.parametrize(("slope", "angle"), [(0.0, 0.0), (0.3, 0.7)], ids=["flat", "slope"])
def test_patch_test_is_passed(cell, cells, slope, angle, degree, table_row):
    """All sides are pressed alike, so that nothing slides down a slope."""
    stepper, moved, error = pressed_blocks(
        cells, 0.99 * np.eye(2), cell=cell, slope=slope, angle=angle, degree=degree
    )
    pressure = stepper.contacts[0].pressure
    table_row(
        f"patch test, {cell}, {cells[0]}:{cells[1]} cells"
        + (", slope" if slope else "")
        + degree // 2 * ", degree 2",
        "uniform stress and pressure",
        f"error {error:.0e}, spread {np.ptp(pressure) / pressure.mean():.0e}",
    )
    assert moved <= 1e-11
    assert error <= 1e-9
    assert np.ptp(pressure) <= 1e-9 * pressure.mean()


@pytest.mark.parametrize("cells", [(4, 6), (6, 4)])
def test_blocks_that_stick_are_sheared_as_one(cells):
    F = np.array([[1.0, 0.003], [0.0, 0.99]])
    stepper, moved, _ = pressed_blocks(cells, F, cell="quadrilateral", friction=nts.Coulomb(5.0))
    history = stepper.contacts[0].history
    assert history.active.all() and not history.sliding.any()
    assert moved <= 1e-10


RADIUS, TRAVEL = 4.0, 0.02


@dataclass(frozen=True)
class Pressure:
    """Nodal pressure within 0.85 of the contact radius, relative to the maximum.

    Attributes:
        error: Root mean square of the difference from theory.
        roughness: The same from a polynomial of degree 3 in x^2 that fits.
    """

    error: float
    roughness: float


@cache
def pressed_parabola(method: str, swapped: bool, degree: int = 1) -> Pressure:
    """Press half a parabola on half a block down by its top; cells grow from the contact."""

    def build(model: Any) -> None:
        for name, y, n in (("lower", -1, 12), ("upper", 0, 16)):
            box = {"corner": (0, y), "size": (1, 1), "cells": (n, n)}
            meshing.add_rectangle(model, name, **box)

    mesh, tags, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    X = mesh.geometry.x
    # Before they move: which nodes are above.
    above = np.isin(np.arange(len(X)), np.unique(geometry_nodes(mesh)[tags.find(tag["upper"])]))
    X[:] = np.sign(X) * (0.8 * np.abs(X) ** 2.2 + 0.2 * np.abs(X))
    X[above, 1] += (1 - X[above, 1]) * X[above, 0] ** 2 / 2 / RADIUS
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    material = nts.SaintVenantKirchhoff(E, NU, 1.0, one_point=())
    bodies = [nts.Body(V, tags, tag[name], material) for name in ("lower", "upper")]
    sides = [nts.Surface(V, facets, tag[name]) for name in ("upper_bottom", "lower_top")]
    pair = nts.ContactPair(
        *(sides[::-1] if swapped else sides), method=method, enforcement=nts.LagrangeMultiplier()
    )
    down, zero = fem.Constant(mesh, 0.0), np.float64(0.0)

    def held(axis: int, value: Any, *names: str) -> fem.DirichletBC:
        found = np.sort(np.concatenate([facets.find(tag[name]) for name in names]))
        return fem.dirichletbc(
            value, fem.locate_dofs_topological(V.sub(axis), 1, found), V.sub(axis)
        )

    def update(t: float) -> None:
        down.value = -TRAVEL * t

    bcs = [
        held(0, zero, "lower_left", "upper_left", "lower_bottom", "upper_top"),
        held(1, zero, "lower_bottom"),
        held(1, down, "upper_top"),
    ]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1 / 3, bcs=bcs, update=update)
    for report in stepper.run(1.0):
        assert report.newton_iterations <= 12
    (contact,) = stepper.contacts
    P = -2 * contact.history.lambda_N.sum()
    stiffness = E / (1 - NU**2) / 2
    a = np.sqrt(4 * P * RADIUS / (np.pi * stiffness))
    greatest = 2 * P / (np.pi * a)
    s = (stepper.x[contact.nodes.nodes, 0] / a) ** 2
    within = s < 0.85**2
    p, s = contact.pressure[within] / greatest, s[within]
    fit = np.polyval(np.polyfit(s, p, 3), s)
    return Pressure(
        error=float(np.sqrt(np.mean((p - np.sqrt(1 - s)) ** 2))),
        roughness=float(np.sqrt(np.mean((p - fit) ** 2))),
    )


# Largest error with the nodes on the finer side and on the coarser one, by degree.
LARGEST = {(1, False): 0.011, (1, True): 0.018, (2, False): 0.019, (2, True): 0.039}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("swapped", [False, True])
def test_nodal_pressure_of_a_line_contact_agrees_with_hertz(swapped, degree, table_row):
    """A third of the error with nodes and segments at most, and a tenth of the roughness."""
    mortar, nodes = (pressed_parabola(m, swapped, degree) for m in ("mortar", "node-to-segment"))
    table_row(
        f"line contact, {'coarser' if swapped else 'finer'} side as nodes, 7 to 9 cells in a"
        + degree // 2 * ", degree 2",
        "Hertz within 0.85 a, root mean square",
        f"mortar {100 * mortar.error:.1f} %, of which roughness {100 * mortar.roughness:.1f} %; "
        f"by nodes and segments {100 * nodes.error:.1f} and {100 * nodes.roughness:.1f} %",
    )
    assert mortar.error <= LARGEST[degree, swapped]
    assert mortar.roughness <= 0.005
    assert nodes.error >= 3 * mortar.error
    assert nodes.roughness >= 10 * mortar.roughness
