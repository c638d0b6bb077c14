"""Start of a scene from the state of another scene."""

import logging

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.io import checkpoint
from helpers.once import once
from helpers.scene import gathered
from helpers.scenes import BLOCK_STEP, blocks

pytestmark = pytest.mark.at_most_two_ranks

BREAK, NUM_STEPS = 4, 8
# Tolerance relative to lengths of about one: the starts of Newton's method differ.
TOLERANCE = 1e-9


@pytest.fixture
def path(comm, tmp_path):
    """Return one checkpoint for all ranks."""
    return comm.bcast(tmp_path) / "run.h5"


def new(comm, enforcement=None, friction=None, scheme=nts.EnergyMomentum, force=None, floor=None):
    """Return a stepper of two blocks that collide, or fall on a floor; perhaps with a force."""
    old = blocks(comm).stepper
    (pair,) = old.pairs
    law = enforcement or nts.LagrangeMultiplier()
    pairs = [
        nts.ContactPair(pair.nodes, floor or pair.segments, law, friction, method="node-to-segment")
    ]
    loads = [] if force is None else [nts.BodyForce(old.bodies[1], force)]
    stepper = scheme(old.bodies, pairs, dt=BLOCK_STEP, loads=loads)
    if scheme is not nts.QuasiStatic:
        stepper.v.x.array[:] = old.v.x.array
    return stepper


def positions(stepper):
    return gathered(stepper.u.function_space, stepper.x)


@pytest.mark.parametrize(
    ("enforcement", "friction"),
    [
        once(None, None),
        (None, nts.Coulomb(0.3)),
        once(nts.Penalty(eps_N=1e3), nts.Coulomb(0.3, eps_T=200.0)),
    ],
    ids=["multipliers", "friction", "springs"],
)
def test_a_load_that_begins_in_a_second_scene_acts_as_in_one(comm, path, enforcement, friction):
    def force(t):
        return (0.0, 5.0 * (t > BREAK * BLOCK_STEP), -8.0 * (t > BREAK * BLOCK_STEP))

    whole = new(comm, enforcement, friction, force=force)
    first = new(comm, enforcement, friction)
    for _ in range(NUM_STEPS):
        whole.advance()
    active = [first.advance().num_active for _ in range(BREAK)]
    checkpoint.save(path, first)
    second = new(comm, enforcement, friction, force=force)
    assert nts.load_state(path, second) == ("state of the linear solver",)
    assert (second.t, second.step) == (first.t, BREAK) and active[-1] > 0
    before, after = (nts.Diagnostics(s).balance() for s in (first, second))
    assert after.total_energy == pytest.approx(before.total_energy, rel=1e-14)
    for _ in range(NUM_STEPS - BREAK):
        second.advance()
    assert np.abs(positions(second) - positions(whole)).max() < TOLERANCE


def test_data_dropped_by_other_laws_and_integrators_are_reported(comm, path, caplog):
    first = new(comm, friction=nts.Coulomb(0.3))
    for _ in range(BREAK):
        first.advance()
    checkpoint.save(path, first)
    name = "surface_3_surface_2"
    other = "contact of pair 1 of the checkpoint, which this scene lacks"
    laws = (
        "the laws are LagrangeMultiplier(impact=elastic, e=1.0), Coulomb(mu=0.3, eps_T=None, "
        "law=objective) in the checkpoint and Penalty(eps_N=None, share=1.0), none here, so that "
        "the contact force begins at zero and loaded bodies start to move; give the pair the same "
        "enforcement in both scenes to keep it"
    )
    plane = nts.RigidPlane((0, 0, -9), (0, 0, 1))
    sticks = nts.Coulomb(0.3)
    for options, dropped in (
        ({"enforcement": nts.LagrangeMultiplier("plastic"), "friction": nts.Coulomb(0.1)}, []),
        ({}, [f"friction of {name}, which begins without history"]),
        ({"enforcement": nts.Penalty()}, [f"contact of {name}: {laws}"]),
        (
            {"floor": plane},
            ["contact of surface_3_rigid_plane, which begins without history", other],
        ),
        (
            {"scheme": nts.QuasiStatic, "friction": sticks},
            ["velocities, which QuasiStatic does not have"],
        ),
    ):
        stepper = new(comm, **options)
        with caplog.at_level(logging.INFO, logger="dolfinx_nts"):
            assert list(nts.load_state(path, stepper)) == ["state of the linear solver", *dropped]
        messages = [m for m in caplog.messages if "run.h5 was loaded at t = 0.08; not used: " in m]
        assert len(messages) == (comm.rank == 0)
        warns = any(m.endswith(f"contact of {name}: {laws}") for m in caplog.messages)
        assert warns == ("enforcement" in options and bool(dropped) and comm.rank == 0)
        lacks = any("surface_3_rigid_plane begins without history" in m for m in caplog.messages)
        assert lacks == ("floor" in options and comm.rank == 0)
        caplog.clear()
        history = stepper.contacts[0].history
        is_lost = bool(dropped) and dropped[0].startswith("contact")
        assert (comm.allreduce(history.active.sum()) > 0) == (not is_lost)
        slips = comm.allreduce(np.abs(history.traction).sum(), op=MPI.SUM) > 0
        assert slips == ("friction" in options)
        assert np.allclose(stepper.x, first.x)
        assert stepper.v.x.array.any() == ("scheme" not in options)
        if "scheme" not in options:
            stepper.advance()


@pytest.mark.parametrize("impact", ["plastic", once("elastic")])
def test_energy_gain_of_plastic_impact_from_an_overlap_is_reported(comm, path, caplog, impact):
    first = new(comm, nts.Penalty(eps_N=1.0))
    for _ in range(BREAK + 1):
        first.advance()
    checkpoint.save(path, first)
    stepper = new(comm, nts.LagrangeMultiplier(impact))
    nts.load_state(path, stepper)
    energies = [nts.Diagnostics(stepper).balance().total_energy]
    with caplog.at_level(logging.WARNING, logger="dolfinx_nts"):
        stepper.advance()
    energies.append(nts.Diagnostics(stepper).balance().total_energy)
    messages = [
        m for m in caplog.messages if f"LagrangeMultiplier(impact='{impact}') has given" in m
    ]
    gains = energies[1] > 2 * energies[0]
    assert gains == (impact == "plastic")
    assert len(messages) == (gains and comm.rank == 0)


def test_another_mesh_is_refused_and_nothing_changes(comm, path, refused):
    first = new(comm)
    first.advance()
    checkpoint.save(path, first)
    stepper = blocks(comm, num_bodies=3).stepper
    with refused(ValueError, "expected a checkpoint of this mesh, nodes and cells"):
        nts.load_state(path, stepper)
    text = "expected a checkpoint, given .*none.h5, where there is no file; .*checkpoint_every"
    with refused(ValueError, text):
        nts.load_state(path.with_name("none.h5"), stepper)
    assert stepper.t == 0 and not stepper.u.x.array.any()


@pytest.mark.serial
def test_wrong_arguments_are_named(comm, path, refused):
    stepper = new(comm)
    text = r"expected load_state\(path, stepper\), .*, given {} and {}"
    for wrong, kinds in (
        ((stepper, path), ("EnergyMomentum", "PosixPath")),
        ((path, nts.EnergyMomentum), ("PosixPath", "the class EnergyMomentum")),
        ((None, stepper), ("NoneType", "EnergyMomentum")),
    ):
        with refused(TypeError, text.format(*kinds)):
            nts.load_state(*wrong)
