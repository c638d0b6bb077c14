"""External work in statics equals the strain energy, to second order in the increment."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.diagnostics.balance import Diagnostics
from helpers.models.plane import RUBBER, blocks, turning
from helpers.once import once_except

pytestmark = pytest.mark.at_most_two_ranks

DEPTH, ANGLE, PRESSURE = 0.12, 0.05, 1.0e4  # m, rad, Pa
TOP = np.array([0.05, 1.02])  # m, middle of the upper side of the upper block


def pressed(drive, dt):
    """Stepper of two blocks without friction; the upper one is pressed down until t = 1 s."""
    motion = nts.Motion(lambda t: (0.0, -DEPTH * t), lambda t: ANGLE * t, tuple(TOP))
    is_guided = drive == "guide"
    guide = nts.Guide(motion=motion) if is_guided else None
    scene = blocks(rigid=is_guided, guide=guide, material=nts.NeoHookean(**RUBBER))
    V, bodies = scene.V, [scene.lower, scene.upper]
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -0.5))
    bcs, loads, update = [fem.dirichletbc(np.zeros(2), bottom, V)], [], None
    pairs = [nts.ContactPair(scene.nodes, scene.segments)]
    top = nts.Surface.where(V, lambda x: np.isclose(x[1], TOP[1]))
    if drive == "support":
        u = fem.Function(V)
        bcs.append(fem.dirichletbc(u, fem.locate_dofs_geometrical(V, lambda x: x[1] > 1.01)))

        def update(t):
            def displacement(x):
                arm = x[:2] - TOP[:, None]
                return turning(ANGLE * t) @ arm - arm - np.array([[0.0], [DEPTH * t]])

            u.interpolate(displacement)
    elif not is_guided:
        left = (V.sub(0), V.sub(0).collapse()[0])
        dofs = fem.locate_dofs_geometrical(left, lambda x: np.isclose(x[0], -0.45))[0]
        bcs.append(fem.dirichletbc(np.float64(0), dofs, V.sub(0)))
        if drive == "load":
            loads.append(nts.Pressure(top, lambda t: PRESSURE * t))
        else:
            plane = nts.RigidPlane(tuple(TOP), (0.0, -1.0)).moving(motion)
            pairs.append(nts.ContactPair(top, plane))
    stepper = nts.QuasiStatic(bodies, pairs, dt=dt, bcs=bcs, loads=loads, update=update)
    if drive == "load":  # begins in touch: no equilibrium on the way through the gap
        stepper.set_displacement(scene.upper, (0.0, -0.02))
    return stepper


def missing(drive, num):
    """Strain energy minus external work over the strain energy [-], after a number of steps."""
    stepper = pressed(drive, 1 / num)
    diagnostics, outside, ledger = Diagnostics(stepper), 0.0, 0.0
    for step in stepper.run(until=1.0):
        outside += step.load_work + step.support_work + step.contact_work.obstacles
        ledger += step.load_work + step.support_work + step.solver_work
        ledger += sum(step.contact_work) + diagnostics.bulk_defect()
    energy = diagnostics.strain_energy()
    assert stepper.step == num
    assert ledger == pytest.approx(energy, rel=1e-8)
    return (energy - outside) / energy


@pytest.mark.parametrize(
    "drive", once_except(["support", "load", "obstacle", "guide"], "support", "obstacle")
)
def test_external_work_is_of_second_order_in_the_increment(drive):
    few, many = (missing(drive, num) for num in (8, 16))
    assert abs(many) < 0.01
    assert abs(few) > 3.0 * abs(many)


def test_a_resumed_run_has_the_works_of_the_whole_one(folder, agree):
    def last_row(name, *ends):
        for end in ends:
            stepper = pressed("support", 0.25)
            with nts.Recorder(folder / name, stepper, checkpoint_every=1, resume=True) as record:
                for step in stepper.run(until=end):
                    record.write(step)
        return np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True)[-1]

    whole, parts = last_row("whole", 1.0), last_row("parts", 0.5, 1.0)
    assert agree(whole["external_work"] > 0)
    assert agree(parts["external_work"] == whole["external_work"])
    assert agree(parts["energy_unaccounted"] == whole["energy_unaccounted"])
