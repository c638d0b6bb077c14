"""Bad input: all ranks raise one error with the expected and the given value."""

import re

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import create_unit_cube

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers import scenes
from helpers.models import box_meshes
from helpers.once import once
from helpers.scene import input_ids

pytestmark = pytest.mark.at_most_two_ranks

schemes = pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.Midpoint)])


def test_missing_file_is_named(comm, refused, tmp_path):
    with refused(OSError, "no such file.msh|No such file"):
        nts.read_mesh("/nowhere/no such file.msh", comm)


def test_unknown_region_name_lists_existing_names(comm, refused):
    _, _, _, tag = nts.read_mesh(scenes.BALL_PLATE, comm)
    with refused(ValueError, r"physical groups \['ball', 'ball_inner', .*\], given 'bal'"):
        tag["bal"]


def test_wrong_tags_of_bodies_and_surfaces_are_named(comm, refused):
    mesh, cells, facets, tag = nts.read_mesh(scenes.BALL_PLATE, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(1.0, 0.3, 1.0)
    with refused(ValueError, r"one of the tags \[.*\] of cells, given 77"):
        nts.Body(V, cells, 77, rubber)
    with refused(ValueError, r"one of the tags \[.*\] of facets, given 77"):
        nts.Surface(V, facets, 77)
    with refused(TypeError, "expected an integer tag, given 'ball'"):
        nts.Body(V, cells, "ball", rubber)
    with refused(ValueError, "expected facets of dimension 2, given tags of dimension 3"):
        nts.Surface(V, cells, tag["ball"])
    with refused(ValueError, "expected cells of dimension 3, given tags of dimension 2"):
        nts.Body(V, facets, tag["ball_outer"], rubber)
    with refused(TypeError, "function space as the first argument, given MeshTags"):
        nts.Body(cells, V, tag["ball"], rubber)
    ball = nts.Body(V, cells, tag["ball"], rubber)
    with refused(TypeError, "first argument, given Body: .* a body has its own as body.V"):
        nts.Surface.where(ball, lambda x: x[2] < 0.1)


def test_mesh_of_single_precision_is_refused(comm, refused):
    mesh = create_unit_cube(comm, 2, 2, 2, dtype=np.float32)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    with refused(ValueError, "64 bits, given float32: make it with dtype=np.float64"):
        nts.Surface.where(V, lambda x: x[2] < 0.1)


def three_boxes(comm):
    """Three boxes in a row, apart from each other."""

    def build(model):
        for i, x in enumerate((0.0, 1.5, 3.0)):
            parts.add_box(model, f"box {i}", corner=(x, 0, 0), size=(1, 1, 1), cells=(1, 1, 1))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    return [nts.Body(V, cells, tag[f"box {i}"], nts.NeoHookean(1, 0.3, 1)) for i in range(3)]


def test_bodies_that_no_pair_lets_touch_another_are_named(comm, caplog):
    bodies = three_boxes(comm)
    surfaces = [nts.boundary_of(body) for body in bodies]
    floor = nts.RigidPlane((0, 0, -1), (0, 0, 1))
    onto_floor = nts.ContactPair(
        nts.boundary_of(*bodies),
        floor,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    chain = [
        nts.ContactPair(
            surfaces[i],
            surfaces[i + 1],
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        for i in range(2)
    ]
    itself = nts.ContactPair(
        surfaces[2], surfaces[2], enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    for pairs, names in (
        ([onto_floor], "box 0, box 1, box 2"),
        ([itself, chain[0]], "box 2"),
        (chain, ""),
        (nts.all_pairs(bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"), ""),
    ):
        caplog.clear()
        nts.EnergyMomentum(bodies, pairs, dt=0.1)
        messages = [record.getMessage() for record in caplog.records]
        assert len(messages) == (comm.rank == 0 and bool(names))
        text = f"without a contact pair with another body: {names}; harmless if they never meet"
        assert all(text in message for message in messages)


def test_surface_in_a_space_of_another_degree_is_refused(comm, refused):
    mesh, _, facets, tag = nts.read_mesh(scenes.BALL_PLATE, comm)
    V = fem.functionspace(mesh, ("Lagrange", 3, (3,)))
    with refused(ValueError, r"\('Lagrange', 1, \(3,\)\).*given .*degree 3"):
        nts.Surface(V, facets, tag["ball_outer"])


def test_node_on_both_sides_of_a_pair_is_refused(comm, refused):
    mesh, _, facets, tag = nts.read_mesh(scenes.BALL_PLATE, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    top, side = (nts.Surface(V, facets, tag[f"plate_{name}"]) for name in ("top", "left"))
    with refused(ValueError, "given 11 nodes on both sides"):
        nts.ContactPair(side, top, enforcement=nts.LagrangeMultiplier(), method="node-to-segment")


@pytest.mark.parametrize("bad", [np.nan, *map(once, [np.inf, -np.inf])])
@pytest.mark.parametrize("name", ["displacement", "velocity"])
def test_state_that_is_not_finite_is_refused(comm, bad, name, refused, agree):
    scene = scenes.blocks(comm)
    scene.run(1)
    stepper = scene.stepper
    values = {"displacement": stepper.u, "velocity": stepper.v}[name].x.array
    # One dof of one node, which one rank owns.
    values.reshape(-1, 3)[input_ids(stepper.u.function_space) == 33, 1] = bad
    before = stepper.u.x.array.copy(), stepper.v.x.array.copy(), stepper.pairs[0].history
    with refused(ValueError, f"expected a finite {name}, given 1 dofs that are not"):
        stepper.advance()
    assert agree(np.array_equal(stepper.u.x.array, before[0], equal_nan=True))
    assert agree(np.array_equal(stepper.v.x.array, before[1], equal_nan=True))
    assert agree(stepper.pairs[0].history is before[2])
    assert (stepper.t, stepper.step) == (scenes.BLOCK_STEP, 1)


@schemes
def test_element_that_inverts_is_named_with_its_place_and_time(comm, scheme, refused, agree):
    # The reflected body has C = 1 and no stress, so all equations hold.
    scene = scenes.blocks(comm, scheme)
    stepper, body = scene.stepper, scene.bodies["body 0"]
    stepper.set_displacement(body, lambda X: np.array([0 * X[0], 0 * X[0], -4.0 - 2 * X[2]]))
    before = stepper.u.x.array.copy()
    message = r"step 1 from t = 0 to 0\.02 .*cell \d+ near \[.*\] is inverted, det F = -1\b"
    message += ".*SaintVenantKirchhoff cannot resist collapse, NeoHookean can"
    with refused(nts.ConvergenceError, message):
        stepper.advance()
    assert agree(np.array_equal(stepper.u.x.array, before))
    with pytest.raises(nts.ConvergenceError) as caught:
        stepper.advance()
    found = {int(number) for number in re.findall(r"cell (\d+) ", str(caught.value))}
    assert found <= set(range(9))  # cells of the lower body


def test_element_that_inverts_on_one_rank_is_named_on_all(comm, refused):
    # Only the first cell: only its rank can detect it.
    data = box_meshes.boxes([(4, 1, 1)], [(4.0, 1.0, 1.0)])
    mesh, cells, _, tag = box_meshes.distribute(
        comm, data, owner=lambda middle: np.arange(len(middle)) % comm.size
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(1.0, 0.0, 1.0))
    stepper = nts.Midpoint([body], dt=1e-6)
    stepper.set_displacement(body, lambda X: np.array([3.0 * (X[0] < 0.5), 0 * X[0], 0 * X[0]]))
    with refused(nts.ConvergenceError, r"cell 0 near .* is inverted, det F = -2\b"):
        stepper.advance()


def test_empty_physical_group_of_a_file_has_no_tag(comm, refused):
    # A named surface without a facet is missing in the mesh file.
    data = box_meshes.boxes([(2, 2, 1)], [(1.0, 1.0, 0.5)])
    data.surfaces["nothing"] = np.array([0])
    mesh, _, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    with refused(
        ValueError, rf"expected one of the tags \[1, 2\] of facets, given {tag['nothing']}"
    ):
        nts.Surface(V, facets, tag["nothing"])


@pytest.mark.parametrize("sideways", [True, once(False)])
def test_prescribed_nodes_in_contact_with_supported_surfaces_are_named(comm, refused, sideways):
    def build(model):
        parts.add_box(model, "floor", corner=(-1, -1, -1), size=(2, 2, 1), cells=(2, 2, 1))
        parts.add_box(model, "block", corner=(-0.3, -0.4, 0.01), size=(0.5, 1, 1), cells=(1, 1, 1))

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.Body(V, cells, tag[k], nts.NeoHookean(1e5, 0.3, 1e3)) for k in ("floor", "block")]
    bottom = nts.Surface(V, facets, tag["block_bottom"])
    pair = nts.ContactPair(
        bottom,
        nts.Surface(V, facets, tag["floor_top"]),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    travel = fem.Constant(mesh, 0.0)

    def update(t):
        travel.value = -t

    bcs = []
    for axis in range(3) if sideways else [2]:
        W = V.sub(axis)
        for name, value in (("floor_top", fem.Constant(mesh, 0.0)), ("block_bottom", travel)):
            if axis < 2:
                value = fem.Constant(mesh, 0.0)
            dofs = fem.locate_dofs_topological(W, 2, facets.find(tag[name]))
            bcs.append(fem.dirichletbc(value, dofs, W))
    stepper = nts.EnergyMomentum(bodies, [pair], dt=0.005, bcs=bcs, update=update)
    stepper.advance()
    ids = sorted({*np.concatenate(comm.allgather(bottom.node_ids)).tolist()})
    named = "bcs move nodes into a surface .* between block_bottom and floor_top: "
    reports = []
    with refused(nts.ConvergenceError, named + ", ".join(map(str, ids))):
        try:
            list(stepper.run(until=0.1))
        except nts.ConvergenceError as error:
            reports += error.reports
            raise
    assert stepper.t == 0.01
    assert sum(report.iterations for report in reports) < 10


@schemes
def test_unreachable_convergence_is_reported_on_all_ranks(comm, scheme, refused):
    # A block whose velocity moves it by ten times its size in a step, through another block.
    scene = scenes.blocks(comm, scheme)
    scene.stepper.set_velocity(scene.bodies["body 1"], lambda X: 1e4 * X[[1, 2, 0]])
    with refused(nts.ConvergenceError, r"(?s)step 1 from t = 0 to 0\.02 failed: .*\|R\|"):
        scene.stepper.advance()
    assert scene.stepper.t == 0
    assert comm.allreduce(float(np.abs(scene.stepper.u.x.array).max()), op=MPI.MAX) == 0


@pytest.mark.parametrize(
    ("scheme", "extra"), [(nts.EnergyMomentum, {}), (nts.GeneralizedAlpha, {"rho_inf": 0.5})]
)
def test_a_stepper_without_dt_names_its_class_and_arguments(comm, refused, scheme, extra):
    bodies, name = three_boxes(comm), scheme.__name__
    text = (
        rf"expected {name}\(bodies, pairs, \*, dt, .*\), of which bodies and dt must be given, .*"
    )
    for arguments, options, given in (
        ([bodies], {}, r"\(list.*\): missing a required.* 'dt'"),
        ([bodies, [], 0.1], {}, r"\(list, list, float.*\): too many positional arguments"),
        ([bodies], {"dt": 0.1, "velocity": 1}, r"\(list, dt=, velocity=.*\): .*'velocity'"),
        ([], {"dt": 0.1}, r"\(dt=.*\): missing a required argument: 'bodies'"),
    ):
        with refused(TypeError, text + f", .*given {name}" + given):
            scheme(*arguments, **options, **extra)


def test_central_difference_finds_its_own_dt(comm, refused):
    with refused(TypeError, r"expected CentralDifference\(.*\), of which bodies must be given"):
        nts.CentralDifference()
