"""Preconditioners of the bulk: the steps do not depend on the choice."""

import logging
import math

from petsc4py import PETSc

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import CellType, create_rectangle, meshtags

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.solvers.linear import krylov
from dolfinx_nts.solvers.precond import factor_age, preconditioner
from dolfinx_nts.solvers.precond.block_ilu import BlockILU, SinglePrecisionOperator
from helpers import scenes
from helpers.scene import gathered

# Tolerance of displacements after some steps, each to the tolerance of Newton's method, relative to
# lengths of about one.
AGREEMENT = 1e-10

INCOMPLETE = {"sub_pc_type": "ilu", "sub_pc_factor_levels": 1}
OPTIONS = {
    "lu": {"pc_type": "lu"},
    "lu of MUMPS": {
        "pc_type": "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": 40,
    },
    "lu of SuperLU": {"pc_type": "lu", "pc_factor_mat_solver_type": "superlu_dist"},
    "cholesky": {"pc_type": "cholesky"},
    "hypre": {"pc_type": "hypre"},
    "gamg": {"pc_type": "gamg"},
    "jacobi": {"pc_type": "jacobi"},
    "asm": {"pc_type": "asm", "pc_asm_overlap": 2, **INCOMPLETE},
    "asm of lu": {"pc_type": "asm", "sub_pc_type": "lu"},
    "bjacobi": {"pc_type": "bjacobi", **INCOMPLETE},
    "bjacobi of gamg": {"pc_type": "bjacobi", "sub_pc_type": "gamg"},
}
NUM_STEPS = 8


def with_options(scene, options):
    """The same scene with options for PETSc."""
    old = scene.stepper
    stepper = type(old)(old.bodies, old.pairs, dt=old.dt, petsc_options=options)
    stepper.v.x.array[:] = old.v.x.array
    return stepper


def positions(stepper):
    V = stepper.u.function_space
    return gathered(V, stepper.x[: V.dofmap.index_map.size_local])


@pytest.fixture(scope="module")
def default():
    """Positions and iterations with the default preconditioner, without approximate increments.

    Only incomplete factors without fill are trusted with those.
    """
    stepper = scenes.blocks(scenes.MPI.COMM_WORLD).stepper
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(krylov.LinearSolver, "one_application_reduction", math.nan)
        for _ in range(NUM_STEPS):
            stepper.advance()
    return positions(stepper), stepper.statistics.solver.num_iterations


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("name", OPTIONS)
def test_every_preconditioner_of_petsc_gives_the_same_steps(comm, default, name):
    stepper = with_options(scenes.blocks(comm), OPTIONS[name])
    for _ in range(NUM_STEPS):
        stepper.advance()
    work = stepper.statistics.solver
    expected, iterations = default
    np.testing.assert_allclose(positions(stepper), expected, atol=AGREEMENT)
    assert work.preconditioner == OPTIONS[name]["pc_type"].upper()
    assert work.num_direct == 0 and not work.is_strong
    assert (work.num_iterations > 1.2 * iterations) == (name == "jacobi")


@pytest.mark.parametrize("kind", ["ilu", "icc"])
def test_factors_for_one_rank_are_refused_on_several(comm, default, refused, kind):
    if comm.size == 1:
        stepper = with_options(scenes.blocks(comm), {"pc_type": kind})
        for _ in range(NUM_STEPS):
            stepper.advance()
        np.testing.assert_allclose(positions(stepper), default[0], atol=AGREEMENT)
        return
    scene = scenes.blocks(comm)
    with refused(ValueError, f"several ranks.* given {kind} on {comm.size} ranks"):
        with_options(scene, {"pc_type": kind})


