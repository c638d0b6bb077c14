"""Springs at edges of a body act with the area of the facets that face the other surface."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

E, RHO, SPEED, GAP = 1e6, 1e3, 0.3, 1e-3  # Pa, kg/m^3, m/s, m


@pytest.mark.parametrize(
    ("scheme", "dt", "dim", "is_turned"),
    [
        once(nts.EnergyMomentum, 1e-3, 2, False),
        (nts.EnergyMomentum, 1e-3, 3, False),
        once(nts.EnergyMomentum, 1e-3, 2, True),
        (nts.CentralDifference, 5e-4, 2, False),
        once(nts.CentralDifference, 5e-4, 2, True),
    ],
)
def test_a_bar_that_falls_flat_stays_flat(comm, scheme, dt, dim, is_turned):
    """A bar without lateral contraction: one wave travels along it, at any place of its base."""

    def build(model):
        if dim == 2:
            parts.add_rectangle(model, "bar", corner=(0, GAP), size=(0.2, 1), cells=(4, 20))
        else:
            corner, size = (0, 0, GAP), (0.2, 0.2, 1)
            parts.add_box(model, "bar", corner=corner, size=size, cells=(4, 4, 20))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    bar = nts.Body(V, cells, tag["bar"], nts.SaintVenantKirchhoff(E, 0.0, RHO))
    up = np.eye(dim)[-1]
    floor = nts.RigidPlane(0 * up, up)
    if is_turned:  # a wall that its motion has laid down
        motion = nts.Motion(rotation=lambda t: -np.pi / 2)
        floor = nts.RigidPlane((0, 0), (-1, 0)).moving(motion)
    pair = nts.ContactPair(nts.boundary_of(bar), floor)
    stepper = scheme([bar], [pair], dt=dt)
    stepper.set_velocity(bar, -SPEED * up)
    owned = V.dofmap.index_map.size_local
    base = np.abs(V.tabulate_dof_coordinates()[:owned, dim - 1] - GAP) < 1e-9
    forces = []
    for report in stepper.run(until=0.05):
        heights = comm.allgather(stepper.x[:owned][base, dim - 1])
        assert np.ptp(np.concatenate(heights)) < 1e-13
        if report.t > 0.015:
            forces.append(nts.Diagnostics(stepper).contact_force()[dim - 1])
    expected = np.sqrt(E * RHO) * SPEED * 0.2 ** (dim - 1)
    assert np.mean(forces) == pytest.approx(expected, rel=0.02)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("scheme", "dt", "method", "tolerance"),
    [
        (nts.EnergyMomentum, 2e-3, "node-to-segment", 1e-10),
        (nts.EnergyMomentum, 2e-3, None, 2e-3),
        (nts.CentralDifference, 2e-4, None, 1e-12),
    ],
)
def test_half_of_a_symmetric_scene_has_half_of_the_force(scheme, dt, method, tolerance):
    """A block falls on a plate; a plane of symmetry cuts both."""

    def forces(halves):
        begin = 0 if halves == 1 else -1

        def build(model):
            for name, size, z, n in (("plate", (1, 0.4), 0, 5), ("block", (0.3, 0.4), 0.42, 3)):
                corner, size = (begin * size[0], z), (halves * size[0], size[1])
                rows = 2 if name == "plate" else 4
                parts.add_rectangle(model, name, corner=corner, size=size, cells=(halves * n, rows))

        mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_SELF)
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        plate = nts.Body(V, cells, tag["plate"], nts.NeoHookean(1e5, 0.3, RHO))
        block = nts.Body(V, cells, tag["block"], nts.NeoHookean(5e4, 0.3, RHO))
        held = fem.locate_dofs_topological(V, 1, facets.find(tag["plate_bottom"]))
        bcs = [fem.dirichletbc(np.zeros(2), held, V)]
        if halves == 1:
            middle = fem.locate_dofs_geometrical(
                (V.sub(0), V.sub(0).collapse()[0]), lambda x: np.isclose(x[0], 0)
            )
            zero = fem.Function(V.sub(0).collapse()[0])
            bcs.append(fem.dirichletbc(zero, middle, V.sub(0)))
        sides = nts.boundary_of(block), nts.boundary_of(plate)
        pair = nts.ContactPair(*sides, method=method)
        stepper = scheme([plate, block], [pair], dt=dt, bcs=bcs)
        stepper.set_velocity(block, (0.0, -1.0))
        diagnostics = nts.Diagnostics(stepper)
        return np.array([diagnostics.contact_force()[1] for _ in stepper.run(until=0.06)])

    whole, half = forces(2), forces(1)
    assert whole.max() > 0
    assert np.abs(2 * half - whole).max() < tolerance * whole.max()


def low_block(comm, width):
    """Block of one layer of cells, 0.1 m high, on the line y = 0."""

    def build(model):
        parts.add_rectangle(model, "block", corner=(0, 0), size=(width, 0.1), cells=(4, 1))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    return nts.Body(V, cells, tag["block"], nts.NeoHookean(1e5, 0.3, RHO))


def test_a_cap_of_shear_stress_acts_on_the_base_alone(comm):
    """A block of low cells is pressed on a floor and dragged: force = stress x base."""
    width, stress = 0.2, 100.0  # m, Pa

    block = low_block(comm, width)
    V, mesh = block.V, block.V.mesh
    drag = fem.Constant(mesh, np.zeros(2))
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0.1))

    def update(t):
        drag.value[:] = 0.02 * max(t - 1, 0), -2e-3 * min(t, 1)

    pair = nts.ContactPair(
        nts.boundary_of(block),
        nts.RigidPlane((0, 0), (0, 1)),
        friction=nts.Tresca(nts.Coulomb(0.5), stress),
    )
    bcs = [fem.dirichletbc(drag, top, V)]
    stepper = nts.QuasiStatic([block], [pair], dt=0.5, bcs=bcs, update=update)
    for report in stepper.run(until=3.0):
        pull = report.reactions[0].force[0]
    assert pull == pytest.approx(stress * width, rel=1e-9)


def test_a_cap_of_shear_stress_acts_on_the_base_alone_in_explicit_steps(comm):
    """A block of low cells slides on a floor: the largest force is stress x base."""
    width, stress = 0.2, 20.0  # m, Pa

    block = low_block(comm, width)
    law = nts.Tresca(nts.Coulomb(0.5), stress)
    pair = nts.ContactPair(nts.boundary_of(block), nts.RigidPlane((0, 0), (0, 1)), friction=law)
    gravity = nts.Gravity([block], (0, -9.81))
    stepper = nts.CentralDifference([block], [pair], dt=5e-4, loads=[gravity])
    stepper.set_velocity(block, (1.0, 0.0))
    diagnostics = nts.Diagnostics(stepper)
    forces = [-diagnostics.contact_force()[0] for _ in stepper.run(until=0.05)]
    assert max(forces) == pytest.approx(stress * width, rel=1e-9)
