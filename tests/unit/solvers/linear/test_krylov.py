"""Krylov solver on the projected tangent, compared with the whole saddle point system."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.solvers.linear.active_sets import ActiveSets
from dolfinx_nts.solvers.linear.elimination import active_pairs
from dolfinx_nts.solvers.linear.krylov import LinearSolver
from dolfinx_nts.solvers.linear.projected_krylov import KrylovMethod
from dolfinx_nts.solvers.linear.saddle_point import SaddlePointSystem
from helpers import scenes
from helpers.models.rigid import impact
from helpers.once import once

# Tolerance of a Krylov solution asked for 1e-11, relative to the largest increment.
AGREEMENT = 1e-8


def compare(monkeypatch, scene, num_steps):
    """Advance; solve every linear system of contact by both methods."""
    differences, ranks = [], set()
    solver = scene.stepper._solver
    saddle, solve = SaddlePointSystem(solver.tangent, scene.stepper._bulk), solver.solve

    def both(R, steps, states, rtol):
        du, multipliers = solve(R, steps, states, 1e-11)
        if any(step.num_active for step in steps):
            ranks.update(np.concatenate([state.rank for state in states]).tolist())
            direct, _ = saddle.solve(R, active_pairs(steps, states, 3))
            comm = scene.comm
            largest = comm.allreduce(np.abs(direct).max(initial=0.0), op=scenes.MPI.MAX)
            error = comm.allreduce(np.abs(du - direct).max(initial=0.0), op=scenes.MPI.MAX)
            differences.append(error / largest)
        return du, multipliers

    monkeypatch.setattr(solver, "solve", both)
    for _ in range(num_steps):
        scene.stepper.advance()
    return differences, set().union(*scene.comm.allgather(ranks)), solver


LAWS = {
    "multiplier": (nts.LagrangeMultiplier(), None, {1}),
    "penalty": (nts.Penalty(), nts.Coulomb(0.3), {0}),
    "spring": (nts.LagrangeMultiplier(), nts.Coulomb(0.3, 1e2), {1}),
    "stick and slip": (nts.LagrangeMultiplier(), nts.Coulomb(0.6), {1, 3}),
}


@pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
@pytest.mark.parametrize("law", LAWS)
def test_increments_solve_the_saddle_system(comm, monkeypatch, cell, law):
    enforcement, friction, expected = LAWS[law]
    scene = scenes.blocks(comm, nts.EnergyMomentum, enforcement, cell=cell, friction=friction)
    differences, ranks, solver = compare(monkeypatch, scene, 10)
    assert expected <= ranks
    assert len(differences) > 3 and max(differences) < AGREEMENT
    assert solver.num_direct == 0 and solver.num_iterations > 0


@pytest.mark.at_most_two_ranks
def test_three_bodies_and_two_pairs_are_solved_together(comm, monkeypatch):
    scene = scenes.blocks(comm, num_bodies=3)
    differences, _, _ = compare(monkeypatch, scene, 10)
    assert len(differences) > 3 and max(differences) < AGREEMENT


@pytest.mark.parametrize("friction", [once(None), nts.Coulomb(0.3)])
def test_increments_with_rigid_bodies_solve_the_saddle_system(comm, monkeypatch, friction):
    scene = impact(comm, friction=friction)
    differences, _, solver = compare(monkeypatch, scene, 10)
    assert len(differences) > 3 and max(differences) < AGREEMENT
    assert solver.num_direct == 0 and solver.num_iterations > 0


@pytest.mark.parametrize("friction", [once(None), once(nts.Coulomb(0.3)), nts.Coulomb(0.6)])
def test_direct_solver_alone_gives_the_same_steps(comm, monkeypatch, friction):
    ends, iterations = [], []
    for direct in (False, True):
        scene = scenes.blocks(comm, friction=friction, cell="tetrahedron")
        if direct:
            monkeypatch.setattr(ActiveSets, "are_coupled", lambda *_: True)
            # Coupled decisions on all points would save iterations.
            monkeypatch.setattr(LinearSolver, "consistent_states", lambda *_: None)
        iterations.append([scene.stepper.advance().newton_iterations for _ in range(10)])
        ends.append(scene.positions())
        assert (scene.stepper.statistics.solver.num_direct > 0) == direct
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-10)
    # Newton's method sees the same multipliers and tractions.
    assert np.all(np.abs(np.subtract(*iterations)) <= 1)


@pytest.mark.at_most_two_ranks
def test_a_method_that_keeps_failing_is_tried_less_and_less_often(comm, monkeypatch):
    scene, tried = scenes.blocks(comm), []

    def fail(_method, _b, _rtol, **_options):
        tried.append(1)
        return None, 200

    monkeypatch.setattr(KrylovMethod, "solve", fail)
    work = scene.stepper.statistics.solver
    while work.num_direct < 2 + 4 + 8 + 4:
        scene.stepper.advance()
        work = scene.stepper.statistics.solver
    # After the systems 1, 1 + 3 and 1 + 3 + 5 the method is tried again, two or three times, with
    # other factors.
    assert work.num_builds <= 4 * 2 and len(tried) <= 4 * 3


@pytest.mark.at_most_two_ranks
def test_one_preconditioner_lasts_for_many_steps(comm):
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    stepper = scene.stepper
    for _ in range(15):
        stepper.advance()
    assert comm.allreduce(int(stepper.pairs[0].history.active.sum())) > 3
    work = stepper.statistics.solver
    # One assembly for the stiffness of the nodes, one for each build.
    assert work.num_builds <= 3 and work.num_tangents <= 4


@pytest.mark.at_most_two_ranks
def test_rough_solutions_take_one_application_of_the_preconditioner(comm, monkeypatch):
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    solver, bulk = scene.stepper._solver, scene.stepper._bulk
    solve, products, errors = solver.solve, [], []

    def rough(R, steps, states, rtol):
        reduction, before = solver.one_application_reduction, bulk.num_assembled[1]
        if not reduction > 0:
            return solve(R, steps, states, rtol)
        du, _ = solve(R, steps, states, reduction)
        products.append(bulk.num_assembled[1] - before)
        exact, multipliers = solve(R, steps, states, 1e-3)
        squares = comm.allreduce(np.array([(du - exact) @ (du - exact), exact @ exact]))
        errors.append(np.sqrt(squares[0] / squares[1]))
        return exact, multipliers

    monkeypatch.setattr(solver, "solve", rough)
    for _ in range(8):
        scene.stepper.advance()
    # One for the part that meets the constraints, where that is large.
    assert len(errors) > 5 and max(products) <= 1
    assert max(errors) < 0.3


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_contact_hardly_adds_to_the_iterations_of_the_bulk(comm, mu):
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES, friction=nts.Coulomb(mu))
    solver = scene.stepper._solver
    counts = []
    for _ in range(15):
        before = solver.num_iterations
        report = scene.stepper.advance()
        decades = np.log10(report.residual_norms[0] / report.residual_norms[-1])
        if report.num_active:
            counts.append((solver.num_iterations - before) / decades)
    # The bulk alone needs one iteration a decade; without the correction it is two.
    assert len(counts) > 5 and np.mean(counts) < 1.5
    assert solver.num_direct == 0


@pytest.mark.at_most_two_ranks
def test_cells_that_are_nearly_incompressible_and_do_not_lock_take_factors_with_fill(comm):
    rubber = nts.SaintVenantKirchhoff(1e5, 0.49, 1e3, one_point="volumetric")
    stepper = scenes.ball_plate(comm, shift=scenes.NO_TIES, dt=0.03, rubber=rubber).stepper
    newton = sum(stepper.advance().newton_iterations for _ in range(6))
    work = stepper.statistics.solver
    # Without fill there are more than 30 for each system.
    assert "ILU(1)" in work.preconditioner
    assert work.num_direct == 0 and work.num_iterations < 20 * newton


@pytest.fixture(scope="module")
def wide_free():
    return iterations_of_wide_contact(scenes.MPI.COMM_WORLD, nts.LagrangeMultiplier(), None)


def iterations_of_wide_contact(comm, enforcement, friction):
    """Krylov iterations of a linear system while 144 nodes stick, begin to slip, and slip."""
    scene = scenes.sliding_blocks(comm, enforcement, friction, n=11)
    reports = [scene.stepper.advance() for _ in range(4)]
    assert reports[-1].num_active == 144
    work = scene.stepper.statistics.solver
    assert work.num_direct == 0
    return work.num_iterations / sum(report.newton_iterations for report in reports)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("enforcement", "friction"),
    [(nts.LagrangeMultiplier(), 0.3), (nts.Penalty(), 0.0), (nts.Penalty(), 0.3)],
)
def test_wide_friction_and_springs_take_few_iterations(comm, wide_free, enforcement, friction):
    law = nts.Coulomb(friction) if friction else None
    assert iterations_of_wide_contact(comm, enforcement, law) <= 1.5 * wide_free


@pytest.mark.at_most_two_ranks
def test_contacts_are_factorised_again_only_for_other_pairs_factors_or_tangents(comm):
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    for _ in range(10):
        scene.stepper.advance()
    solver = scene.stepper._solver
    schwarz = solver._contacts._schwarz
    count = schwarz.num_builds
    schwarz.update(solver._operator.elimination)
    assert schwarz.num_builds == count > 0
    solver.tangent.num_assembled += 1
    schwarz.update(solver._operator.elimination)
    assert schwarz.num_builds == count + 1
    # Slipping nodes turn, and their tangents with them.
    stiffness = comm.allreduce(solver.tangent.nodal_stiffness().min(), op=scenes.MPI.MIN)
    for change, builds in ((0.05, 1), (0.2, 2), (0.0, 2)):
        elimination = solver._operator.elimination
        pairs = elimination.pairs[0]
        tangent = pairs.blocks.tangent.copy()
        tangent[:1] += change * stiffness
        pairs.blocks = pairs.blocks._replace(tangent=tangent)
        schwarz.update(elimination)
        assert schwarz.num_builds == count + builds


@pytest.mark.at_most_two_ranks
def test_courant_number_is_infinite_without_inertia(comm, monkeypatch):
    solver = scenes.blocks(comm, nts.QuasiStatic).stepper._solver
    stiffness = np.full_like(solver.tangent.nodal_stiffness(), 1e9)
    stiffness[:1] = 0.0
    monkeypatch.setattr(solver.tangent, "nodal_stiffness", lambda: stiffness)
    with np.errstate(all="raise"):
        assert solver._factors._wave_crossings() == np.inf
