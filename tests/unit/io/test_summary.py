"""Summary of a run, printed at its end."""

import re
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.verified import numbers


def pressed_block(comm: MPI.Comm) -> nts.QuasiStatic:
    """A block on a floor, whose upper side goes down by 0.1 m."""

    def build(model: Any) -> None:
        nts.parts.add_rectangle(model, "block", corner=(0, 0), size=(2, 1), cells=(2, 1))

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(E=1e3, nu=0.3, rho=1.0))
    top = fem.locate_dofs_topological(V, 1, facets.find(tag["block_top"]))
    value = fem.Constant(mesh, np.array([0.0, -0.1]))
    floor = nts.RigidPlane((0, 0), (0, 1), name="floor")
    bottom = nts.Surface(V, facets, tag["block_bottom"])
    pair = nts.ContactPair(
        bottom, floor, name="sole", enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    return nts.QuasiStatic([block], [pair], dt=1.0, bcs=[fem.dirichletbc(value, top, V)])


@pytest.mark.at_most_two_ranks
def test_statics_reports_forces_pressures_and_displacements(comm, tmp_path):
    stepper = pressed_block(comm)
    with nts.Recorder(comm.bcast(tmp_path / "run"), stepper) as record:
        for step in stepper.run(until=1.0):
            record.write(step)
    lines = dict(line.split(": ", 1) for line in record.summary().splitlines() if ": " in line)
    assert not {"total energy", "linear momentum", "angular momentum"} & lines.keys()
    assert numbers(lines["largest displacement"])[0] == pytest.approx(0.1, rel=0.2)
    *force, pressure = numbers(lines["contact force of pair sole"])
    reaction = numbers(lines["reaction of support 1"])
    assert force[1] == pytest.approx(-reaction[1], rel=1e-3) and force[1] > 0
    assert force[1] / 2 <= pressure * 1.001  # on an area of 2 m^2
    # Half of force times displacement, but for the curve between them.
    (energy,) = numbers(lines["strain energy"])
    assert energy == pytest.approx(force[1] * 0.1 / 2, rel=0.1)
    assert "energy of contact springs" not in lines and "Newton iterations" in record.summary()


@pytest.mark.serial
def test_phases_without_time_are_left_out(comm, tmp_path):
    stepper = pressed_block(comm)
    with nts.Recorder(tmp_path / "run", stepper) as record:
        pass
    (time,) = re.findall(r"wall time: .*", record.summary())
    assert not re.search(r"[a-z] 0\.0\b", time)
