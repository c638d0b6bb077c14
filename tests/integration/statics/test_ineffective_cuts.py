"""Steps that fail at any length end a run soon; others are cut as often as necessary."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.integrators.stagnation import IneffectiveCuts
from dolfinx_nts.solvers.newton_report import NewtonReport

pytestmark = pytest.mark.serial

DT = 0.01  # s


def block(scheme, path, *, moved="top", floor=()):
    """A block of 1 m in the plane, with a prescribed motion of one side [m]."""

    def build(model):
        parts.add_rectangle(model, "block", corner=(0, 0), size=(1, 1), cells=(2, 2))

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    body = nts.Body(V, cells, tag["block"], nts.NeoHookean(1e5, 0.3, 1e3))
    place = fem.Constant(mesh, np.zeros(2))

    def update(t):
        place.value[:] = 0, -path(t)

    sides = {
        side: fem.locate_dofs_topological(V, 1, facets.find(tag[f"block_{side}"]))
        for side in ("bottom", "top")
    }
    bcs = [fem.dirichletbc(place, sides.pop(moved), V)]
    if not floor:
        bcs += [fem.dirichletbc(np.zeros(2), dofs, V) for dofs in sides.values()]
    pairs = [
        nts.ContactPair(
            nts.boundary_of(body),
            each,
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        for each in floor
    ]
    return scheme([body], pairs, dt=DT, bcs=bcs, update=update)


def failed(stepper, control):
    """Run until the run fails; returns the error and the number of attempts at steps."""
    attempts, advance = [], stepper.advance
    stepper.advance = lambda: attempts.append(stepper.dt) or advance()
    with pytest.raises(nts.ConvergenceError) as raised:
        list(stepper.run(10 * DT, control))
    return str(raised.value), len(attempts)


@pytest.mark.parametrize("scheme", [nts.QuasiStatic, nts.EnergyMomentum])
def test_a_side_that_jumps_through_the_other_one_ends_the_run_soon(scheme):
    stepper = block(scheme, lambda t: 1.5 * (t > 0))
    text, attempts = failed(stepper, nts.StepControl())
    assert text.startswith("the step fails however short it is: the residual at its start")
    assert "in 5 halvings" in text
    # In statics bodies may go far in the end.
    assert attempts == 6 + (scheme is nts.QuasiStatic)


def test_smallest_step_of_the_user_allows_more_cuts():
    stepper = block(nts.EnergyMomentum, lambda t: 1.5 * (t > 0))
    text, attempts = failed(stepper, nts.StepControl(smallest=DT / 2**8))
    assert "half of which is less than the smallest step" in text
    assert attempts == 9


@pytest.mark.parametrize("scheme", [nts.QuasiStatic, nts.EnergyMomentum])
def test_nodes_prescribed_into_a_floor_end_the_run_soon(scheme):
    floor = nts.RigidPlane((0, -0.0301), (0, 1))
    stepper = block(scheme, lambda t: 4.0 * t, moved="bottom", floor=[floor])
    text, attempts = failed(stepper, nts.StepControl())
    assert text.startswith("the step fails however short it is: prescribed displacements move")
    assert attempts < 15
    assert abs(stepper.x[:, 1].min() + 0.0301) < 4.0 * DT


def test_large_prescribed_displacement_is_cut_as_often_as_necessary():
    """A step of 48 m would move the top through the other side 48 times."""
    stepper = block(nts.QuasiStatic, lambda t: 4800.0 * t)
    step = next(stepper.run(10 * DT, nts.StepControl()))
    assert step.rejected > 5


def reports(*norms):
    """Reports of Newton's method from several starting guesses, with these residuals."""
    return [NewtonReport(len(each), 0, each, 0, "no convergence") for each in norms]


@pytest.mark.parametrize(
    ("inertia", "power", "is_ineffective"),
    [
        (False, 0, True),
        (False, -1, False),
        # Forces of elasticity and of impacts.
        (True, 0, False),
        (True, 1, False),
        (True, 2, True),
    ],
)
def test_first_residuals_show_whether_the_length_matters(inertia, power, is_ineffective):
    ineffective = IneffectiveCuts(inertia=inertia)
    for cuts in range(9):
        assert ineffective.are_certain == (is_ineffective and cuts > 5)
        start = 3.0 * 2.0 ** (power * cuts)
        ineffective.fail(reports((start, 5.0, 2.0), (2 * start, 1.0)), DT / 2**cuts, cuts)
    ineffective.accept()
    assert not ineffective.are_certain


def test_different_last_residuals_are_different_failures():
    ineffective = IneffectiveCuts(inertia=False)
    for cuts in range(9):
        ineffective.fail(reports((3.0, 2.0**-cuts)), DT / 2**cuts, cuts)
    assert not ineffective.are_certain
