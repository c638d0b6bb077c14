"""Default springs have the stiffness of the segments that nodes face, not of all segments."""

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.io import checkpoint
from helpers.once import once

E, RHO, LENGTH, WIDTH, CELLS = 2e11, 7.8e3, 1.0, 0.1, 40
WAVE = float(np.sqrt(E / RHO))
STEEL = nts.NeoHookean(E, 0.0, RHO)


def bonded_pad(model: Any) -> None:
    """A rod above an anvil, which shares nodes with a pad below it."""
    occ = model.occ
    rod, anvil, pad = (
        occ.addRectangle(0, z, 0, WIDTH, LENGTH) for z in (1e-6, -LENGTH, -2 * LENGTH)
    )
    below, _ = occ.fragment([(2, anvil)], [(2, pad)])
    occ.synchronize()
    places = sorted(
        [rod, *(surface for _, surface in below)],
        key=lambda surface: -occ.getCenterOfMass(2, surface)[1],
    )
    for name, surface in zip(("rod", "anvil", "rubber"), places, strict=True):
        model.addPhysicalGroup(2, [surface], name=name)
    for _, curve in model.getEntities(1):
        model.mesh.setTransfiniteCurve(curve, CELLS + 1 if occ.getMass(1, curve) > 0.5 else 4)
    for surface in places:
        model.mesh.setTransfiniteSurface(surface)
        model.mesh.setRecombine(2, surface)
    model.mesh.generate(2)


def block_far_away(model: Any) -> None:
    """A rod above an anvil; two other blocks, which nothing touches."""
    for name, corner, size, cells in (
        ("rod", (0, 1e-6), (WIDTH, LENGTH), (5, CELLS)),
        ("small", (3, 0), (WIDTH, WIDTH), (5, 5)),
        ("anvil", (0, -LENGTH), (WIDTH, LENGTH), (4, CELLS)),
        ("rubber", (5, 0), (1, 1), (5, 5)),
    ):
        parts.add_rectangle(model, name, corner=corner, size=size, cells=cells)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("build", [bonded_pad, once(block_far_away)])
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.CentralDifference)])
def test_a_soft_body_of_the_pair_that_is_not_touched_leaves_steel_springs(comm, build, scheme):
    """Two rods of steel collide: until waves return, the force is rho c v A / 2.

    With springs as stiff as the mean of all segments it was up to 4700 times smaller.
    """
    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    rubber = nts.NeoHookean(1e6, 0.0, 1e3)
    bodies = {
        name: nts.Body(V, cells, tag[name], rubber if name == "rubber" else STEEL, name=name)
        for name in ("rod", "small", "anvil", "rubber")
        if name in tag
    }
    part = 0.5 if scheme is nts.CentralDifference else 1.0
    dt = part * LENGTH / CELLS / WAVE
    whole = list(bodies.values())
    stepper = scheme(whole, nts.all_pairs(whole), dt=dt)
    stepper.set_velocity(bodies["rod"], (0, -1))
    forces = []
    for step in stepper.run(until=1.6 * LENGTH / WAVE):
        if step.t > 0.6 * LENGTH / WAVE:
            forces.append(abs(nts.Diagnostics(stepper).contact_force()[1]))
    assert np.mean(forces) == pytest.approx(RHO * WAVE / 2 * WIDTH, rel=2e-3)


