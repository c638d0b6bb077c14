"""Statics of bodies supported by contact alone, and of unsupported bodies."""

import logging

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary, meshtags

import dolfinx_nts as nts
from benchmarks.scenes import sliding_block
from dolfinx_nts import parts
from helpers.laws import NODAL
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

WEIGHT = 9.81  # of the upper block [N]
FEW = 15  # Newton iterations
# Relative error of forces: round-off; and where facets of the dent that do not match push a block
# without friction sideways, which goes to its inertia.
ROUND_OFF, FACETS = 1e-9, 1e-7


class Blocks:
    """A block of 0.1 m and 1 kg in contact with a clamped block of the same material."""

    def __init__(self, *, cell="hexahedron", wide=0.1, nu=0.3, lowest=0.0):
        """Mesh both blocks; the lower one is wider by a margin on each side."""
        comm = MPI.COMM_WORLD

        def fill(model):
            n = round(2 * wide / 0.1) + 2
            box = {"cell": cell}
            low = {"corner": (-wide, -wide, -0.1), "size": (0.1 + 2 * wide,) * 2 + (0.1,)}
            parts.add_box(model, "low", **low, cells=(n, n, 2), **box)
            top = {"corner": (0, 0, lowest), "size": (0.1,) * 3, "cells": (4, 4, 4)}
            parts.add_box(model, "top", **(top if wide else top | {"cells": (2, 2, 2)}), **box)

        mesh, cells, self.facets, self.tag = nts.read_mesh(fill, comm)
        self.V = V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        rubber = nts.NeoHookean(1e6, nu, 1e3)
        self.top, self.low = (nts.Body(V, cells, self.tag[name], rubber) for name in ("top", "low"))
        self.ground = fem.dirichletbc(
            np.zeros(3), fem.locate_dofs_geometrical(V, lambda x: x[2] < -0.0999), V
        )

    def pair(self, **laws):
        """Lower face of the upper block against the upper face of the other."""
        nodes, segments = (
            nts.Surface(self.V, self.facets, self.tag[name]) for name in ("top_bottom", "low_top")
        )
        return nts.ContactPair(nodes, segments, **(NODAL | laws))

    def stepper(self, pairs, g, **options):
        """Statics with gravity on the upper block."""
        return nts.QuasiStatic(
            *([self.top, self.low], pairs), dt=0.25, bcs=[self.ground],
            loads=[nts.Gravity([self.top], g)], **options,
        )  # fmt: skip


@pytest.mark.parametrize("cell", [once("hexahedron"), "tetrahedron"])
@pytest.mark.parametrize("mu", [0.0, once(0.05), 0.3, once(1.0)])
@pytest.mark.parametrize("ramped", [False, once(True)])
def test_a_block_rests_on_a_block(cell, mu, ramped):
    blocks = Blocks(cell=cell)
    pair = blocks.pair(friction=nts.Coulomb(mu) if mu else None)
    g = (lambda t: (0, 0, -9.81 * t)) if ramped else (0, 0, -9.81)
    stepper = blocks.stepper([pair], g)
    iterations = [step.newton_iterations for step in stepper.run(until=1.0)]
    assert max(iterations) <= FEW
    # Friction is in equilibrium after two steps under the full load, and nothing moves any more.
    # Together they need 15 or 16 iterations on tetrahedra, depending on round-off.
    assert ramped or sum(iterations[2:]) == 0
    assert ramped or cell == "tetrahedron" or sum(iterations) <= FEW
    force = nts.Diagnostics(stepper).contact_force()
    assert force[2] == pytest.approx(WEIGHT, rel=ROUND_OFF if mu else FACETS)


@pytest.mark.parametrize(
    # In the second step of the first scene all nodes are at their limit, with little slip.
    ("mu", "ramped"),
    [(0.003, False), once(0.003, True), once(0.01, False), once(0.0102, False)],
)
def test_friction_that_hardly_holds_a_block_is_found(mu, ramped):
    blocks = Blocks(cell="tetrahedron")
    g = (lambda t: (0, 0, -9.81 * t)) if ramped else (0, 0, -9.81)
    stepper = blocks.stepper([blocks.pair(friction=nts.Coulomb(mu))], g)
    assert max(step.newton_iterations for step in stepper.run(until=1.0)) <= FEW


@pytest.mark.serial
def test_a_rim_that_leaves_in_an_iteration_comes_back_sliding():
    """The trailing rim of a block that is drawn pulls while other nodes still stick.

    Its nodes leave then and come back from a slip. Those that would stick there pull again.
    """
    stepper = sliding_block(MPI.COMM_WORLD, "statics", 1.0, n=14, friction=nts.Coulomb(0.3)).stepper
    assert max(stepper.advance().newton_iterations for _ in range(4)) <= FEW


