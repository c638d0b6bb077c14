"""Nodal pressure below a paraboloid on a block, against Hertz.

A quarter of the scene: hexahedra, graded towards the contact, that do not match. Half-space
theory is that of the force (Johnson, Contact Mechanics, chapter 4). The contact radius is so
much smaller than that of the paraboloid that strains are below 1 %, as theory has it: with ten
times the strain the pressure there is 2 % less. Blocks that it is a quarter of have 1 % more
pressure at its centre than half-spaces, those that it is an eighth of do not.
"""

from dataclasses import dataclass
from functools import cache

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models import box_meshes

pytestmark = pytest.mark.serial

E, NU, RADIUS = 1.0, 0.3, 40.0


@dataclass(frozen=True)
class Pressure:
    """Nodal pressure relative to the greatest one of theory, and the contact radius.

    Attributes:
        error: Root mean square of the difference from theory, within 0.85 of the contact radius.
        roughness: The same from a polynomial of degree 3 in r^2 that fits.
        radius: Contact radius by the moments of the nodal forces, sum f r^2 = 2/5 F a^2,
            relative to theory.
        greatest: Pressure of the node at the centre.
    """

    error: float
    roughness: float
    radius: float
    greatest: float


@dataclass(frozen=True)
class Scale:
    """Size of the contact in the blocks of the size 1.

    Attributes:
        travel: Displacement of the top.
        least: Size of the cells at the centre, relative to equal ones.
        power: Power of the coordinate by which they grow.
    """

    travel: float
    least: float
    power: float


QUARTER, EIGHTH = Scale(0.002, 0.2, 2.2), Scale(0.0005, 0.1, 2.5)


def blocks(upper: int, lower: int, scale: Scale) -> box_meshes.Input:
    """Return both blocks, whose cells grow from the origin."""
    shapes = [(n, n, max(4, n // 2)) for n in (lower, upper)]
    data = box_meshes.boxes(shapes, [(1, 1, 1), (1, 1, 1)])
    X = (1 - scale.least) * data.X**scale.power + scale.least * data.X
    below = np.unique(data.cells[data.body == 0])
    X[below, 2] *= -1
    above = np.unique(data.cells[data.body == 1])
    X[above, 2] += (1 - X[above, 2]) * (X[above, :2] ** 2).sum(axis=1) / 2 / RADIUS
    data.X[:] = X
    return data


@cache
def pressed(method: str, upper: int, lower: int, swapped: bool, scale: Scale = QUARTER) -> Pressure:
    """Press the upper block down by its top in three steps."""
    data = blocks(upper, lower, scale)
    mesh, cells, facets, tag = box_meshes.distribute(MPI.COMM_WORLD, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(E, NU, 1.0, one_point=())
    bodies = [nts.Body(V, cells, tag[f"body {number}"], material) for number in (0, 1)]
    # Nodes at z = 0.
    sides = [nts.Surface(V, facets, tag[f"bottom {number}"]) for number in (1, 0)]
    pair = nts.ContactPair(
        *(sides[::-1] if swapped else sides), method=method, enforcement=nts.LagrangeMultiplier()
    )
    down = fem.Constant(mesh, 0.0)
    held = {number: facets.find(tag[f"top {number}"]) for number in (0, 1)}
    zero, bcs = np.float64(0.0), []
    for axis in (0, 1):
        of_axis = V.sub(axis)

        def on_symmetry(x, axis=axis):
            return np.isclose(x[axis], 0.0)

        plane = fem.locate_dofs_geometrical((of_axis, of_axis.collapse()[0]), on_symmetry)[0]
        ends = [fem.locate_dofs_topological(of_axis, 2, part) for part in held.values()]
        bcs.append(fem.dirichletbc(zero, np.unique(np.concatenate([plane, *ends])), of_axis))
    for value, part in ((zero, held[0]), (down, held[1])):
        bcs.append(fem.dirichletbc(value, fem.locate_dofs_topological(V.sub(2), 2, part), V.sub(2)))

    def update(t: float) -> None:
        down.value = -scale.travel * t

    stepper = nts.QuasiStatic(bodies, [pair], dt=1 / 3, bcs=bcs, update=update)
    for report in stepper.run(1.0):
        assert report.newton_iterations <= 12
    (contact,) = stepper.contacts
    f = -contact.history.lambda_N
    force = 4 * f.sum()
    stiffness = E / (1 - NU**2) / 2
    a = (3 * force * RADIUS / 4 / stiffness) ** (1 / 3)
    greatest = 1.5 * force / np.pi / a**2
    x = stepper.x[contact.nodes.nodes]
    s = (x[:, :2] ** 2).sum(axis=1) / a**2
    p = contact.pressure / greatest
    radius, centre = np.sqrt(2.5 * (f @ s) / f.sum()), p[np.argmin(s)]
    within = s < 0.85**2
    p, s = p[within], s[within]
    fit = np.polyval(np.polyfit(s, p, 3), s)
    return Pressure(
        error=float(np.sqrt(np.mean((p - np.sqrt(1 - s)) ** 2))),
        roughness=float(np.sqrt(np.mean((p - fit) ** 2))),
        radius=float(radius),
        greatest=float(centre),
    )


# Largest error with the nodes on the finer side, and on the coarser one.
FINER, COARSER = 0.012, 0.019


@pytest.mark.parametrize("swapped", [False, True])
def test_nodal_pressure_agrees_with_hertz(swapped, table_row):
    """A sixth of the error, and a tenth of the roughness, of node-to-segment contact."""
    mortar, nodes = (pressed(m, 16, 12, swapped) for m in ("mortar", "node-to-segment"))
    table_row(
        f"{'coarser' if swapped else 'finer'} side as nodes, 6 to 8 cells in a",
        "Hertz within 0.85 a, root mean square",
        f"mortar {100 * mortar.error:.1f} %, of which roughness {100 * mortar.roughness:.1f} %; "
        f"by nodes and segments {100 * nodes.error:.1f} and {100 * nodes.roughness:.1f} %",
    )
    assert mortar.error <= (COARSER if swapped else FINER)
    assert mortar.roughness <= 0.007
    assert nodes.error >= 6 * mortar.error
    assert nodes.roughness >= 10 * mortar.roughness


# The finer side has eight cells in the contact radius in the first, the coarser one seven in the
# second.
@pytest.mark.parametrize(("swapped", "cells"), [(False, (20, 16)), (True, (24, 18))])
def test_contact_radius_and_greatest_pressure_agree_with_hertz(swapped, cells, table_row):
    """Within 1 %, whichever side has the nodes."""
    result = pressed("mortar", *cells, swapped, EIGHTH)
    table_row(
        f"{'coarser side as nodes, 7' if swapped else 'finer side as nodes, 8'} cells in a",
        "Hertz: a, p₀ at the centre",
        f"a {100 * (result.radius - 1):+.2f} %, p₀ {100 * (result.greatest - 1):+.2f} %",
    )
    assert abs(result.radius - 1) <= 0.01
    assert abs(result.greatest - 1) <= 0.01