@pytest.mark.at_most_two_ranks
def test_options_may_choose_another_krylov_method(comm, default):
    stepper = with_options(scenes.blocks(comm), {"ksp_type": "gmres"})
    for _ in range(NUM_STEPS):
        stepper.advance()
    assert str(stepper._solver._krylov.others) == "gmres"
    assert "single precision" in stepper.statistics.solver.preconditioner
    np.testing.assert_allclose(positions(stepper), default[0], atol=AGREEMENT)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("options", "unused"),
    [
        ({"ksp_typ": "gmres"}, "ksp_typ"),
        ({"pc_typ": "gamg", "ksp_type": "gmres"}, "pc_typ"),
        ({"pc_type": "jacobi", "sub_pc_type": "ilu", "ksp_max": 3}, "sub_pc_type, ksp_max"),
        ({"pc_type": "lu", "mg_levels_pc_type": "sor"}, "mg_levels_pc_type"),
    ],
)
def test_options_that_nothing_asks_for_are_refused_by_name(comm, refused, options, unused):
    scene, before = scenes.blocks(comm), PETSc.Options().getAll().keys()
    stepper = with_options(scene, options)
    with refused(ValueError, f"expected petsc_options .* given {unused}$"):
        stepper.advance()
    # PETSc would warn again at the end of the program.
    left = PETSc.Options().getAll().keys() - before
    assert not any(name.endswith(f"_{key}") for name in left for key in unused.split(", "))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"ksp_type": "nosuch"}, "given .*ksp_type.*: Unable to find requested KSP type nosuch"),
        ({"ksp_rtol": 1e-3}, r"without ksp_rtol, .* sets, given \['ksp_rtol'\]"),
        ({1: 2}, r"with names as str, given \[1\]"),
        ({"ksp_type": "cg"}, "given .*'cg'.*RIGHT"),
        ({"ksp_gmres_restart": "many"}, "given .*: Input string many has no integer value"),
        ({"pc_type": "nosuch"}, "given .*pc_type.*: Unable to find requested PC type nosuch"),
        (
            {"pc_type": "python"},
            r"with a class as pc_python_type, .* given \{'pc_type': 'python'\}",
        ),
        ({"-pc_type": "lu"}, r"without a leading -, given \['-pc_type'\]"),
        (
            {"pc_type": "python", "pc_python_type": "no_such_module.Factors"},
            "given .*: ModuleNotFoundError: No module named 'no_such_module'",
        ),
    ],
)
def test_options_that_petsc_does_not_understand_are_refused_with_its_reason(
    comm, refused, options, reason
):
    scene, before = scenes.blocks(comm), PETSc.Options().getAll().keys()
    with refused(ValueError, f"expected petsc_options .*{reason}"):
        with_options(scene, options).advance()
    assert not PETSc.Options().getAll().keys() - before


@pytest.mark.at_most_two_ranks
def test_options_for_levels_may_wait_for_a_mesh_that_has_some(comm, caplog):
    scene = scenes.blocks(comm)
    with_options(scene, {"pc_type": "gamg", "mg_levels_9_ksp_max_it": 1}).advance()
    named = ["mg_levels_9_ksp_max_it" in record.getMessage() for record in caplog.records]
    assert named == ([True] if comm.rank == 0 else [])