@pytest.mark.parametrize("mu", [once(0.0), 0.3])
def test_a_ball_finds_its_place_on_a_plate_as_fast_as_with_inertia(mu):
    """It touches in one point at first, and nothing else holds it."""

    def fill(model):
        ball = {"centre": (0, 0, 0.05), "radius": 0.05, "cells_per_edge": 2, "layers": 1}
        parts.add_solid_ball(model, "ball", **ball)
        plate = {"corner": (-0.08, -0.08, -0.04), "size": (0.16, 0.16, 0.04)}
        parts.add_box(model, "plate", **plate, cells=(4, 4, 2))

    mesh, cells, facets, tag = nts.read_mesh(fill, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(1e6, 0.3, 1e3)
    ball, plate = (nts.Body(V, cells, tag[name], rubber) for name in ("ball", "plate"))
    top = nts.Surface(V, facets, tag["plate_top"])
    ground = fem.dirichletbc(
        np.zeros(3), fem.locate_dofs_geometrical(V, lambda x: x[2] < -0.0399), V
    )
    work = []
    for scheme in (nts.QuasiStatic, nts.EnergyMomentum):
        friction = nts.Coulomb(mu) if mu else None
        pair = nts.ContactPair(
            nts.boundary_of(ball),
            top,
            friction=friction,
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        load = nts.Gravity([ball], lambda t: (0, 0, -98.1 * t))
        stepper = scheme([ball, plate], [pair], dt=0.1, bcs=[ground], loads=[load])
        for _ in stepper.run(until=0.5):
            pass
        work.append(stepper.statistics.solver)
    static, dynamic = work
    assert static.num_iterations <= 3 * dynamic.num_iterations
    assert static.num_builds <= dynamic.num_builds + 3 and static.num_direct == 0
    assert "  statics; " in str(static) and "Courant number" in str(dynamic)


@pytest.mark.parametrize("mu", [once(0.0), 0.3])
def test_pressure_is_weight_over_area_on_a_matching_mesh(mu):
    """Without Poisson's ratio nothing moves sideways: the state is uniaxial."""
    blocks = Blocks(wide=0.0, nu=0.0)
    pair = blocks.pair(friction=nts.Coulomb(mu) if mu else None)
    stepper = blocks.stepper([pair], (0, 0, -9.81))
    assert stepper.advance().newton_iterations <= FEW
    assert stepper.contacts[0].pressure == pytest.approx(WEIGHT / 0.01, rel=ROUND_OFF)
    sideways = np.abs(stepper.u.x.array.reshape(-1, 3)[:, :2]).max(initial=0.0)
    assert sideways <= 1e-9 * 0.1


@pytest.mark.serial
@pytest.mark.parametrize("force", [1e2, 1e3])
def test_a_free_rotation_may_move_a_support_that_has_deformed(force):
    """The flat side of a half disc is held sideways, and bends: its rotation is nearly free."""

    def fill(model):
        occ = model.occ
        disc, upper = occ.addDisk(0, 1, 0, 1, 1), occ.addRectangle(-2, 1, 0, 4, 2)
        half, _ = occ.cut([(2, disc)], [(2, upper)])
        occ.synchronize()
        model.addPhysicalGroup(2, [half[0][1]], name="half")
        model.mesh.setSize(model.getEntities(0), 0.2)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(fill, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    half = nts.Body(V, cells, tag["half"], nts.NeoHookean(1e6, 0.3, 1e3))
    flat = np.sort(locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 1)))
    sideways = fem.locate_dofs_topological(V.sub(0), 1, flat)
    top = nts.Surface(V, meshtags(mesh, 1, flat, np.full(len(flat), 1, np.int32)), 1)
    round_side = nts.boundary_of(half, where=lambda x: x[1] < 0.9)
    stepper = nts.QuasiStatic(
        [half], [nts.ContactPair(round_side, nts.RigidPlane((0, 0), (0, 1)))], dt=0.5,
        bcs=[fem.dirichletbc(0.0, sideways, V.sub(0))],
        loads=[nts.Traction(top, lambda t: (0, -force * t))],
    )  # fmt: skip
    assert [step.newton_iterations <= FEW for step in stepper.run(until=1.0)] == [True, True]
    pressed = nts.Diagnostics(stepper).contact_force()
    np.testing.assert_allclose(pressed, (0, 2 * force), rtol=FACETS, atol=FACETS * force)


@pytest.mark.serial
def test_springs_carry_the_same_load_at_the_same_depth_in_every_step():
    stiffness = 2e4
    blocks = Blocks(wide=0.0, nu=0.0)
    pair = blocks.pair(enforcement=nts.Penalty(stiffness))
    stepper = blocks.stepper([pair], (0, 0, -9.81))
    comm = MPI.COMM_WORLD
    for _ in stepper.run(until=0.75):
        history = stepper.contacts[0].history
        assert history.lambda_N == pytest.approx(stiffness * history.gap, rel=ROUND_OFF)
        assert comm.allreduce(history.lambda_N.sum()) == pytest.approx(-WEIGHT, rel=FACETS)


@pytest.mark.serial
def test_a_block_falls_onto_the_other_where_statics_has_no_other_equilibrium():
    blocks = Blocks(lowest=1e-3)
    stepper = blocks.stepper([blocks.pair(friction=nts.Coulomb(0.5))], (0, 0, -9.81))
    assert stepper.advance().newton_iterations <= 2 * FEW
    force = nts.Diagnostics(stepper).contact_force()
    assert force[2] == pytest.approx(WEIGHT, rel=ROUND_OFF)


@pytest.mark.parametrize("mu", [once(0.0), 0.3])
def test_inertia_relief_is_reported_with_its_reason(mu, caplog):
    """The lower block sags away from the upper one, which a slight load pushes sideways.

    The load grows much in the second step, which is reported, and by less in the third.
    """
    blocks = Blocks()
    pair = blocks.pair(friction=nts.Coulomb(mu) if mu else None)
    slight = nts.Gravity([blocks.top], lambda t: (1e-4 * 9.81 * min(4 * t, 2.3) ** 3, 0, 0))
    heavy = nts.Gravity([blocks.low], (0, 0, -9.81))
    stepper = nts.QuasiStatic(
        [blocks.top, blocks.low], [pair], dt=0.25, bcs=[blocks.ground], loads=[slight, heavy]
    )
    stepper.advance()
    assert stepper.contacts[0].history.lambda_N == pytest.approx(0.0)
    assert len(list(stepper.run(until=0.75))) == 2
    messages = [m for m in caplog.messages if "of the forces is not balanced" in m]
    assert len(messages) == (2 if MPI.COMM_WORLD.rank == 0 else 0)
    for text in messages:
        assert "top (free: translation in x, y, z, rotation about x, y, z)" in text
        assert ("there is no friction without normal force" in text) == (mu > 0)
        assert text.startswith("only contact without friction holds") == (mu == 0)


@pytest.mark.parametrize("g", [once((0, 0, 9.81), id="up"), (9.81, 0, -9.81)])
def test_unsupported_body_is_named_with_its_free_motions(g):
    blocks = Blocks()
    stepper = blocks.stepper([blocks.pair()], g)
    text = (
        r"no support or contact holds top \(free: translation in x, y, z, rotation about x, y, z\)"
        r" against .* N; add bcs or friction, use inertia \(EnergyMomentum\)"
    )
    with pytest.raises(nts.ConvergenceError, match=text) as error:
        stepper.advance()
    assert "smaller dt" not in str(error.value)
    assert stepper.step == 0 and not stepper.u.x.array.any()


def test_unsupported_motions_are_reported():
    """A face that is held in its plane may move across it, and tilt about two axes in it."""
    blocks = Blocks()
    guided = []
    for axis in (0, 1):
        Vi = blocks.V.sub(axis)
        dofs = fem.locate_dofs_geometrical((Vi, Vi.collapse()[0]), lambda x: x[2] > 0.0999)[0]
        guided.append(fem.dirichletbc(np.float64(0), dofs, Vi))
    stepper = nts.QuasiStatic(
        [blocks.top, blocks.low], [], dt=1.0, bcs=[blocks.ground, *guided],
        loads=[nts.Gravity([blocks.top], (0, 0, -9.81))],
    )  # fmt: skip
    text = r"top \(free: translation in z, 2 other rigid motions\) against 9.81 N"
    with pytest.raises(nts.ConvergenceError, match=text):
        stepper.advance()


@pytest.mark.serial
def test_motions_with_all_nodes_supported_are_not_free():
    blocks = Blocks()
    Vz = blocks.V.sub(2)
    dofs = fem.locate_dofs_geometrical((Vz, Vz.collapse()[0]), lambda x: x[2] > -0.01)[0]
    stepper = nts.QuasiStatic(
        [blocks.top, blocks.low], [], dt=1.0,
        bcs=[blocks.ground, fem.dirichletbc(np.float64(0), dofs, Vz)],
        loads=[nts.Gravity([blocks.top], (9.81, 0, 0))],
    )  # fmt: skip
    text = r"top \(free: translation in x, y, rotation about z\) against 9.81 N"
    with pytest.raises(nts.ConvergenceError, match=text):
        stepper.advance()


@pytest.mark.serial
def test_a_pair_that_is_given_twice_is_refused():
    blocks = Blocks()
    with pytest.raises(ValueError, match=r"each pair once.*pairs\[0\] and pairs\[1\]"):
        blocks.stepper([blocks.pair(), blocks.pair()], (0, 0, -9.81))


@pytest.mark.parametrize("value", [once(0.0), np.nan])
def test_cells_without_volume_are_refused(value):
    blocks = Blocks()
    z = blocks.V.mesh.geometry.x[:, 2]
    z[z > 0] = value
    with pytest.raises(ValueError, match=r"expected cells with a volume, given \d+ of top without"):
        blocks.stepper([blocks.pair()], (0, 0, -9.81))


def test_a_load_that_is_not_finite_is_refused():
    blocks = Blocks()
    factor = fem.Constant(blocks.V.mesh, np.nan)
    load = nts.FormLoad(blocks.V, lambda u, eta, t: factor * eta[2] * ufl.dx)
    stepper = nts.QuasiStatic(
        [blocks.top, blocks.low], [blocks.pair()], dt=1.0, bcs=[blocks.ground], loads=[load]
    )
    with pytest.raises(ValueError, match="expected finite loads"):
        stepper.advance()


@pytest.mark.serial
@pytest.mark.parametrize("names", [("top", "left", "right"), ("left", "top", "right")])
def test_a_brick_lies_flush_on_two_others_in_any_order(names):
    """Slipping increments of the brick deform it; they are no part of a solution."""
    boxes = {"left": ((0, 0, 0), 4), "right": ((1.002, 0, 0), 4), "top": ((0.5, 0, 0.4), 5)}

    def build(model):
        for name, (corner, n) in boxes.items():
            parts.add_box(model, name, corner=corner, size=(1, 0.5, 0.4), cells=(n, 3, 2))

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    stone = nts.SaintVenantKirchhoff(E=1e7, nu=0.2, rho=2e3)
    bodies = {name: nts.Body(V, cells, tag[name], stone) for name in names}
    ground = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0))
    stepper = nts.QuasiStatic(
        list(bodies.values()),
        nts.all_pairs(list(bodies.values())),
        dt=0.5,
        bcs=[fem.dirichletbc(np.zeros(3), ground, V)],
        loads=[nts.Gravity([bodies["top"]], lambda t: (0, 0, -9.81 * t))],
    )
    for report in stepper.run(until=1.0):
        assert report.newton_iterations <= FEW
    diagnostics = nts.Diagnostics(stepper)
    weight = 2e3 * 0.2 * 9.81
    between = diagnostics.between()
    signs = {name: 1 if name.endswith("top") else -1 for name in between if "top" in name}
    forces = [signs[name] * between[name][2] for name in signs]
    assert sum(forces) == pytest.approx(-weight, rel=1e-5)
    assert forces == pytest.approx([-weight / 2] * 2, rel=0.03)


@pytest.mark.parametrize("cells", [2, once(6)])
def test_unbalanced_forces_are_measured_by_their_resultant(comm, caplog, cells, refused):
    """A block on a smooth floor slides under any load along it; 1 % of its weight is accepted."""

    def build(model):
        corner, size = (0, 0, 0), (1.0, 1.0, 0.3)
        parts.add_box(model, "block", corner=corner, size=size, cells=(cells, cells, 1))

    mesh, tags, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, tags, tag["block"], nts.NeoHookean(1e5, 0.3, 1e3))

    def pulled(part):
        pair = nts.ContactPair(nts.boundary_of(block), nts.RigidPlane((0, 0, 0), (0, 0, 1)))
        weight = nts.Gravity([block], (part * 9.81, 0.0, -9.81))
        return nts.QuasiStatic([block], [pair], dt=1.0, loads=[weight])

    with caplog.at_level(logging.WARNING):
        pulled(0.005).advance()
    if comm.rank == 0:
        assert any("5.0e-03 of the forces is not balanced" in each for each in caplog.messages)
    with refused(nts.ConvergenceError, "no support or contact holds block"):
        pulled(0.05).advance()
