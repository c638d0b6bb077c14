"""Closed forms in two dimensions: a bar, a cylinder without and with friction, patch test, block.

With 1/E* = (1 - nu^2)/E, see K. L. Johnson, Contact Mechanics, chapters 4 and 7; forces are those
of one metre of thickness. The same cases in space are in `test_bars`, `test_hertz`, `test_patch`
and `test_friction_closed_forms`, and the margins here are theirs, or half of them.
"""

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from helpers.models import shapes

pytestmark = pytest.mark.serial

GROUND = nts.RigidPlane((0, 0), (0, 1))


def support(
    data: meshing.MeshData, V: fem.FunctionSpace, axis: int, value: Any, *names: str
) -> fem.DirichletBC:
    """Give a component of the displacement on curves."""
    held = np.sort(np.concatenate([data.facets.find(data.tag[name]) for name in names]))
    dofs = fem.locate_dofs_topological(V.sub(axis), 1, held)
    return fem.dirichletbc(value if value else np.float64(0.0), dofs, V.sub(axis))


def rectangles(degree: int = 1, **boxes: Any) -> tuple[meshing.MeshData, fem.FunctionSpace]:
    """Mesh and space of rectangles, corner, size and cells by name."""

    def build(model: Any) -> None:
        for name, (corner, size, cells) in boxes.items():
            meshing.add_rectangle(model, name, corner=corner, size=size, cells=cells)

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    return data, fem.functionspace(data.mesh, ("Lagrange", degree, (2,)))


# --- a bar on a wall ---------------------------------------------------