def struck(where: Any, farthest: float) -> tuple[float, float]:
    """Largest force on an elastic ball that strikes a graded block, and largest overlap [N, m].

    Args:
        where: Selects the facets that are surfaces of the pair; None for whole boundaries.
        farthest: Largest cells of the block, away from the impact [m].
    """
    radius, depth, modulus, nu, rho = 1.0, 8.0, 1e9, 0.3, 1e3

    def build(model: Any) -> None:
        occ = model.occ
        disc = occ.addDisk(0, radius + 1e-4, 0, radius, radius)
        half, _ = occ.intersect([(2, disc)], [(2, occ.addRectangle(0, 0, 0, 3, 3))])
        block = occ.addRectangle(0, -depth, 0, depth, depth)
        occ.synchronize()
        model.addPhysicalGroup(2, [half[0][1]], name="ball")
        model.addPhysicalGroup(2, [block], name="block")
        size = model.mesh.field.add("MathEval")
        text = f"Min({farthest}, 0.03 + 0.25 * Max(0, Sqrt(x*x + y*y) - 0.15))"
        model.mesh.field.setString(size, "F", text)
        model.mesh.field.setAsBackgroundMesh(size)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_SELF)
    nts.axisymmetric(mesh)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    material = nts.NeoHookean(modulus, nu, rho)
    ball, block = (nts.Body(V, cells, tag[name], material) for name in ("ball", "block"))
    pair = nts.ContactPair(*(nts.boundary_of(body, where=where) for body in (ball, block)))
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -depth))
    bcs = [fem.dirichletbc(np.zeros(2), bottom, V)]
    stepper = nts.EnergyMomentum([ball, block], [pair], dt=7e-4, bcs=bcs)
    stepper.set_velocity(ball, (0, -1))
    diagnostics, forces, gaps = nts.Diagnostics(stepper), [0.0], [0.0]
    for _ in stepper.run(until=0.014):
        forces.append(abs(diagnostics.contact_force()[-1]))
        gaps.append(diagnostics.min_gap())
    return max(forces), -min(gaps)


@pytest.mark.serial
def test_cells_far_from_the_impact_do_not_soften_the_springs():
    """Hertz' force of the impact is 5.99e5 N, and the approach 8.7 mm."""
    force, overlap = struck(None, 1.0)
    near = struck(lambda x: (x[0] < 0.3) & (x[1] < 0.2) & (x[1] > -1e-6), 1.0)
    assert (force, overlap) == pytest.approx(near, rel=1e-6)
    assert force == pytest.approx(5.99e5, rel=0.03)
    assert overlap < 5e-4


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.CentralDifference)])
def test_coarse_soft_pads_do_not_sink_through_a_thin_sheet(comm, scheme):
    """The height of the cells of the pads is 50 times the thickness of the sheet."""
    height, thickness, modulus, pressure = 0.4, 0.004, 1e4, 500.0

    def build(model: Any) -> None:
        for name, bottom, size, cells in (
            ("low", -height, height, (5, 2)),
            ("sheet", 0.0, thickness, (16, 1)),
            ("up", thickness, height, (4, 2)),
        ):
            width = 1.2 if name == "sheet" else 1.0
            corner = (-width / 2, bottom)
            parts.add_rectangle(model, name, corner=corner, size=(width, size), cells=cells)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    damping = 2.0 if scheme is nts.CentralDifference else 20.0
    soft = nts.NeoHookean(modulus, 0.0, 1e3, mass_damping=damping)
    stiff = nts.NeoHookean(100 * modulus, 0.0, 1e3, mass_damping=damping)
    bodies = [
        nts.Body(V, cells, tag[name], stiff if name == "sheet" else soft)
        for name in ("low", "sheet", "up")
    ]
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -height))
    top = nts.Surface(V, facets, tag["up_top"])
    dt = None if scheme is nts.CentralDifference else 0.02
    stepper = scheme(
        bodies,
        nts.all_pairs(bodies),
        dt=dt,
        bcs=[fem.dirichletbc(np.zeros(2), bottom, V)],
        loads=[nts.Pressure(top, lambda t: pressure * min(t, 1.0))],
    )
    diagnostics, until = nts.Diagnostics(stepper), 1.2 if dt is None else 3.0
    *_, last = stepper.run(until=until)
    assert last.reactions[0].force[1] > 0.8 * pressure
    # Springs as soft as the cells of the pads are compressed by 0.5 and 4.5 times the thickness.
    assert -diagnostics.min_gap() < 0.4 * thickness


