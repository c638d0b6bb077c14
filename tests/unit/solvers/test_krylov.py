"""Krylov solver on the projected tangent against the whole saddle system."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.solvers import block_ilu, preconditioner
from dolfinx_nts.solvers.block_csr import BlockCSR
from dolfinx_nts.solvers.block_ilu import BlockILU, SinglePrecisionOperator
from dolfinx_nts.solvers.contact_schwarz import OverlappingSubdomain, SharedPairs
from dolfinx_nts.solvers.saddle_point import SaddlePointSystem
from helpers import scenes
from helpers.dense_factors import definition, dense, rounding

# Of a Krylov solution asked for 1e-11, relative to the largest increment.
AGREEMENT = 1e-8


def compare(monkeypatch, scene, num_steps):
    """Advance; solve every linear system of contact both ways."""
    differences, ranks = [], set()
    solver = scene.stepper._solver
    saddle, solve = SaddlePointSystem(solver.tangent), solver.solve

    def both(R, steps, states, rtol):
        du, multipliers = solve(R, steps, states, 1e-11)
        if any(step.num_active for step in steps):
            ranks.update(np.concatenate([state.rank for state in states]).tolist())
            direct, _ = saddle.solve(R, steps, states)
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


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("law", LAWS)
def test_increments_are_those_of_the_saddle_system(comm, monkeypatch, cell, law):
    enforcement, friction, expected = LAWS[law]
    scene = scenes.blocks(comm, nts.EnergyMomentum, enforcement, cell=cell, friction=friction)
    differences, ranks, solver = compare(monkeypatch, scene, 10)
    assert expected <= ranks
    assert len(differences) > 3 and max(differences) < AGREEMENT
    assert solver.num_direct == 0 and solver.num_iterations > 0


def test_three_bodies_and_two_pairs_are_solved_together(comm, monkeypatch):
    scene = scenes.blocks(comm, num_bodies=3)
    differences, _, _ = compare(monkeypatch, scene, 10)
    assert len(differences) > 3 and max(differences) < AGREEMENT


@pytest.mark.parametrize("friction", [None, nts.Coulomb(0.3), nts.Coulomb(0.6)])
def test_direct_solver_alone_gives_the_same_steps(comm, monkeypatch, friction):
    ends, iterations = [], []
    for direct in (False, True):
        scene = scenes.blocks(comm, friction=friction, cell="tetrahedron")
        if direct:
            monkeypatch.setattr("dolfinx_nts.solvers.krylov.Coupling.of", lambda self, pairs: True)
        iterations.append([scene.stepper.advance().newton_iterations for _ in range(10)])
        ends.append(scene.positions())
        assert (scene.stepper._solver.num_direct > 0) == direct
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-10)
    # Newton's method sees the same multipliers and tractions.
    assert np.all(np.abs(np.subtract(*iterations)) <= 1)


def test_one_preconditioner_lasts_for_many_steps(comm):
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    stepper = scene.stepper
    for _ in range(15):
        stepper.advance()
    assert comm.allreduce(int(stepper.pairs[0].history.active.sum())) > 3
    assert stepper._solver._preconditioner.num_builds <= 3
    # One assembly for the stiffness of the nodes, one for each build.
    assert scene.stepper._tangent.num_assembled <= 4


def test_petsc_options_change_the_solver_and_not_the_solution(comm):
    ends, iterations = [], []
    for options in ({}, {"pc_type": "jacobi"}, {"ksp_type": "gmres"}):
        scene = scenes.blocks(comm)
        old = scene.stepper
        stepper = type(old)(old.bodies, old.pairs, dt=old.dt, petsc_options=options)
        stepper.v.x.array[:] = old.v.x.array
        for _ in range(8):
            stepper.advance()
        ends.append(stepper.x[: stepper.u.function_space.dofmap.index_map.size_local])
        iterations.append(stepper._solver.num_iterations)
        assert ("single precision" in str(stepper._solver)) == ("pc_type" not in options)
        assert stepper._solver._ksp.getType() == options.get("ksp_type", "fgmres")
    assert iterations[1] > 1.5 * iterations[0]
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], atol=1e-10)


@pytest.mark.parametrize("direct_up_to", [0, 50_000], ids=["multigrid", "factors"])
def test_failing_krylov_method_falls_back_on_stronger_preconditioners(
    comm, monkeypatch, direct_up_to
):
    # One iteration never reaches the tolerance with an incomplete
    # factorisation; what follows must give the same steps.
    monkeypatch.setattr("dolfinx_nts.solvers.preconditioner._DIRECT_UP_TO", direct_up_to)
    reference, limited = scenes.blocks(comm), scenes.blocks(comm)
    for _ in range(8):
        reference.stepper.advance()
    monkeypatch.setattr("dolfinx_nts.solvers.krylov._MAX_ITERATIONS", 1)
    for _ in range(8):
        limited.stepper.advance()
    solver = limited.stepper._solver
    assert solver._preconditioner.is_strong and solver.num_direct > 0
    np.testing.assert_allclose(limited.positions(), reference.positions(), atol=1e-10)


def test_multigrid_with_kept_factors_and_rows_converges_as_with_those_of_petsc(comm, monkeypatch):
    monkeypatch.setattr("dolfinx_nts.solvers.krylov._MOST_CROSSINGS", 0.0)
    monkeypatch.setattr("dolfinx_nts.solvers.preconditioner._DIRECT_UP_TO", 0)
    smoothed, apply = [], preconditioner._Smoother.apply
    multiplied, mult = [], SinglePrecisionOperator.mult

    def counted(self, pc, r, z):
        smoothed.append(pc)
        apply(self, pc, r, z)

    def counted_product(self, matrix, x, y):
        multiplied.append(matrix)
        mult(self, matrix, x, y)

    def run():
        scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
        for _ in range(10):
            scene.stepper.advance()
        solver = scene.stepper._solver
        assert "GAMG" in str(solver) and solver.num_direct == 0
        return scene.positions(), solver.num_iterations

    monkeypatch.setattr(preconditioner._Smoother, "apply", counted)
    monkeypatch.setattr(SinglePrecisionOperator, "mult", counted_product)
    kept, iterations = run()
    # Before and after the coarser levels.
    counts = len(smoothed), len(multiplied)
    assert min(counts) >= 2 * iterations > 0
    of_petsc = property(lambda self: False, lambda self, value: None)
    monkeypatch.setattr(preconditioner.Preconditioner, "_wants_own", of_petsc, raising=False)
    expected, others = run()
    assert (len(smoothed), len(multiplied)) == counts
    # Each run has a partition of its own.
    assert abs(iterations - others) <= 2
    np.testing.assert_allclose(kept, expected, atol=1e-9)


def test_factors_that_do_not_exist_on_one_rank_give_way_to_stronger_ones(comm, monkeypatch, agree):
    reference, singular = scenes.blocks(comm), scenes.blocks(comm)
    reference.stepper.advance()
    factors = singular.stepper._solver._preconditioner
    build = _kernels.IncompleteFactors.factorise

    def factorise(kernel, start, column, value, order):
        lost = value if comm.rank else 0 * value
        return build(kernel, start, column, lost, order)

    monkeypatch.setattr(_kernels.IncompleteFactors, "factorise", factorise)
    singular.stepper.advance()
    assert agree(factors.is_strong and factors.num_builds == 1)
    np.testing.assert_allclose(singular.positions(), reference.positions(), atol=1e-10)


@pytest.mark.serial
def test_rows_of_other_ranks_are_eliminated_next_to_their_neighbours():
    # Neighbours of rows 0 to 5, of which 4 and 5 are another rank's; 6 is outside.
    rows = [[0, 1, 4], [0, 1, 2], [1, 2, 3], [2, 3, 5], [4, 0, 6], [3, 5, 6]]
    start = np.cumsum([0, *map(len, rows)])
    order = block_ilu._order(start, np.concatenate(rows).astype(np.int32), 4)
    np.testing.assert_array_equal(order, [3, 5, 2, 1, 0, 4])


def test_kept_factors_are_those_of_each_rank_and_its_neighbours(comm, rng):
    tangent = scenes.blocks(comm).stepper._tangent
    tangent.assemble_nearby()
    N = tangent.rows.index_map.size_global
    factors = BlockILU(tangent.rows)
    assert factors.build()
    nodes = tangent.rows.matrix.index_map(1)
    here = nodes.local_to_global(np.arange(nodes.size_local + nodes.num_ghosts, dtype=np.int32))
    matrix = tangent.matrix().convert("aij")
    begin, column, value = (
        np.concatenate(a) for a in zip(*comm.allgather(_csr(matrix)), strict=True)
    )
    A = np.zeros((3 * N, 3 * N))
    A[begin, column] = value
    pattern = np.zeros((N, N), dtype=bool)
    pattern[begin // 3, column // 3] = True
    order = here[factors._order]
    n = len(order)
    A = A.reshape(N, 3, N, 3).transpose(0, 2, 1, 3)[np.ix_(order, order)]
    L, U = definition(A, pattern[np.ix_(order, order)])
    r = comm.bcast(rng.normal(size=(N, 3)))
    expected = np.linalg.solve(dense(L) @ dense(U), r[order].ravel()).reshape(-1, 3)
    z = np.full((nodes.size_local, 3), np.nan)
    factors.apply(r[here[: len(z)]], z)
    inside = factors._order < len(z)
    error = np.abs(z[factors._order[inside]] - expected[inside])
    assert np.all(error < rounding(L, U, expected).reshape(n, 3)[inside])


def _csr(matrix):
    """Row, column and value of each entry of this rank."""
    start, column, value = matrix.getValuesCSR()
    first, last = matrix.getOwnershipRange()
    return np.repeat(np.arange(first, last), np.diff(start)), column, value


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
    # The bulk alone needs one iteration a decade; without the patch it is two.
    assert len(counts) > 5 and np.mean(counts) < 1.5
    assert solver.num_direct == 0


def test_patch_is_factorised_again_only_for_other_pairs_or_factors(comm):
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    for _ in range(10):
        scene.stepper.advance()
    preconditioner = scene.stepper._solver._preconditioner
    patch, elimination = preconditioner._patch, preconditioner._operator.elimination
    count = patch.num_builds
    patch.update(elimination, scene.stepper._tangent.num_assembled)
    assert patch.num_builds == count > 0
    patch.update(elimination, scene.stepper._tangent.num_assembled + 1)
    assert patch.num_builds == count + 1


def test_ranks_gather_rows_again_only_for_more_contacts_or_another_matrix(comm, monkeypatch, agree):
    if comm.size == 1:
        pytest.skip("for several ranks")
    scene = scenes.ball_plate(comm, shift=scenes.NO_TIES)
    while scene.stepper.advance().num_active < 5:
        pass
    rows = scene.stepper._tangent.rows
    (pairs,) = scene.stepper._solver._preconditioner._patch._pairs
    fewer = SharedPairs(*(array[:-1] for array in pairs.arrays))
    gathered, gather = [], BlockCSR.gather
    monkeypatch.setattr(BlockCSR, "gather", lambda *args: gathered.append(1) or gather(*args))
    domain = OverlappingSubdomain(rows)
    history = [(fewer, 1, 1), (pairs, 1, 2), (pairs, 1, 2), (pairs, 2, 3), (fewer, 2, 3)]
    for some, version, count in history:
        domain.build([some], version)
        assert len(gathered) == count
    # What there is more than needed changes nothing.
    exact = OverlappingSubdomain(rows)
    exact.build([fewer], 2)
    r, z = np.random.default_rng(comm.rank).random((2, rows.index_map.size_local, 3))
    expected = z.copy()
    exact.correct(r, expected)
    domain.correct(r, z)
    assert agree(np.array_equal(z, expected))


def test_each_rank_solves_for_the_pairs_of_its_nodes_and_of_their_neighbours(
    comm, monkeypatch, agree
):
    if comm.size == 1:
        pytest.skip("for several ranks")

    def slabs(middle):  # the borders between ranks cross the contact
        return np.argsort(np.argsort(middle[:, 0])) * comm.size // len(middle)

    given, local = {}, SharedPairs.local

    def taken(self, dofs):
        given[comm.rank] = self.nodes
        return local(self, dofs)

    monkeypatch.setattr(SharedPairs, "local", taken)
    scene = scenes.blocks(comm, owner=slabs)
    while scene.stepper.advance().num_active < 5:
        pass
    (own,) = scene.stepper._solver._preconditioner._patch._pairs
    pairs = np.concatenate(comm.allgather(own.nodes))
    rows = scene.stepper._tangent.rows
    near = rows.matrix.index_map(1).local_to_global(rows.column)
    expected = pairs[np.isin(pairs, near).any(axis=1)]
    assert agree(np.array_equal(given[comm.rank], expected[np.argsort(expected[:, 0])]))
    first, last = rows.index_map.local_range
    touching = ((first <= pairs) & (pairs < last)).any(axis=1)
    assert not agree(touching.sum() == len(expected))


def test_waves_cross_more_cells_than_there_are_where_there_is_no_inertia(comm, monkeypatch):
    solver = scenes.blocks(comm, nts.QuasiStatic).stepper._solver
    stiffness = np.full_like(solver.tangent.nodal_stiffness(), 1e9)
    stiffness[:1] = 0.0
    monkeypatch.setattr(solver.tangent, "nodal_stiffness", lambda: stiffness)
    with np.errstate(all="raise"):
        assert solver._wave_crossings() > 1e9


def test_a_step_that_made_strong_factors_leaves_none_of_their_options(comm, agree):
    # PETSc keeps options by name: those of MUMPS do not fit an incomplete factorisation.
    stepper = scenes.blocks(comm).stepper
    stepper.advance()
    before = Snapshot()
    stepper.serialize(before)
    factors = stepper._solver._preconditioner
    kind = str(factors)
    factors.strengthen()
    factors.build()
    assert agree(factors.is_strong and str(factors) != kind)
    stepper.serialize(before.rewind())
    assert agree(not factors.is_strong and str(factors) == kind)
    stepper.advance()
