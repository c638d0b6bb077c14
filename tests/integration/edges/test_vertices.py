"""Vertices on edges and corners are held by faces between nodes, whichever side gives the nodes."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary
from numpy.polynomial.polynomial import polyvander2d
from scipy.interpolate import CubicHermiteSpline

import dolfinx_nts as nts
from dolfinx_nts.io import checkpoint
from helpers.laws import NODES
from helpers.once import once
from reference.bulk import rotation

SIZE, FLOOR = 0.3, 2.0  # m, edges of the block and of the floor
DIAGONAL = [1.0, -1.0, 0.0], np.arctan(np.sqrt(2.0))
TURNS = {
    "face": ([1.0, 0.0, 0.0], 0.0),
    "edge": ([1.0, 0.0, 0.0], np.pi / 4),
    "corner": DIAGONAL,
    "2-D": ([0.0, 0.0, 1.0], np.pi / 4),
}
MORTAR = {"method": "mortar"}
DEFAULT = {"method": None}  # springs and surface-to-surface contact
LAWS = {"elastic": nts.LagrangeMultiplier(), "plastic": nts.LagrangeMultiplier("plastic")}


class Scene:
    """A block above a floor of two facets an edge, turned so that a corner or edge points down."""

    def __init__(self, comm, turn, gap=0.0, floor=2, block=3, at=(0.12, 0.17)):
        self.dim = dim = 2 if turn == "2-D" else 3

        def fill(model):
            add = nts.parts.add_rectangle if dim == 2 else nts.parts.add_box
            corner, size = (-FLOOR / 2,) * (dim - 1), (FLOOR,) * (dim - 1)
            cells = (floor,) * (dim - 1)
            add(model, "low", corner=(*corner, -1), size=(*size, 1.0), cells=(*cells, 2))
            add(model, "up", corner=(0,) * dim, size=(SIZE,) * dim, cells=(block,) * dim)

        mesh, cells, _, tag = nts.read_mesh(fill, comm)
        x = mesh.geometry.x
        own = np.unique(mesh.geometry.dofmap[cells.find(tag["up"])]).astype(np.int32)
        corners = np.array(np.meshgrid(*[[0, SIZE]] * dim, *[[0]] * (3 - dim))).reshape(3, -1).T
        R = rotation(*TURNS[turn])
        move = np.array([*at[: dim - 1], gap - (corners @ R.T)[:, dim - 1].min(), 0.0])[:3]
        x[own] = x[own] @ R.T + move
        self.V = V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
        material = nts.NeoHookean(E=2e5, nu=0.3, rho=1e3)
        self.low, self.up = (nts.Body(V, cells, tag[k], material) for k in ("low", "up"))
        self.X = V.tabulate_dof_coordinates()

    def pair(self, law, mu=0.0, **how):
        """The floor gives the nodes."""
        surfaces = nts.boundary_of(self.low), nts.boundary_of(self.up)
        return nts.ContactPair(*surfaces, law, nts.Coulomb(mu) if mu else None, **(NODES | how))

    def held(self, nodes, value=None):
        """Prescribed displacement of nodes of this rank."""
        value = fem.Constant(self.V.mesh, np.zeros(self.dim)) if value is None else value
        return fem.dirichletbc(value, nodes.astype(np.int32), self.V)

    def depth(self, stepper):
        """Largest depth of a node of the block below the facets of the floor [m]."""
        comm, z = self.V.mesh.comm, self.dim - 1
        top = self.low.nodes[np.isclose(self.X[self.low.nodes, z], 0.0)]

        def gathered(nodes):
            return np.concatenate(
                comm.allgather(np.column_stack([self.X[nodes], stepper.x[nodes]]))
            )

        floor, block = np.unique(gathered(top), axis=0), gathered(self.up.nodes)[:, 3:]
        if self.dim == 2:
            line = floor[floor[:, 0].argsort(), 3:]
            return (np.interp(block[:, 0], line[:, 0], line[:, 1]) - block[:, 1]).max()
        n = round(len(floor) ** 0.5)
        grid = floor[np.lexsort(floor[:, [1, 0]].T.round(9))][:, 3:].reshape(n, n, 3)
        depth = -np.inf
        for i, j in np.ndindex(n - 1, n - 1):
            facet = [grid[i, j], grid[i + 1, j], grid[i + 1, j + 1], grid[i, j + 1]]
            centre = np.mean(facet, axis=0)
            for a, b in zip(facet, facet[1:] + facet[:1], strict=True):
                edges = np.array([a - centre, b - centre])
                parts = np.linalg.solve(edges[:, :2].T, (block - centre)[:, :2].T).T
                over = (parts.min(axis=1) >= 0) & (parts.sum(axis=1) <= 1)
                height = centre[2] + parts @ edges[:, 2]
                depth = max(depth, (height - block[:, 2])[over].max(initial=-np.inf))
        return depth

    def depth_below_parabola(self, stepper):
        """Largest depth of a node of the block below the parabola through the floor [m].

        In the plane through its three nodes, in space biquadratic through nine.
        """
        comm, z = self.V.mesh.comm, self.dim - 1
        top = self.low.nodes[np.isclose(self.X[self.low.nodes, z], 0.0)]
        floor, block = (np.vstack(comm.allgather(stepper.x[n])) for n in (top, self.up.nodes))

        def powers(x):
            return polyvander2d(x[:, 0], x[:, 1] * (z == 2), [2, 2 * (z == 2)])

        surface = np.linalg.lstsq(powers(floor), floor[:, z])[0]
        return (powers(block) @ surface - block[:, z]).max()


def press(comm, turn, travel=0.02, law=LAWS["elastic"], **how):
    """Press the block into the floor in statics.

    Returns its force [N], and its depth below the facets and below the parabola [m].
    """
    scene, reverse = Scene(comm, turn), how.pop("reverse", False)
    pair = scene.pair(law, **how)
    if reverse:
        patches = nts.boundary_of(scene.low, smooth=True)
        pair = nts.ContactPair(pair.segments, patches, pair.enforcement, method="node-to-segment")
    z = scene.dim - 1
    middle = reduced(comm, scene.X[scene.up.nodes, z])
    upper = scene.up.nodes[scene.X[scene.up.nodes, z] > middle + 1e-9]
    bottom = scene.low.nodes[np.isclose(scene.X[scene.low.nodes, z], -1.0)]
    drive = fem.Constant(scene.V.mesh, np.zeros(scene.dim))

    def update(t):
        drive.value[z] = -travel * t

    bcs = [scene.held(bottom), scene.held(upper, drive)]
    stepper = nts.QuasiStatic([scene.low, scene.up], [pair], dt=0.5, bcs=bcs, update=update)
    *_, last = stepper.run(until=1.0)
    of_pair = nts.Diagnostics(stepper).contact_force()
    np.testing.assert_allclose(
        (1 - 2 * reverse) * of_pair, last.reactions[1].force, atol=1e-6 * abs(of_pair).max() + 1e-9
    )
    return -last.reactions[1].force[z], scene.depth(stepper), scene.depth_below_parabola(stepper)


def reduced(comm, heights):
    """Middle of the heights of nodes on all ranks [m]."""
    ends = comm.allgather((heights.min(initial=np.inf), heights.max(initial=-np.inf)))
    return (min(a for a, _ in ends) + max(b for _, b in ends)) / 2


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("turn", "how"),
    [
        *(("2-D", NODES), once("corner", NODES), once("edge", NODES)),
        *(once("2-D", MORTAR), once("corner", MORTAR)),
    ],
)
def test_corner_in_the_middle_of_a_large_facet_is_held_with_the_force_of_the_reverse_pair(
    comm, turn, how
):
    force, depth, below_parabola = press(comm, turn, **how)
    assert below_parabola < 1e-3  # an edge penetrates next to its vertices, as facets bend
    of_reverse, depth_of_reverse, _ = press(comm, turn, reverse=True)
    assert force == pytest.approx(of_reverse, rel=1e-6)
    assert depth == pytest.approx(depth_of_reverse, abs=1e-9)
    assert force > 50  # N


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("turn", ["2-D", once("edge"), "corner"])
@pytest.mark.parametrize("how", [NODES, once(MORTAR)])
def test_springs_of_vertices_in_statics_have_the_force_of_the_reverse_pair(comm, turn, how):
    force, depth, _ = press(comm, turn, law=nts.Penalty(), **how)
    of_reverse, depth_of_reverse, _ = press(comm, turn, law=nts.Penalty(), reverse=True, **how)
    assert force == pytest.approx(of_reverse, rel=1e-9)
    assert depth == pytest.approx(depth_of_reverse, rel=1e-9)


@pytest.mark.serial
@pytest.mark.parametrize("turn", ["2-D", "corner"])
def test_without_exchange_the_corner_sinks_without_force_as_in_the_paper(comm, turn):
    force, depth, _ = press(comm, turn, exchange=False)
    assert abs(force) < 1e-6
    assert depth == pytest.approx(0.02, rel=1e-6)


def throw(comm, turn, law, mu=0.0, num_steps=100, reverse=False, **how):
    """Throw the block at a free floor; return both balances, work and depth [J, m].

    The work is the energy that contact adds to the bodies and does not store in springs.
    """
    scene = Scene(comm, turn, gap=0.01)
    pair = scene.pair(law, mu, **how)
    if reverse:
        pair = nts.ContactPair(pair.segments, pair.nodes, friction=pair.friction)
    stepper = nts.EnergyMomentum([scene.low, scene.up], [pair], dt=2e-3)
    velocity = np.zeros(scene.dim)
    velocity[0], velocity[-1] = 0.5, -1.0
    stepper.set_velocity(scene.up, velocity)
    diagnostics = nts.Diagnostics(stepper)
    first, given, depth, touched = diagnostics.balance(), 0.0, 0.0, 0
    for _ in range(num_steps):
        report = stepper.advance()
        given += sum(report.contact_work) - report.contact_work.springs
        depth = max(depth, scene.depth(stepper))
        touched += report.num_active > 0
    assert touched or "exchange" in how
    return first, diagnostics.balance(), given, depth


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("turn", "law", "mu", "how"),
    [
        ("2-D", "elastic", 0.0, NODES),
        once("2-D", "elastic", 0.5, NODES),
        once("2-D", "plastic", 0.5, NODES),
        ("edge", "elastic", 0.5, NODES),
        once("corner", "elastic", 0.0, NODES),
        once("corner", "plastic", 0.5, NODES),
        once("2-D", "elastic", 0.5, MORTAR),
        ("edge", "elastic", 0.0, MORTAR),
        once("corner", "elastic", 0.5, MORTAR),
        once("corner", "plastic", 0.0, MORTAR),
    ],
)
def test_thrown_block_bounces_off_a_coarse_face_with_exact_energy_and_momenta(
    comm, turn, law, mu, how
):
    first, last, given, depth = throw(comm, turn, LAWS[law], mu, **how)
    assert abs(last.total_energy - first.total_energy - given) < 1e-11 * first.total_energy
    if law == "elastic" and not mu:
        assert abs(given) < 1e-12 * first.total_energy
    assert given < 1e-12 * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        np.testing.assert_allclose(after, before, atol=1e-11 * np.linalg.norm(before))
    # A hundredth of a facet of the block, and half of the approach in a step.
    assert depth < 0.01 * SIZE + 2e-3


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("turn", "mu", "how"),
    [
        ("2-D", 0.0, DEFAULT),
        once("2-D", 0.5, DEFAULT),
        once("2-D", 0.0, NODES),
        ("edge", 0.5, DEFAULT),
        once("corner", 0.0, DEFAULT),
    ],
)
def test_springs_hold_corners_as_deep_as_with_the_nodes_of_the_other_body(comm, turn, mu, how):
    law = nts.Penalty() if how is NODES else None
    first, last, given, depth = throw(comm, turn, law, mu, **how)
    energy = first.total_energy
    assert abs(last.total_energy - energy - given) < 1e-11 * energy
    assert given < 1e-12 * energy
    assert mu or abs(given) < 1e-12 * energy
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        np.testing.assert_allclose(after, before, atol=1e-11 * np.linalg.norm(before))
    *_, of_reverse = throw(comm, turn, law, mu, reverse=True)
    # Springs begin a hundredth of a facet of the block deeper.
    assert depth < of_reverse + 0.01 * np.sqrt(2) * SIZE / 3 + 1e-4


def throw_in_explicit_steps(comm, turn, mu, reverse=False, exchange=True):
    """Throw the block at a free floor.

    Returns both balances, the energy that friction dissipates, and the depth [J, m].
    """
    scene = Scene(comm, turn, gap=0.01)
    sides = [nts.boundary_of(scene.low), nts.boundary_of(scene.up)]
    pair = nts.ContactPair(*sides[:: 1 - 2 * reverse], friction=mu or None, exchange=exchange)
    stepper = nts.CentralDifference([scene.low, scene.up], [pair])
    velocity = np.zeros(scene.dim)
    velocity[0], velocity[-1] = 0.5, -1.0
    stepper.set_velocity(scene.up, velocity)
    diagnostics = nts.Diagnostics(stepper)
    first, friction, depth = diagnostics.balance(), 0.0, 0.0
    while stepper.t < 0.2:
        friction -= stepper.advance().contact_work.friction
        depth = max(depth, scene.depth(stepper))
    return first, diagnostics.balance(), friction, depth


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("mu", [0.0, 0.5])
@pytest.mark.parametrize("turn", ["2-D", "edge", "corner"])
def test_explicit_springs_hold_corners_as_deep_as_with_the_nodes_of_the_other_body(comm, turn, mu):
    first, last, friction, depth = throw_in_explicit_steps(comm, turn, mu)
    assert friction > -1e-12 * first.total_energy and bool(friction) == bool(mu)
    assert abs(last.total_energy + friction - first.total_energy) < 1e-3 * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        np.testing.assert_allclose(after, before, atol=1e-12 * np.linalg.norm(before))
    *_, of_reverse = throw_in_explicit_steps(comm, turn, mu, reverse=True)
    # Springs begin a hundredth of a facet of the block deeper.
    assert depth < of_reverse + 0.01 * np.sqrt(2) * SIZE / 3 + 1e-4
    *_, without = throw_in_explicit_steps(comm, turn, mu, exchange=False)
    assert without > 1.9 * depth  # m


@pytest.mark.parametrize("stepper", [nts.CentralDifference, once(nts.EnergyMomentum)])
def test_a_restored_run_continues_with_loaded_vertices(comm, folder, stepper, agree):
    def scene():
        made = Scene(comm, "edge", gap=0.001)
        pair = nts.ContactPair(nts.boundary_of(made.low), nts.boundary_of(made.up), friction=0.3)
        found = stepper([made.low, made.up], [pair], dt=1e-3)
        found.set_velocity(made.up, (0.5, 0.0, -1.0))
        return found

    whole, part = scene(), scene()
    for _ in range(20):
        whole.advance()
    assert agree(any(v.history.active.any() for v in whole.contacts[0].vertices)) or comm.size > 1
    checkpoint.save(folder / "part.h5", whole)
    checkpoint.load(folder / "part.h5", part)
    for _ in range(20):
        whole.advance()
        part.advance()
    assert agree(np.array_equal(whole.x, part.x))


@pytest.mark.serial
@pytest.mark.parametrize("how", [NODES, DEFAULT])
def test_thrown_block_sinks_into_a_coarse_face_without_exchange(comm, how):
    law = LAWS["elastic"] if how is NODES else None
    *_, depth = throw(comm, "edge", law, exchange=False, **how)
    # The smoothing of surface-to-surface contact presses on the facets beside the edge.
    assert depth > (0.1 if how is NODES else 0.08)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("law", "how", "rounding"),
    [*((law, NODES, 0.0) for law in LAWS.values()), (None, DEFAULT, 1e-14)],
    ids=[*LAWS, "default"],
)
def test_scenes_in_which_nothing_sinks_are_solved_as_without_exchange(comm, law, how, rounding):
    results = []
    for exchange in (True, False):
        scene = Scene(comm, "face", gap=0.003, floor=20, block=3, at=(0.1, 0.1))
        stepper = nts.EnergyMomentum(
            [scene.low, scene.up], [scene.pair(law, 0.3, exchange=exchange, **how)], dt=2e-3
        )
        stepper.set_velocity(scene.up, (0.0, 0.0, -0.2))
        reports = [stepper.advance() for _ in range(20)]
        assert bool(stepper.contacts[0].vertices) == exchange
        counts = [(r.newton_iterations, r.active_set_changes, r.num_active) for r in reports]
        assert sum(active for *_, active in counts)
        results.append((counts, stepper.x.copy()))
    assert results[0][0] == results[1][0]
    np.testing.assert_allclose(results[0][1], results[1][1], rtol=0, atol=rounding)


def curve(nodes):
    """Points on the cubic curve through nodes, with tangents of parabolas through three of them."""
    steps = np.arange(len(nodes))
    tangents = np.gradient(nodes, axis=0, edge_order=2)
    smooth = CubicHermiteSpline(steps, nodes, tangents)
    return smooth(np.linspace(0, steps[-1], 100 * len(nodes)))


def drag(comm, angle, friction, floor):
    """T/N of a block whose leading edge slides over coarse facets, and depth of the edge [-, m]."""
    press, slide, edge = 0.006, 0.24, 1.12  # m

    def fill(model):
        nts.parts.add_rectangle(model, "low", corner=(0, 0), size=(2.5, 1), cells=floor)
        nts.parts.add_rectangle(model, "up", corner=(edge - 0.6, 1), size=(1, 1), cells=(4, 4))

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    x = mesh.geometry.x
    own = np.unique(mesh.geometry.dofmap[cells.find(tag["up"])])
    own = own[x[own, 0] > edge]
    x[own, 0] += np.tan(np.radians(angle - 90)) * (x[own, 1] - 1)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    material = nts.NeoHookean(E=2e5, nu=0.3, rho=1e3)
    low, up = (nts.Body(V, cells, tag[name], material) for name in ("low", "up"))
    surfaces = nts.boundary_of(low), nts.boundary_of(up)
    law = nts.Coulomb(friction) if friction else None
    pair = nts.ContactPair(
        *surfaces,
        friction=law,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    drive = fem.Constant(mesh, np.zeros(2))

    def update(t):
        drive.value[:] = slide * max(t - 0.2, 0) / 0.8, -press * min(t, 0.2) / 0.2

    ends = [fem.locate_dofs_geometrical(V, lambda x, z=z: np.isclose(x[1], z)) for z in (0, 2)]
    bcs = [fem.dirichletbc(np.zeros(2), ends[0], V), fem.dirichletbc(drive, ends[1], V)]
    stepper = nts.QuasiStatic([low, up], [pair], dt=0.1, bcs=bcs, update=update)
    X = V.tabulate_dof_coordinates()
    top = low.nodes[np.isclose(X[low.nodes, 1], 1)]
    tip = np.flatnonzero(
        np.isclose(X[:, 1], 1) & (X[:, 0] == X[up.nodes, 0][np.isclose(X[up.nodes, 1], 1)].max())
    )
    ratios, depth = [], 0.0
    for report in stepper.run(until=1.0):
        force, line = report.reactions[1].force, stepper.x[top]
        line = line[line[:, 0].argsort()]
        height = np.interp(stepper.x[tip, 0], *curve(line[:, :2]).T)
        depth = max(depth, (height - stepper.x[tip, 1]).max())
        if report.t > 0.25:
            ratios.append(-force[0] / force[1])
    return np.array(ratios), depth


@pytest.mark.serial
@pytest.mark.parametrize("friction", [0.5, 0.0])
@pytest.mark.parametrize("angle", [75, 90, 105, 120, 135, 150])
def test_friction_of_an_edge_between_coarse_nodes_agrees_with_coulomb(comm, angle, friction):
    ratios, depth = drag(comm, angle, friction, (5, 2))
    # The floor tilts below the edge of the block, over a whole facet.
    np.testing.assert_allclose(ratios, friction, atol=0.04)
    assert depth < 0.01 * 0.25 + 1e-9


@pytest.mark.serial
def test_node_to_segment_pairs_in_both_directions_have_no_vertices(comm):
    scene = Scene(comm, "2-D")
    pairs = nts.two_half_passes(
        nts.boundary_of(scene.low), nts.boundary_of(scene.up), nts.Penalty(1e5)
    )
    low, up = nts.boundary_of(scene.low), nts.boundary_of(scene.up)
    both = (
        nts.ContactPair(low, up, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"),
        nts.ContactPair(up, low, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"),
    )
    for chosen in (pairs, both):
        stepper = nts.EnergyMomentum([scene.low, scene.up], chosen, dt=1e-3)
        assert not any(contact.vertices for contact in stepper.contacts)


class Wedge:
    """A stiff wedge above a block of 2 by 1 m, with its tip between two nodes of the block."""

    def __init__(self, comm, flank, cells, wedge_gives_nodes, **how):
        width, height = 0.4, 0.5  # m

        def fill(model):
            add = nts.parts.add_rectangle
            add(model, "low", corner=(-1, -1), size=(2, 1), cells=(cells, cells // 2))
            add(model, "up", corner=(-width / 2, 0), size=(width, height), cells=(2, 2))

        mesh, tags, _, tag = nts.read_mesh(fill, comm)
        x, slope = mesh.geometry.x, np.tan(np.radians(flank))
        own = np.unique(mesh.geometry.dofmap[tags.find(tag["up"])])
        part = x[own, 1] / height
        top = height + slope * width / 2
        x[own, 1] = slope * abs(x[own, 0]) * (1 - part) + top * part
        x[own, 0] += 0.02
        self.V = V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        soft, hard = (nts.NeoHookean(E=E, nu=0.3, rho=1e3) for E in (2e5, 2e8))
        self.low = nts.Body(V, tags, tag["low"], soft)
        self.up = nts.Body(V, tags, tag["up"], hard)
        sides = [nts.boundary_of(self.low), nts.boundary_of(self.up)]
        self.sense = 1
        if wedge_gives_nodes:
            sides.reverse()
            self.sense = -1
        self.pair = nts.ContactPair(*sides, **how)
        self.bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -1))


def press_wedge(comm, *scene, **how):
    """Force that presses the tip of a wedge 50 mm into the block [N]."""
    wedge = Wedge(comm, *scene, **how)
    drive = fem.Constant(wedge.V.mesh, np.zeros(2))

    def update(t):
        drive.value[1] = -0.05 * t

    bcs = [
        fem.dirichletbc(np.zeros(2), wedge.bottom, wedge.V),
        fem.dirichletbc(drive, wedge.up.nodes, wedge.V),
    ]
    bodies = [wedge.low, wedge.up]
    stepper = nts.QuasiStatic(bodies, [wedge.pair], dt=0.1, bcs=bcs, update=update)
    *_, last = stepper.run(until=1.0)
    force = last.reactions[1].force
    of_pair = wedge.sense * nts.Diagnostics(stepper).contact_force()
    np.testing.assert_allclose(of_pair, force, atol=1e-6 * np.abs(force).max())
    return -force[1]


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("wedge_gives_nodes", [False, once(True)])
@pytest.mark.parametrize("flank", [45, 60, once(75)])
def test_tip_of_a_wedge_has_the_force_of_finer_facets_in_statics(comm, flank, wedge_gives_nodes):
    force = press_wedge(comm, flank, 32, wedge_gives_nodes)
    finer = press_wedge(comm, flank, 64, False)
    # Coarse facets are stiffer: displacements below a force on a point grow as it is resolved.
    assert finer < force < 1.3 * finer
    assert finer > 3000  # N


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("law", [None, "elastic"])
@pytest.mark.parametrize("flank", [30, 60, 75])
def test_thrown_wedge_bounces_off_whichever_body_gives_the_nodes(comm, flank, law):
    """Facets of a steep wedge do not face the block; its tip alone touches."""
    how = {} if law is None else {"enforcement": LAWS[law], "method": "mortar"}
    lowest = []
    for wedge_gives_nodes in (False, True):
        wedge = Wedge(comm, flank, 16, wedge_gives_nodes, **how)
        stepper = nts.EnergyMomentum(
            [wedge.low, wedge.up],
            [wedge.pair],
            dt=5e-3,
            bcs=[fem.dirichletbc(np.zeros(2), wedge.bottom, wedge.V)],
        )
        stepper.set_velocity(wedge.up, (0.0, -0.5))
        diagnostics = nts.Diagnostics(stepper)
        energy, height = diagnostics.balance().total_energy, 0.0
        for _ in range(60):
            stepper.advance()
            height = min(height, stepper.x[wedge.up.nodes, 1].min(initial=1.0))
        assert diagnostics.balance().total_energy == pytest.approx(energy, rel=1e-10)
        lowest.append(comm.allreduce(height, MPI.MIN))
    assert lowest[0] > -0.1
    assert lowest[1] == pytest.approx(lowest[0], rel=0.1)


@pytest.mark.serial
def test_vertices_are_held_again_after_a_step_without_a_solution(comm):
    """A square cam turns below a guided follower: its sides lie flat on it once in 90 degrees."""
    half, turn = 5.0, 8.0  # mm, rad per second

    def fill(model):
        occ = model.occ
        cam = occ.addRectangle(-half, -half, 0, 2 * half, 2 * half)
        follower = occ.addRectangle(-9, half, 0, 18, 4)
        occ.synchronize()
        for name, face, size in (("cam", cam, 2.5), ("follower", follower, 0.7)):
            model.addPhysicalGroup(2, [face], name=name)
            model.mesh.setSize(model.getBoundary([(2, face)], recursive=True), size)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    guide = nts.Guide(motion=nts.Motion(rotation=lambda t: turn * t))
    cam = nts.RigidBody(V, cells, tag["cam"], rho=7.8e-9, guide=guide)
    follower = nts.Body(V, cells, tag["follower"], nts.NeoHookean(E=1000.0, nu=0.3, rho=7.8e-9))
    ends = locate_entities_boundary(mesh, 1, lambda x: np.isclose(np.abs(x[0]), 9))
    ends = fem.locate_dofs_topological(V.sub(0), 1, ends)
    sides = nts.boundary_of(follower), nts.boundary_of(cam)
    stepper = nts.QuasiStatic(
        [cam, follower],
        [nts.ContactPair(*sides)],
        dt=5e-3,
        bcs=[fem.dirichletbc(np.float64(0), ends, V.sub(0))],
        loads=[nts.Gravity([follower], (0, -9810))],
    )
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.centre_of_mass(follower)[1]
    for step in stepper.run(until=0.24):
        c, s = abs(np.cos(turn * step.t)), abs(np.sin(turn * step.t))
        lift = diagnostics.centre_of_mass(follower)[1] - start
        assert lift == pytest.approx(half * (c + s - 1), abs=1e-3)
