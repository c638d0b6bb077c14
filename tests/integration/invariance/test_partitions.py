"""The result does not depend on numbering, partition and linear solver."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh

import dolfinx_nts as nts
from helpers import scenes
from helpers.interrupted import SCHEMES, layers_of
from helpers.models import box_meshes, plane
from helpers.once import once
from stress.run import CASES

# Relative, of energies: scenes without ties, so that only rounding and
# Newton's tolerance differ.
ENERGY_TOLERANCE = 1e-10
# Tolerance of positions, lengths of about one: impacts amplify these.
POSITION_TOLERANCE = 1e-9

MORTAR, RESOLVED = SCHEMES["mortar"], SCHEMES["resolved"]
RESOLVED_MORTAR = SCHEMES["resolved mortar"]


def two_ranks(*values):
    """Parameters with which a third rank adds no new case."""
    return pytest.param(*values, marks=pytest.mark.at_most_two_ranks)


def compare(one, other, num_steps, numbers=None):
    """Run two scenes and compare energies and positions on all ranks."""
    first, second = one.run(num_steps), other.run(num_steps)
    difference = max(
        np.abs(second.energy / first.energy - 1).max(),
        np.abs(second.kinetic / first.kinetic - 1).max(),
    )
    positions = other.positions()
    if numbers is not None:
        positions = box_meshes.in_numbers(positions, numbers)
    moved = np.abs(positions - one.positions()).max()
    active = first.num_active == second.num_active
    comm = MPI.COMM_WORLD
    assert comm.allreduce(difference, op=MPI.MAX) <= ENERGY_TOLERANCE
    assert comm.allreduce(moved, op=MPI.MAX) <= POSITION_TOLERANCE
    assert comm.allreduce(active, op=MPI.LAND)
    assert max(first.num_active) >= 3


@pytest.mark.several_ranks
@pytest.mark.parametrize(
    ("cell", "scheme", "num_bodies"),
    [
        two_ranks("hexahedron", nts.EnergyMomentum, 2),
        ("tetrahedron", nts.EnergyMomentum, 3),
        ("hexahedron", MORTAR, 3),
        two_ranks("tetrahedron", MORTAR, 2),
        two_ranks("hexahedron", nts.Midpoint, 3),
        two_ranks("tetrahedron", nts.Midpoint, 2),
    ],
)
def test_blocks_on_all_ranks_and_on_each_alone_agree(comm, cell, scheme, num_bodies):
    together = scenes.blocks(comm, scheme, cell=cell, num_bodies=num_bodies)
    alone = scenes.blocks(MPI.COMM_SELF, scheme, cell=cell, num_bodies=num_bodies)
    compare(together, alone, 10)


@pytest.mark.several_ranks
def test_ball_and_plate_on_all_ranks_and_on_each_alone_agree(comm):
    together = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    alone = scenes.ball_plate(MPI.COMM_SELF, shift=scenes.NO_TIES)
    compare(together, alone, 15)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("cell", [once("hexahedron"), "tetrahedron"])
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.Midpoint), MORTAR])
def test_renumbered_nodes_and_cells_give_the_same_result(comm, cell, scheme):
    # The renumbering follows from a seed: draw it again.
    plain = scenes.blocks(comm, scheme, cell=cell)
    data = scenes.block_input(cell, 2)[0].permuted(np.random.default_rng(5))
    shuffled = scenes.blocks(comm, scheme, cell=cell, permute=np.random.default_rng(5))
    assert not np.array_equal(data.numbers, np.arange(len(data.X)))
    compare(plain, shuffled, 10, data.numbers)


def one_rank_idle(middle):
    """Last rank: only the outermost cells of the lower block, no contact."""
    size = MPI.COMM_WORLD.size
    owner = np.arange(len(middle)) % max(size - 1, 1)
    return np.where(np.arange(len(middle)) == 0, size - 1, owner)


def body_by_rank(middle):
    """Every rank owns whole bodies or nothing."""
    return np.minimum((middle[:, 2] > 0.5).astype(int), MPI.COMM_WORLD.size - 1)


def scattered(middle):
    """Neighbouring cells on different ranks."""
    return np.random.default_rng(3).integers(MPI.COMM_WORLD.size, size=len(middle))


@pytest.mark.several_ranks
@pytest.mark.parametrize(
    # All pairs of parameters on two ranks; on three ranks each scheme, cell and owner once.
    ("cell", "scheme", "owner"),
    [
        ("hexahedron", nts.EnergyMomentum, one_rank_idle),
        two_ranks("tetrahedron", nts.EnergyMomentum, body_by_rank),
        two_ranks("hexahedron", nts.EnergyMomentum, scattered),
        two_ranks("tetrahedron", MORTAR, one_rank_idle),
        ("hexahedron", MORTAR, body_by_rank),
        two_ranks("tetrahedron", MORTAR, scattered),
        two_ranks("hexahedron", RESOLVED, one_rank_idle),
        two_ranks("tetrahedron", RESOLVED, body_by_rank),
        ("hexahedron", RESOLVED, scattered),
        ("tetrahedron", RESOLVED_MORTAR, one_rank_idle),
        two_ranks("hexahedron", RESOLVED_MORTAR, body_by_rank),
        ("tetrahedron", RESOLVED_MORTAR, scattered),
    ],
)
def test_any_owner_of_the_cells_gives_the_same_result(comm, cell, scheme, owner):
    layers = layers_of(scheme)
    special = scenes.blocks(comm, scheme, cell=cell, layers=layers, owner=owner)
    alone = scenes.blocks(MPI.COMM_SELF, scheme, cell=cell, layers=layers)
    compare(special, alone, 10)


@pytest.mark.several_ranks
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_surfaces_in_the_plane_on_all_ranks_and_on_one_agree(comm, cell):
    def energies(comm):
        scene = plane.blocks(cell, angle=0.4, comm=comm)
        friction = nts.Coulomb(0.3)
        pair = nts.ContactPair(
            scene.nodes,
            scene.segments,
            friction=friction,
            method="mortar",
            enforcement=nts.LagrangeMultiplier(),
        )
        stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
        plane.throw(scene, stepper)
        diagnostics = nts.Diagnostics(stepper)
        rows = []
        for step in stepper.run(0.12):
            energies = diagnostics.kinetic_energy(), diagnostics.strain_energy()
            rows.append((*energies, step.num_active))
        return rows

    together, alone = energies(comm), energies(MPI.COMM_SELF)
    assert max(active for *_, active in alone) >= 3
    np.testing.assert_allclose(together, alone, rtol=ENERGY_TOLERANCE, atol=1e-9)


@pytest.mark.several_ranks
def test_ranks_without_surfaces_take_part(comm):
    # Two thirds of a tall lower body are far from its top.
    def owner(middle):
        return np.where(middle[:, 2] > 0.35, 0, comm.size - 1)

    scene = scenes.tower(comm, owner=owner)
    (pair,) = scene.stepper.pairs
    entities = [len(a) for a in (pair.nodes.nodes, pair.nodes.segments, pair.segments.segments)]
    if comm.size > 1:
        assert comm.allgather(sum(entities))[-1] == 0
    compare(scene, scenes.tower(MPI.COMM_SELF), 10)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("name", "num_steps"),
    [
        ("cube on plate, degree 2, hexahedron: stands on = corner", 36),
        ("needles: aspect = 1000", 18),
    ],
)
def test_segments_are_the_same_however_linear_systems_are_solved(
    comm, monkeypatch, name, num_steps
):
    # The partition changes the preconditioner and thus every iterate, within the tolerance of the
    # linear systems. The same holds for a smaller tolerance.
    (case,) = (case for case in CASES if case.name == name)
    ends = []
    for tight in (False, True):
        if tight:
            monkeypatch.setattr("dolfinx_nts.solvers.newton._forcing", lambda norms, target: 1e-6)
        stepper = case.build(comm).stepper
        for _ in range(num_steps):
            stepper.advance()
        ends.append(stepper.x)
    assert comm.allreduce(np.abs(ends[1] - ends[0]).max(), op=MPI.MAX) <= POSITION_TOLERANCE


@pytest.mark.several_ranks
def test_meshes_with_ghost_cells_and_supports_by_facets_agree_with_one_rank(comm):
    """Meshes of `dolfinx.mesh.create_box`, with a constant Dirichlet value."""

    def press(comm):
        """Energies of a cube that hangs from its top and is pressed onto a plane."""
        cube = mesh.create_box(
            comm, [[0, 0, 0.01], [1, 1, 1.01]], [4, 4, 4], mesh.CellType.hexahedron
        )
        V = fem.functionspace(cube, ("Lagrange", 1, (3,)))
        cells = np.arange(cube.topology.index_map(3).size_local, dtype=np.int32)
        tags = mesh.meshtags(cube, 3, cells, np.ones_like(cells))
        cube.topology.create_connectivity(2, 3)
        top = mesh.locate_entities_boundary(cube, 2, lambda x: np.isclose(x[2], 1.01))
        held = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, top), V)
        body = nts.Body(V, tags, 1, nts.NeoHookean(1e5, 0.3, 1e3))
        floor = nts.RigidPlane((0, 0, 0), (0, 0, 1))
        stepper = nts.EnergyMomentum(
            [body], [nts.ContactPair(nts.boundary_of(body), floor, nts.LagrangeMultiplier())],
            dt=0.01, bcs=[held], loads=[nts.Gravity([body], (0, 0, -100.0))],
        )  # fmt: skip
        diagnostics = nts.Diagnostics(stepper)
        return [
            (diagnostics.kinetic_energy(), step.num_active, step.t) for step in stepper.run(0.08)
        ]

    np.testing.assert_allclose(press(comm), press(MPI.COMM_SELF), rtol=ENERGY_TOLERANCE)