def test_a_choice_of_the_user_has_to_fail_before_another_takes_its_place(
    comm, monkeypatch, caplog, default
):
    monkeypatch.setattr("dolfinx_nts.solvers.precond.factor_age._SLOW", 0.0)
    monkeypatch.setattr("dolfinx_nts.solvers.precond.factor_age._MOST_CROSSINGS", 0.0)
    stepper = with_options(scenes.blocks(comm), {"pc_type": "jacobi"})
    for _ in range(NUM_STEPS // 2):
        stepper.advance()
    assert stepper.statistics.solver.preconditioner == "JACOBI" and not caplog.records
    monkeypatch.setattr("dolfinx_nts.solvers.linear.projected_krylov._MAX_ITERATIONS", 3)
    for _ in range(NUM_STEPS // 2):
        stepper.advance()
    assert stepper.statistics.solver.preconditioner == "CHOLESKY"
    said = [(r.levelno, r.getMessage()) for r in caplog.records]
    text = (
        "the preconditioner JACOBI of petsc_options fails, and stronger factors replace it: "
        "harmless for the results, but omit the option, or choose another one, to save time"
    )
    assert said == ([(logging.WARNING, text)] if comm.rank == 0 else [])
    np.testing.assert_allclose(positions(stepper), default[0], atol=AGREEMENT)


@pytest.mark.parametrize("direct_up_to", [0, 50_000], ids=["multigrid", "factors"])
def test_failing_krylov_method_falls_back_on_stronger_preconditioners(
    comm, monkeypatch, direct_up_to
):
    # One iteration never reaches the tolerance with an incomplete
    # factorisation; what follows must give the same steps.
    monkeypatch.setattr("dolfinx_nts.solvers.precond.preconditioner._DIRECT_UP_TO", direct_up_to)
    reference, limited = scenes.blocks(comm), scenes.blocks(comm)
    for _ in range(8):
        reference.stepper.advance()
    monkeypatch.setattr("dolfinx_nts.solvers.linear.projected_krylov._MAX_ITERATIONS", 1)
    for _ in range(8):
        limited.stepper.advance()
    work = limited.stepper.statistics.solver
    assert work.is_strong and work.num_direct > 0
    np.testing.assert_allclose(limited.positions(), reference.positions(), atol=1e-10)


@pytest.mark.serial
def test_statistics_name_the_last_factors_where_stronger_ones_are_not_made_yet(comm):
    stepper = scenes.blocks(comm).stepper
    stepper.advance()
    before = stepper.statistics.solver
    stepper._solver._preconditioner.strengthen()
    assert stepper.statistics.solver.preconditioner == before.preconditioner != ""


@pytest.mark.at_most_two_ranks
def test_slow_iterations_lead_to_factors_with_fill(comm, monkeypatch, default, agree):
    monkeypatch.setattr("dolfinx_nts.solvers.precond.factor_age._SLOW_ILU0", 0.0)
    stepper = scenes.blocks(comm).stepper
    for _ in range(NUM_STEPS):
        stepper.advance()
    work, (expected, iterations) = stepper.statistics.solver, default
    assert agree(work.preconditioner.endswith("ILU(1) in single precision"))
    assert work.num_direct == 0 and work.num_iterations <= iterations
    np.testing.assert_allclose(positions(stepper), expected, atol=AGREEMENT)


def test_multigrid_in_single_precision_converges_as_that_of_petsc(comm, monkeypatch):
    monkeypatch.setattr("dolfinx_nts.solvers.precond.factor_age._MOST_CROSSINGS", 0.0)
    monkeypatch.setattr("dolfinx_nts.solvers.precond.preconditioner._DIRECT_UP_TO", 0)
    smoothed, apply = [], BlockILU.apply
    multiplied, mult = [], SinglePrecisionOperator.mult

    def counted(self, pc, r, z):
        smoothed.append(pc)
        apply(self, pc, r, z)

    def counted_product(self, matrix, x, y):
        multiplied.append(matrix)
        mult(self, matrix, x, y)

    def run(options=None):
        stepper = with_options(scenes.ball_plate(comm, shift=scenes.NO_TIES), options)
        for _ in range(10):
            stepper.advance()
        work = stepper.statistics.solver
        assert work.preconditioner == "GAMG" and work.num_direct == 0
        return positions(stepper), work.num_iterations

    monkeypatch.setattr(BlockILU, "apply", counted)
    monkeypatch.setattr(SinglePrecisionOperator, "mult", counted_product)
    own, iterations = run()
    # Before and after the coarser levels.
    counts = len(smoothed), len(multiplied)
    assert min(counts) >= 2 * iterations > 0
    expected, others = run(preconditioner._MULTIGRID_OPTIONS)
    assert (len(smoothed), len(multiplied)) == counts
    # Each run has a partition of its own.
    assert abs(iterations - others) <= 2
    np.testing.assert_allclose(own, expected, atol=1e-9)


def test_factors_missing_on_one_rank_are_replaced_by_stronger_ones(comm, monkeypatch, agree):
    reference, singular = scenes.blocks(comm), scenes.blocks(comm)
    reference.stepper.advance()
    build = _kernels.IncompleteFactors.factorise

    def factorise(kernel, start, column, value, *options):
        values = value if comm.rank else 0 * value
        return build(kernel, start, column, values, *options)

    monkeypatch.setattr(_kernels.IncompleteFactors, "factorise", factorise)
    singular.stepper.advance()
    work = singular.stepper.statistics.solver
    assert agree(work.is_strong and work.num_builds == 1)
    np.testing.assert_allclose(singular.positions(), reference.positions(), atol=1e-10)


@pytest.mark.serial
@pytest.mark.parametrize("nu", [0.3, 0.499])
def test_complete_factors_in_single_precision_serve_as_well_as_mumps(comm, monkeypatch, nu):
    # Slow iterations would select them one after the other.
    monkeypatch.setattr(factor_age, "_MOST_CROSSINGS", np.inf)
    monkeypatch.setattr(factor_age, "_SLOW_NEARBY", np.inf)
    ends, iterations = [], []
    for strength, kind in ((2, "LU in single precision"), (3, "LU")):
        scene = scenes.sliding_blocks(comm, nts.LagrangeMultiplier(), None, n=3, nu=nu)
        scene.stepper._solver._preconditioner._strength = strength
        for _ in range(2):
            scene.stepper.advance()
        work = scene.stepper.statistics.solver
        assert work.preconditioner == kind and work.num_direct == 0
        ends.append(scene.positions())
        iterations.append(work.num_iterations)
    np.testing.assert_allclose(*ends, atol=AGREEMENT)
    assert iterations[0] < 1.2 * iterations[1] + 5


@pytest.mark.at_most_two_ranks
def test_plastic_flow_takes_factors_of_the_derivative_itself(comm, agree):
    # Its tangent is a few hundredths of the elastic one, which all other factors use.
    mesh = create_rectangle(comm, [(0, 0), (1, 1)], [6, 6], CellType.quadrilateral)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    every_cell = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    cells = meshtags(mesh, 2, every_cell, np.ones_like(every_cell))
    metal = nts.J2Plasticity(E=2e11, nu=0.3, rho=7.8e3, yield_stress=3e8, hardening=5e8)
    body = nts.Body(V, cells, 1, metal)
    lid = nts.RigidPlane((0, 1), (0, -1))
    pressed = lid.moving(nts.Motion(translation=lambda t: (0.0, -0.01 * t)))
    pairs = [
        nts.ContactPair(
            nts.boundary_of(body),
            plate,
            friction=nts.Coulomb(0.1),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        for plate in (nts.RigidPlane((0, 0), (0, 1)), pressed)
    ]
    stepper = nts.QuasiStatic([body], pairs, dt=1.0)
    for _ in range(5):
        stepper.advance()
    factors, before = stepper._solver._preconditioner, Snapshot()
    assert agree(not (factors.may_be_strengthened or factors.is_complete))
    stepper.serialize(before)
    iterations = stepper.statistics.solver.num_iterations
    num_newton = stepper.advance().newton_iterations
    assert agree(stepper.statistics.solver.num_iterations - iterations < 12 * num_newton)
    once = positions(stepper)
    stepper.serialize(before.rewind())
    stepper.advance()
    np.testing.assert_allclose(positions(stepper), once, atol=1e-13)


@pytest.mark.at_most_two_ranks
def test_a_step_that_made_strong_factors_leaves_none_of_their_options(comm, agree):
    # PETSc keeps options by name: MUMPS options do not fit an incomplete factorisation.
    stepper = scenes.blocks(comm).stepper
    stepper.advance()
    before = Snapshot()
    stepper.serialize(before)
    factors = stepper._solver._preconditioner
    kind = str(factors)
    factors.strengthen(fully=True)
    factors.build()
    assert agree(factors.is_strong and str(factors) != kind)
    stepper.serialize(before.rewind())
    assert agree(not factors.is_strong and str(factors) == kind)
    stepper.advance()
