"""Runs that end with a condition: the step in which it holds is the last one."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.meshing.gmsh import read_mesh
from helpers.scenes import blocks


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("control", [None, nts.StepControl()])
def test_a_function_ends_the_run_with_the_step_for_which_it_holds(comm, control):
    stepper = blocks(comm).stepper
    steps = list(stepper.run(until=lambda step: step.step == 3, control=control))
    assert [step.step for step in steps] == [1, 2, 3] and stepper.step == 3


@pytest.mark.at_most_two_ranks
def test_a_condition_that_holds_on_one_rank_ends_the_run_on_all(comm):
    stepper = blocks(comm).stepper
    last = comm.size - 1
    steps = list(stepper.run(until=lambda step: comm.rank == last and step.step == 2))
    assert len(steps) == 2


@pytest.mark.at_most_two_ranks
def test_a_contact_force_ends_the_run_with_the_first_step_that_reaches_it(comm):
    def forces(until):
        stepper = blocks(comm).stepper
        diagnostics, found = nts.Diagnostics(stepper), []
        for _ in stepper.run(until=until(stepper)):
            found.append(float(np.linalg.norm(diagnostics.contact_force())))
        return found

    every = forces(lambda stepper: 20 * stepper.dt)
    least = 0.999 * max(every)
    found = forces(lambda stepper: nts.ContactForce(stepper.pairs[0], at_least=least))
    assert 0 < least and found == every[: len(found)]
    assert found[-1] >= least and all(force < least for force in found[:-1])


@pytest.mark.at_most_two_ranks
def test_of_several_ends_the_first_one_counts(comm):
    stepper = blocks(comm).stepper
    dt = stepper.dt
    assert len(list(stepper.run(until=[2 * dt, lambda step: False]))) == 2
    assert len(list(stepper.run(until=[9 * dt, lambda step: True]))) == 1


@pytest.mark.serial
def test_wrong_ends_are_refused():
    stepper = blocks(MPI.COMM_SELF).stepper
    for until, error, match in (
        ("later", TypeError, "until"),
        ([], ValueError, "given an empty list"),
        (-1.0, ValueError, "until >= 0"),
        ([1.0, None], TypeError, "until"),
    ):
        with pytest.raises(error, match=match):
            stepper.run(until=until)
    other = blocks(MPI.COMM_SELF).stepper
    force = nts.ContactForce(other.pairs[0], at_least=1.0)
    with pytest.raises(ValueError, match="expected a pair of this stepper, given"):
        list(stepper.run(until=[stepper.dt, force]))
    with pytest.raises(TypeError, match="expected a ContactPair for a ContactForce"):
        nts.ContactForce(stepper, at_least=1.0)


@pytest.mark.serial
def test_an_error_in_a_condition_ends_the_run():
    stepper = blocks(MPI.COMM_SELF).stepper
    with pytest.raises(ZeroDivisionError):
        list(stepper.run(until=lambda step: 1 / 0))


@pytest.mark.serial
def test_unknown_names_are_answered_by_similar_ones(tmp_path):
    tag = read_mesh(nts.examples.ball_plate(), MPI.COMM_SELF).tag
    with pytest.raises(ValueError, match="given 'bal_outer': did you mean 'ball_outer'"):
        tag["bal_outer"]
    stepper = blocks(MPI.COMM_SELF).stepper
    with pytest.raises(ValueError, match=r"given \['pair'\]: did you mean 'pairs'"):
        nts.Recorder(tmp_path / "run", stepper, columns_of=["pair"])
    with nts.Recorder(tmp_path / "run", stepper) as record:
        record.write(stepper.advance())
    with pytest.raises(ValueError, match=r"\['contact_forcez'\]: did you mean .*contact_force_z"):
        nts.plotting.force_displacement(tmp_path / "run.csv", "min_gap", "contact_forcez")
