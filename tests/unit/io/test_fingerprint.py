"""Fingerprints of scenes: changes that alter them, and changes that do not."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.io import fingerprint as module
from dolfinx_nts.io.fingerprint import fingerprint
from helpers.scene import Motion
from helpers.scenes import BLOCK_RUBBER, BLOCK_STEP, blocks, of_material, rotation

pytestmark = pytest.mark.at_most_two_ranks


def other_bodies(stepper, **options):
    """The same cells of another material."""
    E, nu, rho = BLOCK_RUBBER
    material = nts.SaintVenantKirchhoff(E=E, nu=nu, rho=rho, one_point=(), **options)
    bodies = [of_material(body, material) for body in stepper.bodies]
    return nts.EnergyMomentum(bodies, stepper.pairs, dt=BLOCK_STEP)


def other_pairs(stepper, enforcement=None, friction=None, turned=False):
    """The same surfaces with other laws, or nodes and segments exchanged."""
    (pair,) = stepper.pairs
    sides = (pair.segments, pair.nodes) if turned else (pair.nodes, pair.segments)
    laws = enforcement or nts.LagrangeMultiplier(), friction, pair.method
    return nts.EnergyMomentum(stepper.bodies, [nts.ContactPair(*sides, *laws)], dt=BLOCK_STEP)


def test_fingerprint_does_not_depend_on_the_ranks(comm):
    mine = fingerprint(blocks(comm).stepper)
    assert comm.allgather(mine) == [mine] * comm.size
    assert fingerprint(blocks(MPI.COMM_SELF).stepper) == mine


def test_digest_of_an_energy_is_cached(comm, monkeypatch):
    """Every checkpoint of a run needs the fingerprint, which is the same each time."""
    calls, make = [], module.bulk_form
    monkeypatch.setattr(module, "bulk_form", lambda *given: calls.append(given) or make(*given))
    stepper = blocks(comm).stepper
    before = fingerprint(stepper)
    assert len(calls) == 1  # of the one material of both blocks
    assert fingerprint(stepper) == before
    assert len(calls) == 1


def test_state_and_step_do_not_matter(comm):
    scene = blocks(comm)
    before = fingerprint(scene.stepper)
    scene.run(3)
    assert fingerprint(scene.stepper) == before
    assert fingerprint(blocks(comm, dt=BLOCK_STEP / 2).stepper) == before


MOVED = Motion(rotation([1, 2, 3], 0.1), np.zeros(3))


@pytest.mark.parametrize(
    ("change", "names"),
    [
        (lambda comm, s: other_bodies(s), set()),
        (lambda comm, s: other_pairs(s), set()),
        (lambda comm, s: other_bodies(s, mass_damping=1e-9), {"body 1", "body 2"}),
        (lambda comm, s: other_pairs(s, nts.LagrangeMultiplier("plastic")), {"laws of pair 1"}),
        (lambda comm, s: other_pairs(s, None, nts.Coulomb(0.3)), {"laws of pair 1"}),
        (lambda comm, s: other_pairs(s, nts.Penalty(), nts.Coulomb(0.3)), {"laws of pair 1"}),
        (lambda comm, s: other_pairs(s, turned=True), {"pair 1"}),
        (lambda comm, s: blocks(comm, nts.Midpoint).stepper, {"integrator"}),
        (lambda comm, s: blocks(comm, motion=MOVED).stepper, {"mesh"}),
    ],
    ids="same-bodies same-pairs damping impact friction penalty turned scheme mesh".split(),
)
def test_differences_are_named(comm, change, names):
    stepper = blocks(comm).stepper
    one, other = fingerprint(stepper), fingerprint(change(comm, stepper))
    assert {name for name in one | other if one.get(name) != other.get(name)} == names
