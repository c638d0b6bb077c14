"""Counts of the linear solver, against counted calls."""

from collections import Counter
from dataclasses import replace

import pytest

from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.linear.active_sets import ActiveSets
from dolfinx_nts.solvers.linear.projected_krylov import KrylovMethod, Operator
from dolfinx_nts.solvers.linear.saddle_point import SaddlePointSystem
from dolfinx_nts.solvers.precond.contact_schwarz import ContactSchwarz
from dolfinx_nts.solvers.precond.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.precond.tangent import Tangent
from helpers import scenes

pytestmark = pytest.mark.at_most_two_ranks

COUNTED = {
    "num_residuals": (Bulk, "forces"),
    "num_actions": (Bulk, "action"),
    "num_tangents": (Tangent, "_assemble"),
    "num_builds": (BulkPreconditioner, "build"),
    "num_schwarz_builds": (ContactSchwarz, "_build"),
    "num_direct": (SaddlePointSystem, "solve"),
}


@pytest.mark.parametrize("direct", [False, True])
def test_counts_agree_with_the_calls(comm, monkeypatch, direct):
    calls = Counter()

    def count(name, owner, method):
        function = getattr(owner, method)

        def counted(*args, **named):
            calls[name] += 1
            return function(*args, **named)

        monkeypatch.setattr(owner, method, counted)

    for name, (owner, method) in COUNTED.items():
        count(name, owner, method)
    count("num_actions", Bulk, "rounded_action")
    count("products", Operator, "act")
    count("rough", KrylovMethod, "precondition_once")
    if direct:
        monkeypatch.setattr(ActiveSets, "are_coupled", lambda *_: True)
    scene = scenes.blocks(comm)
    solver = scene.stepper._solver
    assert str(solver.statistics) == "not used so far"
    scene.run(8)
    work = solver.statistics
    assert {name: getattr(work, name) for name in COUNTED} == {n: calls[n] for n in COUNTED}
    # With one product for each iteration, GMRES needs no explicit residual. Approximate increments
    # apply the preconditioner only.
    num_products = calls["products"] + calls["rough"]
    assert num_products == work.num_iterations + work.num_local_iterations
    assert (work.num_direct > 0, work.num_iterations > 0) == (direct, not direct)
    cells = scene.stepper.u.function_space.mesh.topology.index_map(3)
    assert comm.allreduce(work.num_cells) == cells.size_global
    line = str(work)
    if direct:
        assert line == f"factorisations: complete systems {work.num_direct}"
    else:
        counts = f"{work.num_iterations} iterations; factorisations: bulk {work.num_builds}"
        assert counts in line
        assert work.preconditioner in line and 0.5 < work.wave_crossings < 2


def test_a_courant_number_of_zero_is_left_out(comm):
    stepper = scenes.blocks(comm).stepper
    stepper.advance()
    solver = stepper.statistics.solver
    assert "Courant number" in str(solver)
    resumed = str(replace(solver, wave_crossings=0.0))
    assert "Courant number" not in resumed and f"  {solver.num_iterations} iterations" in resumed