def test_bar_strikes_a_wall_as_in_wave_theory(table_row):
    """Cirak and West (2005): stress rho c v for 2 L/c, then all speed is back."""
    L, width, v, n = 10.0, 2.0, 0.1, 100
    data, V = rectangles(bar=((0, 0), (L, width), (n, 1)))
    bar = nts.Body(V, data.cells, data.tag["bar"], shapes.linear_in_stretch(1.0, 0.0, 1.0))
    end = nts.Surface(V, data.facets, data.tag["bar_left"])
    sides = support(data, V, 1, 0, "bar_bottom", "bar_top")
    pair = nts.ContactPair(
        end,
        nts.RigidPlane((0, 0), (1, 0)),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    dt = L / n
    stepper = nts.EnergyMomentum([bar], [pair], dt=dt, bcs=[sides])
    stepper.set_velocity(bar, (-v, 0))
    diagnostics = nts.Diagnostics(stepper)
    energies, forces = [diagnostics.balance().total_energy], []
    for _ in stepper.run(3 * L):
        balance = diagnostics.balance()
        energies.append(balance.total_energy)
        forces.append(balance.contact_force[0])
    duration = dt * (np.flatnonzero(forces)[-1] + 1)
    time, force = duration / (2 * L), dt * np.sum(forces) / duration / (v * width)
    rebound = diagnostics.body_velocity(bar)[0] / v
    table_row(
        "plane strain: bar on a wall, 100 elements",
        "wave theory: stress rho c v, contact for 2 L/c, all speed back",
        f"mean force {100 * (force - 1):+.1f} %, duration {100 * (time - 1):+.1f} %, "
        f"rebound {rebound:.3f}",
    )
    assert time == pytest.approx(1, abs=0.01)
    assert force == pytest.approx(1, abs=0.02)
    assert rebound == pytest.approx(1, abs=0.01)
    assert np.ptp(energies) < 1e-10 * energies[0]


# --- a cylinder on a plane ---------------------------------------------

E, R, A = 1.0, 1.0, 0.01  # A is the contact radius at the given load


@dataclass(frozen=True)
class Contact:
    """Half a cylinder after it was pressed and pushed aside; points from the middle of contact."""

    x: np.ndarray
    p: np.ndarray
    t: np.ndarray
    pressure: np.ndarray

    @property
    def radius(self) -> float:
        """Contact radius: sum p x^2 = P a^2/4 with the nodal forces p of Hertz's pressure."""
        return float(np.sqrt(4 * self.p @ self.x**2 / self.p.sum()))


def pressed(fine: int, nu: float, mu: float = 0.0, part: float = 0.0) -> Contact:
    """Press half a cylinder by its middle plane, then push it aside.

    Args:
        fine: Cells in the contact radius.
        nu: Poisson's ratio.
        mu: Coefficient of friction.
        part: Travel aside, relative to mu times the travel down.
    """

    def build(model: Any) -> None:
        occ = model.occ
        disc, below = occ.addDisk(0, R, 0, R, R), occ.addRectangle(-R, 0, 0, 2 * R, R)
        # The seam of gmsh's disc shall not be on the half.
        occ.rotate([(2, disc)], 0, R, 0, 0, 0, 1, np.pi / 2)
        (half,), _ = occ.intersect([(2, disc)], [(2, below)])
        occ.synchronize()
        model.addPhysicalGroup(2, [half[1]], name="half")
        curves = [curve for _, curve in occ.getEntities(1)]
        heights = [occ.getCenterOfMass(1, curve)[1] for curve in curves]
        model.addPhysicalGroup(1, [curves[int(np.argmax(heights))]], name="top")
        size = f"Min({0.1 * R}, {A / fine} + 0.2 * Max(0, Sqrt(x*x + y*y) - {1.5 * A}))"
        field = model.mesh.field.add("MathEval")
        model.mesh.field.setString(field, "F", size)
        model.mesh.field.setAsBackgroundMesh(field)
        model.mesh.generate(2)

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    half = nts.Body(V, data.cells, data.tag["half"], nts.SaintVenantKirchhoff(E, nu, 1.0))
    surface = nts.boundary_of(half, where=lambda x: x[1] < 0.5 * R)
    friction = nts.Coulomb(mu) if mu else None
    pair = nts.ContactPair(
        surface,
        GROUND,
        friction=friction,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    down, aside = (fem.Constant(data.mesh, 0.0) for _ in range(2))
    bcs = [support(data, V, 0, aside, "top"), support(data, V, 1, down, "top")]
    depth = A**2 / (4 * R) * (2 * np.log(4 * R / A) - 1)

    def update(t: float) -> None:
        down.value, aside.value = -depth * min(t, 1.0), part * mu * depth * max(t - 1.0, 0.0)

    stepper = nts.QuasiStatic([half], [pair], dt=0.25, bcs=bcs, update=update)
    for _ in stepper.run(2.0 if part else 1.0):
        pass
    p, x = -pair.history.lambda_N, stepper.x[surface.nodes, 0]
    return Contact(x - p @ x / p.sum(), p, np.abs(pair.history.force[:, 0]), pair.pressure)


def test_pressed_cylinder_converges_to_hertz(table_row):
    """Radius sqrt(4 P R/(pi E*)), greatest pressure sqrt(P E*/(pi R)) of a line contact."""
    E_star, errors = E / (1 - 0.3**2), []
    for cells in (4, 8):
        contact = pressed(cells, 0.3)
        P = contact.p.sum()
        # Sum p times pressure is 8/(3 pi) P p0.
        greatest = 3 * np.pi / 8 * (contact.p @ contact.pressure) / P
        radius = contact.radius / np.sqrt(4 * P * R / (np.pi * E_star))
        errors.append([radius - 1, greatest / np.sqrt(P * E_star / (np.pi * R)) - 1])
    coarse, fine = 100 * np.array(errors)
    table_row(
        "plane strain: cylinder pressed onto a plane, 4 and 8 cells in a",
        "Hertz' line contact: a, greatest pressure",
        f"a {coarse[0]:+.1f} and {fine[0]:+.1f} %, pressure {coarse[1]:+.1f} and {fine[1]:+.1f} %",
    )
    assert np.abs(fine).max() <= 1.0
    assert (np.abs(fine) < 0.6 * np.abs(coarse)).all()


def test_stick_zone_of_a_cylinder_pushed_aside_agrees_with_cattaneo_and_mindlin(table_row):
    """Half width c/a = sqrt(1 - Q/(mu P)); what the traction lacks to mu p is Hertz's there."""
    mu, errors = 0.5, []
    for fine in (4, 8):
        contact = pressed(fine, 0.45, mu, 0.8)
        lack = mu * contact.p - contact.t
        stick = np.sqrt(4 * lack @ contact.x**2 / lack.sum()) / contact.radius
        load = contact.t.sum() / (mu * contact.p.sum())
        assert load == pytest.approx(0.5, abs=0.05)
        errors.append(stick / np.sqrt(1 - load) - 1)
    table_row(
        "plane strain: cylinder pushed aside, 4 and 8 cells in a",
        "Cattaneo and Mindlin: half width of the stick zone",
        f"{100 * errors[0]:+.1f} and {100 * errors[1]:+.1f} %",
    )
    assert abs(errors[1]) <= 0.03
    assert abs(errors[1]) < 0.6 * abs(errors[0])


# --- the patch test ----------------------------------------------------


@pytest.mark.parametrize(
    ("degree", "lower", "upper", "expected"),
    [
        *((1, 4, 4, 1e-3), (1, 4, 6, 0.058), (1, 8, 12, 0.060), (1, 6, 4, 0.207), (1, 12, 8, 0.2)),
        *((2, 4, 4, 1e-3), (2, 4, 6, 0.636)),
    ],
)
def test_error_of_the_patch_test_agrees_with_the_limitations(
    degree, lower, upper, expected, table_row
):
    """Matching meshes pass but for the strain of 1e-4; the upper side has the nodes."""
    travel, nu = 1e-4, 0.3
    data, V = rectangles(
        degree,
        lower=((0, 0), (1, 0.5), (lower, lower // 2)),
        upper=((0, 0.5), (1, 0.5), (upper, upper // 2)),
    )
    material = nts.SaintVenantKirchhoff(E=1.0, nu=nu, rho=1.0)
    bodies = [nts.Body(V, data.cells, data.tag[name], material) for name in ("lower", "upper")]
    sides = ("upper_bottom", "lower_top")
    pair = nts.ContactPair(
        *(nts.Surface(V, data.facets, data.tag[side]) for side in sides),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    bcs = [
        support(data, V, 0, 0, "lower_left", "upper_left"),
        support(data, V, 1, 0, "lower_bottom"),
        support(data, V, 1, np.float64(-travel), "upper_top"),
    ]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs)
    stepper.advance()
    stress = nts.Fields(stepper).cauchy_stress().x.array.reshape(-1, 3, 3)[:, 1, 1]
    error = np.abs(stress / (-travel / (1 - nu**2)) - 1).max()
    if lower == upper:
        assert error <= expected
        return
    table_row(
        f"plane strain: patch test, degree {degree}, {lower}:{upper} cells, nodes on the latter",
        "uniform stress, which one-pass node-to-segment contact fails",
        f"largest error {100 * error:.0f} %",
    )
    assert error == pytest.approx(expected, rel=0.05)


# --- the block ---------------------------------------------------------

MU, GRAVITY, RHO, STEP = 0.3, 10.0, 1e3, 0.01


def block(mu: float, gravity: Any) -> tuple[nts.Body, nts.EnergyMomentum]:
    """Flat block, 1 m x 0.25 m, on the ground."""
    data, V = rectangles(block=((0, 0), (1, 0.25), (4, 2)))
    material = nts.SaintVenantKirchhoff(E=1e7, nu=0.3, rho=RHO)
    body = nts.Body(V, data.cells, data.tag["block"], material)
    bottom = nts.Surface(V, data.facets, data.tag["block_bottom"])
    pair = nts.ContactPair(
        bottom,
        GROUND,
        friction=nts.Coulomb(mu),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    load = nts.Gravity([body], gravity)
    return body, nts.EnergyMomentum([body], [pair], dt=STEP, loads=[load])


def test_block_slides_the_distance_of_a_rigid_one(table_row):
    """Distance v^2/(2 mu g); friction and gravity explain the energy."""
    v = 2.0
    body, stepper = block(MU, (0.0, -GRAVITY))
    stepper.set_velocity(body, (v, 0.0))
    diagnostics = nts.Diagnostics(stepper)
    start, energy = diagnostics.centre_of_mass(body)[0], diagnostics.balance().total_energy
    given = 0.0
    for step in stepper.run(1.5 * v / (MU * GRAVITY)):
        given += sum(step.contact_work) + step.load_work
        error = diagnostics.balance().total_energy - energy - given
        assert abs(error) <= 1e-9 * energy
    distance = diagnostics.centre_of_mass(body)[0] - start
    ratio = distance / (v**2 / (2 * MU * GRAVITY))
    table_row(
        "plane strain: block sliding to rest",
        "distance v^2/(2 mu g)",
        f"{100 * (ratio - 1):+.2f} %",
    )
    assert ratio == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(("part", "pace"), [(0.99, 1.0), (1.01, 0.0)])
def test_block_slides_on_a_slope_that_is_steep_enough_only(part, pace):
    """Acceleration g (sin - mu cos) for mu 1 % below the slope, none for 1 % above."""
    slope = np.arctan(MU)
    down = GRAVITY * np.array([np.sin(slope), -np.cos(slope)])

    def growing(t: float) -> np.ndarray:
        s = min(t / 0.3, 1.0)  # so that the block hardly vibrates
        return s * s * (3 - 2 * s) * down

    body, stepper = block(part * MU, growing)
    diagnostics = nts.Diagnostics(stepper)
    steps = [(step.t, diagnostics.body_velocity(body)[0]) for step in stepper.run(1.0)]
    t, speed = np.array(steps[round(0.4 / STEP) :]).T
    acceleration = np.polyfit(t, speed, 1)[0]
    assert acceleration / (0.01 * MU * GRAVITY * np.cos(slope)) == pytest.approx(pace, abs=2e-3)
