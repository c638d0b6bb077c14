"""Typical wrong arguments of beginners: the message suggests a remedy."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_rectangle

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting
from helpers.scenes import blocks

pytestmark = pytest.mark.serial

RUBBER = {"E": 1e5, "nu": 0.4, "rho": 1e3}  # Pa, -, kg/m^3
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
BOX = {"corner": (0, 0, 0), "size": (1, 1, 1), "cells": (1, 1, 1)}
FIBRES = {"mu": 1e4, "kappa": 1e5, "k1": 1e3, "k2": 1.0, "rho": 1e3}


@pytest.fixture(scope="module")
def stepper():
    return blocks(MPI.COMM_SELF).stepper


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Working directory with a file that is no table of a run, and a table without rows."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    (tmp_path / "empty.csv").write_text("")
    return tmp_path


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: nts.NeoHookean(**RUBBER, damping=2.0),
            r"no options but mass_damping, .*'damping'",
        ),
        (lambda: nts.Hyperelastic(lambda C, mu: mu * ufl.tr(C), rho=1.0), r"parameters \['mu'\]"),
        (lambda: nts.HolzapfelGasserOgden(**FIBRES, fibres=(1, 0, 0)), r"as in fibres=\[\(1, 0"),
        (lambda: nts.Penalty(1e5, 1e5), r"expected Penalty\(eps_N\), given Penalty\(float, float"),
        (lambda: nts.StepControl(1e-4), r"expected StepControl\(\*, smallest, gap_tol, times\)"),
        (lambda: nts.StepControl(times=0.5), r"list of times, such as \[0.1, 0.2\], given 0.5"),
        (lambda: nts.StepControl(times=["a"]), "real numbers for times, given"),
        (lambda: nts.RigidSphere((0, 0, 0), "1"), "a number for a radius, given '1'"),
        (lambda: nts.RigidSphere(1.0, (0, 0, 0)), "three finite numbers for centre, given 1.0"),
        (lambda: nts.RigidCone((0, 0), 70), r"in radians, such as np.radians\(70\), given 70"),
        (lambda: nts.RigidCone((0, 0), "70"), r"a number for a half_angle \[rad\], given '70'"),
        (lambda: nts.RigidSurface(TRIANGLE, [[0, 1, 3]], (0, 0, 1)), "from 0 to 2, given 0 to 3"),
        (lambda: nts.RigidSurface(TRIANGLE, [[0.0, 1.0, 2.0]], (0, 0, 1)), "given float64"),
        (lambda: nts.RigidSurface(TRIANGLE, [[0, 1, 1]], (0, 0, 1)), "given 1 other facets"),
        (lambda: parts.add_box(None, "a", **BOX | {"cells": 4}), "3 numbers for cells, given 4"),
        (lambda: parts.add_box(None, "a", **BOX | {"corner": (0, 0)}), "3 numbers for corner"),
        (lambda: parts.add_rectangle(None, "a", **BOX), r"2 numbers for corner, given \(0, 0, 0\)"),
        (lambda: nts.read_mesh("a.msh", None), "such as MPI.COMM_WORLD, given NoneType"),
        (lambda: nts.axisymmetric("mesh"), "expected a mesh, given str"),
        (lambda: plotting.energies(3), "CSV file of a Recorder, such as 'run.csv', given int"),
        (
            lambda: plotting.energies("other.csv"),
            "given other.csv, which has no column total_energy",
        ),
        (lambda: plotting.ledger("empty.csv"), "a table with rows, given empty.csv"),
        (lambda: plotting.energy_error({}), "tables by the labels of their curves, given none"),
        (lambda: plotting.animate("other.csv", "a.gif"), ".vtkhdf or .xdmf file of a Recorder"),
        (lambda: plotting.animate("a.xdmf", "a.gif"), "given a.xdmf, which does not exist"),
    ],
)
def test_argument_of_a_part_is_refused(call, message, folder):
    with pytest.raises((TypeError, ValueError, OSError), match=message):
        call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: nts.Surface.where(s.bodies[0].V, 3), "such as lambda x: .*, given 3"),
        (
            lambda s: nts.boundary_of(s.bodies[0], where=lambda x: x[:, 2] > 0),
            r"positions x of shape \(3, \d+\), such as x\[2\] < 0.1, given shape \(3,\)",
        ),
        (lambda s: nts.ContactPair(*s.bodies), r"such as boundary_of\(body\), given Body"),
        (
            lambda s: nts.ContactPair(
                s.pairs[0].nodes,
                s.bodies[0],
                enforcement=nts.LagrangeMultiplier(),
                method="node-to-segment",
            ),
            r"boundary_of\(body\), or an",
        ),
        (lambda s: s.run(1.0, nts.StepControl), r"StepControl\(\) as control, given the class"),
        (
            lambda s: nts.Diagnostics(s).centre_of_mass("a"),
            "one of the bodies given to the stepper",
        ),
        (lambda s: nts.Recorder("run.csv", s).__enter__(), "omit .csv"),
        (lambda s: nts.Recorder("run", s, every=1.5), "an integer for every, given 1.5"),
        (lambda s: nts.Recorder("run", s, every=0), "expected every >= 1, given 0"),
        (lambda s: nts.Recorder("run", s, checkpoint_every=0), "expected checkpoint_every >= 1"),
        (lambda s: nts.Recorder("run", s, times=0.1), "a list of times"),
        (lambda s: nts.Recorder("run", s, columns_of="pairs"), "columns_of, given 'pairs'"),
        (lambda s: nts.Recorder("run", s, own_columns={"a": 3}), r"own_columns\['a'\], given 3"),
        (lambda s: nts.Recorder("run", s, own_fields=[3]), "own_fields as a dict .* given list"),
        (lambda s: plotting.snapshot(s.bodies[0]), "a stepper, whose state is drawn, given Body"),
        (lambda s: plotting.snapshot(s, limits=3), r"limits \(low, high\) .*, given 3"),
        (lambda s: plotting.snapshot(s, limits=(1, 0)), "with low < high"),
        (lambda s: plotting.snapshot(s, camera="x"), "real numbers for camera, given 'x'"),
        (lambda s: plotting.snapshot(s, cut=(0, 0, 0)), "a direction for cut"),
        (lambda s: plotting.snapshot(s, cut=(1, 0)), "three finite numbers for cut"),
        (lambda s: plotting.contact(s, pair=3), "one of 1 pairs, from 0, given 3"),
        (lambda s: plotting.contact(s, pair=s.pairs[0]), "the number of a pair, .* ContactPair"),
    ],
)
def test_argument_with_a_stepper_is_refused(call, message, stepper, folder):
    with pytest.raises((TypeError, ValueError, IndexError), match=message):
        call(stepper)


def test_field_of_another_mesh_is_refused(comm, stepper, folder):
    other = fem.Function(
        fem.functionspace(create_rectangle(comm, [(0, 0), (1, 1)], [1, 1]), ("P", 1))
    )
    with (
        nts.Recorder("run", stepper, own_fields={"a": lambda s: np.zeros(len(s.node_ids))}),
        pytest.raises(ValueError, match="given one of another mesh"),
        nts.Recorder("other", stepper, own_fields={"a": other}),
    ):
        pass
