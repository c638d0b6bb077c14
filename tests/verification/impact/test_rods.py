"""Rods of lengths 1 and 2 that collide against one-dimensional theory.

Steps are explicit; the default of implicit ones is compared, too.

St. Venant's rods: the shorter one strikes with speed v. The contact force is rho c v/2 per area
for 2 L/c; then the shorter rod is at rest, and the longer one has the mean speed v/2.
"""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.meshing.parts import add_box

pytestmark = pytest.mark.serial

SPEED = 1e-3  # of the shorter rod [m/s]; L = c = rho = 1 in SI units
# Largest error of the energy at any time, relative to it.
ENERGY = 2e-3


def rods(
    n,
    dt=None,
    *,
    section=1,
    cell="hexahedron",
    degree=1,
    nu=0.0,
    law=None,
    scheme=None,
    wide=1.0,
):
    """Collide rods with ``n`` cells along the shorter one.

    The step ``dt`` is in times of a wave through a cell. A ``scheme`` is implicit and has its
    default law and method of contact; without one, steps are explicit. Supports prevent strains
    across the rods. Cells are ``wide`` times as wide as high.

    Returns:
        Times [L/c], contact force [rho c v/2], mean speed of the longer rod at the end [v], and
        largest change of the energy, relative to it.
    """
    h = 1 / n
    side = section * h * wide

    def build(model):
        for name, low, length in (("short", 0.0, 1), ("long", -2.0, 2)):
            cells = section, section, length * n
            add_box(
                model, name, corner=(0, 0, low), size=(side, side, length), cells=cells, cell=cell
            )

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    modulus = (1 - nu) / ((1 + nu) * (1 - 2 * nu))  # of a wave, relative to E
    material = nts.SaintVenantKirchhoff(1 / modulus, nu, 1.0)
    short, long = (nts.Body(V, cells, tag[name], material) for name in ("short", "long"))
    bottom, top = (nts.Surface(V, facets, tag[name]) for name in ("short_bottom", "long_top"))
    bcs = []
    for axis in range(2):
        rows, collapsed = V.sub(axis), V.sub(axis).collapse()[0]
        everywhere = fem.locate_dofs_geometrical((rows, collapsed), lambda x: x[0] > -1)
        bcs.append(fem.dirichletbc(fem.Function(collapsed), everywhere, rows))
    step = None if dt is None else dt * h
    pair = nts.ContactPair(bottom, top)
    if scheme is None:
        scheme, pair = nts.CentralDifference, nts.ContactPair(bottom, top, law or nts.Penalty())
    stepper = scheme([short, long], [pair], dt=step, bcs=bcs)
    stepper.set_velocity(short, (0.0, 0.0, -SPEED))
    diagnostics = nts.Diagnostics(stepper)
    energy, t, force, change = diagnostics.balance().total_energy, [], [], 0.0
    while stepper.t < 2.4:
        stepper.advance()
        balance = diagnostics.balance()
        t.append(stepper.t)
        force.append(np.linalg.norm(balance.contact_force) / (SPEED / 2 * side**2))
        change = max(change, abs(balance.total_energy / energy - 1))
    speed = -diagnostics.body_velocity(long)[2] / SPEED
    return np.array(t), np.array(force), speed, change


def noise(t, force, first=0.1):
    """Root mean square of the error of the force on both halves of its plateau."""
    half = t - np.floor(t)
    steady = (t < 2) & (half > first) & (half < 0.9)
    return np.sqrt(np.mean((force[steady] - 1) ** 2))


@pytest.mark.parametrize("dt", [None, 0.5, 0.25], ids=["default", "half", "quarter"])
def test_contact_force_of_default_springs_is_steady_at_any_step(dt, table_row):
    results = [rods(n, dt) for n in (20, 40, 80)]
    values = [noise(*result[:2]) for result in results]
    # The front extends over about four cells, a fifth of half the plateau with 20 cells.
    assert values[0] < 0.08
    assert noise(*results[0][:2], first=0.25) < 0.05
    assert max(values[1:]) < 0.05
    assert max(result[3] for result in results) < ENERGY
    # The front needs one cell on each side to build up.
    for n, (_, _, speed, _) in zip((20, 40, 80), results, strict=True):
        assert abs(speed - 0.5) < 0.5 / n
    if dt is not None:
        name = {0.5: "half", 0.25: "a quarter of"}[dt]
        table_row(
            f"rods 1:2, `CentralDifference`, {name} a cell a step, 20, 40 and 80 cells",
            "one-dimensional theory: constant force for 2 L/c",
            ", ".join(f"{100 * value:.1f}" for value in values) + " %",
        )


@pytest.mark.parametrize(
    "rod",
    [
        {"n": 40, "section": 3},
        {"n": 40, "nu": 0.4},
        {"n": 40, "section": 2, "cell": "tetrahedron"},
        {"n": 20, "degree": 2},
        {"n": 20, "cell": "tetrahedron", "degree": 2},
    ],
    ids=["3 by 3", "nu 0.4", "tetrahedra", "degree 2", "tetrahedra 2"],
)
def test_contact_force_is_steady_on_other_meshes(rod):
    t, force, _, change = rods(**rod)
    assert noise(t, force, first=0.2) < 0.05
    assert change < ENERGY


def test_stiff_springs_make_the_force_scatter():
    """The light nodes on them vibrate above the frequencies of the cells."""
    stiffness = 1.5 * (1 / 20)  # three times as stiff as two layers in series, times area
    t, force, _, _ = rods(20, 0.5, law=nts.Penalty(stiffness / 4))
    assert noise(t, force) > 0.3


def test_contact_force_of_default_implicit_steps_is_steady_and_rods_separate_as_in_theory(
    table_row,
):
    results = [rods(n, 0.5, scheme=nts.EnergyMomentum) for n in (10, 20, 40)]
    values = [noise(t, force) for t, force, *_ in results]
    speeds = [speed for *_, speed, _ in results]
    table_row(
        "rods 1:2 by the default of implicit steps, 10, 20, 40 cells, half a cell a step",
        "contact force on its plateau (root mean square), speed of the longer rod (1/2)",
        ", ".join(f"{100 * value:.1f} %" for value in values)
        + "; "
        + ", ".join(f"{speed:.3f}" for speed in speeds),
    )
    assert max(values) < 0.08
    assert max(values[1:]) < 0.05
    for n, speed in zip((10, 20, 40), speeds, strict=True):
        assert abs(speed - 0.5) < 0.25 / n
    assert max(change for *_, change in results) < 1e-10


@pytest.mark.parametrize("wide", [0.5, 4.0], ids=["tall", "flat"])
def test_default_force_does_not_depend_on_the_shape_of_cells(wide):
    cubes, others = (rods(20, 0.5, scheme=nts.EnergyMomentum, wide=w)[1] for w in (1.0, wide))
    np.testing.assert_allclose(others, cubes, atol=1e-3)