def block_on_two(model: Any) -> None:
    """A block just above a soft and a stiff one, side by side."""
    for name, corner, width in (
        ("soft", (0, 0), 1),
        ("hard", (1.001, 0), 1),
        ("top", (0, 0.5 + 1e-6), 2.001),
    ):
        parts.add_rectangle(
            model, name, corner=corner, size=(width, 0.5), cells=(4 * round(width), 2)
        )


@pytest.mark.serial
@pytest.mark.parametrize("is_resumed", [False, True])
def test_laws_of_friction_see_the_whole_area_above_soft_segments_in_explicit_steps(
    comm, tmp_path, monkeypatch, is_resumed
):
    """It was multiplied by the fraction of the spring stiffness, here 0.002, as in `Tresca`."""

    class Cohesive(nts.FrictionLaw):
        depends_on_slip = False

        def limit(self, p, slip, dt, nodes):
            areas.append(nodes.area)
            return 10.0 * nodes.area, 0.0, 0.0

    def scene():
        whole = list(bodies.values())
        pair = nts.ContactPair(bottom, top, friction=Cohesive())
        return nts.CentralDifference(whole, [pair], dt=1e-4)

    areas: list[Any] = []
    mesh, cells, _, tag = nts.read_mesh(block_on_two, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    bodies = {
        name: nts.Body(
            V, cells, tag[name], nts.NeoHookean(1e4 if name == "soft" else 1e7, 0.3, 1e3)
        )
        for name in ("soft", "hard", "top")
    }
    bottom = nts.boundary_of(bodies["top"])
    top = nts.boundary_of(bodies["soft"], bodies["hard"], where=lambda x: x[1] > 0.5 - 1e-5)
    stepper = scene()
    stepper.set_velocity(bodies["top"], (0.3, -0.5))
    path = tmp_path / "run.h5"
    for _ in range(6):
        stepper.advance()
    if is_resumed:
        checkpoint.save(path, stepper)
        stepper = scene()
        # As on another number of ranks.
        monkeypatch.setattr(checkpoint, "_partition", lambda _: np.zeros(1, dtype=np.uint8))
        checkpoint.load(path, stepper)
    stepper.advance()
    assert areas[-1].sum() == pytest.approx(2.001)


@pytest.mark.serial
def test_friction_on_a_soft_plate_does_not_depend_on_a_stiff_body_far_away(comm):
    """A stiff block strikes a soft plate obliquely; the pair may also have a stiff body far away.

    With tangential springs as stiff as that body, iterations were 171 instead of 104, and struts
    between a balloon and a tube had no solution in steps sixteen times as short.
    """

    def build(model: Any) -> None:
        for name, corner, size, cells in (
            ("block", (0.3, 1e-3), (0.4, 0.2), (8, 4)),
            ("plate", (0, -0.5), (1, 0.5), (10, 5)),
            ("other", (3, -0.5), (0.5, 0.5), (5, 5)),
        ):
            parts.add_rectangle(model, name, corner=corner, size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    moduli = {"block": 1e8, "plate": 1e5, "other": 1e8}
    block, plate, other = (
        nts.Body(V, cells, tag[name], nts.NeoHookean(E, 0.3, 1e3)) for name, E in moduli.items()
    )
    held = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -0.5))
    ends, iterations = [], []
    for segments in ([plate], [plate, other]):
        pair = nts.ContactPair(nts.boundary_of(block), nts.boundary_of(*segments), friction=0.3)
        bcs = [fem.dirichletbc(np.zeros(2), held, V)]
        stepper = nts.EnergyMomentum([block, plate, other], [pair], dt=0.002, bcs=bcs)
        stepper.set_velocity(block, (0.5, -1.0))
        iterations.append(sum(step.newton_iterations for step in stepper.run(until=0.06)))
        ends.append(stepper.u.x.array.copy())
        assert np.abs(pair.history.traction).max() > 0
    assert iterations[1] < 1.1 * iterations[0]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9 * np.abs(ends[0]).max())
