"""Values of forms: weights of boxes of equal cells, known beforehand."""

import platform
import re
import subprocess
from importlib import metadata
from pathlib import Path

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import GhostMode, create_unit_cube
from ffcx.compiler import compile_ufl_objects
from ffcx.ir.analysis.valuenumbering import ValueNumberer
from ffcx.options import get_options
from ufl.core.expr import Expr
from ufl.exprcontainers import ExprList

import dolfinx_nts as nts
from dolfinx_nts import compat
from dolfinx_nts.fem.jit import (
    assembled,
    compile_bilinear_form,
    compile_expression,
    compile_form,
)
from dolfinx_nts.fem.linear_forms import CellForm
from dolfinx_nts.model.bodies import bulk_form
from helpers.models import box_meshes

pytestmark = pytest.mark.at_most_two_ranks

RHO, VOLUME, CELLS = 3.0, 1.2 * 1.0 * 0.5, 24
ROUNDING = 1e3 * np.finfo(float).eps

ghosts_ = pytest.mark.parametrize("ghosts", [GhostMode.none, GhostMode.shared_facet])


def weight(comm, ghosts):
    """A body, and the form of its weight along y."""
    data = box_meshes.boxes([(3, 4, 2)], [(1.2, 1.0, 0.5)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data, ghosts=ghosts)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(E=1.0, nu=0.3, rho=RHO, one_point=()))
    eta = ufl.TestFunction(V)
    return body, bulk_form([body], lambda material, parameters, rho: rho * eta[1])


@ghosts_
def test_assembled_forces_are_complete_and_counted_once(comm, ghosts):
    _, form = weight(comm, ghosts)
    values = assembled(compile_form(form)).reshape(-1, 3)
    total = comm.allreduce(values.sum(axis=0))
    np.testing.assert_allclose(total, [0, RHO * VOLUME, 0], rtol=ROUNDING)
    V = form.arguments()[0].ufl_function_space()
    assert len(values) == V.dofmap.index_map.size_local
    # A corner has the eighth of a cell.
    assert comm.allreduce(values[:, 1].min(), op=MPI.MIN) == pytest.approx(RHO * VOLUME / CELLS / 8)


@ghosts_
def test_form_without_some_cells_has_the_weight_of_the_others(comm, ghosts):
    body, form = weight(comm, ghosts)
    cell_form = CellForm(form)
    for left_out in (body.cells[::2], body.cells[:0], body.cells):
        cell_form.leave_out(left_out)
        values = np.zeros_like(fem.Function(body.V).x.array)
        cell_form.assemble(values)
        count = comm.allreduce(len(left_out))
        expected = RHO * VOLUME * (1 - count / CELLS)
        assert comm.allreduce(values.sum()) == pytest.approx(expected, abs=ROUNDING)


def test_expression_with_derivatives_by_variables_is_compiled_once(comm):
    """UFL numbers variables on and on; other numbers of a material are no other expression."""
    mesh = create_unit_cube(comm, 2, 2, 2)
    F = ufl.Identity(3) + ufl.grad(fem.Function(fem.functionspace(mesh, ("Lagrange", 1, (3,)))))
    modules = []
    for E in (1.0, 2.0):
        material = nts.NeoHookean(E=E, nu=0.3, rho=RHO)
        numbers = {k: fem.Constant(mesh, v) for k, v in material.parameters.items()}
        stress = material.stress(F.T * F, **numbers)
        expression = compile_expression(stress[0, 1], np.full((1, 3), 0.25))
        modules.append(expression.ufcx_expression)
    assert modules[0] == modules[1]


@pytest.mark.serial
@pytest.mark.skipif(
    platform.machine() != "x86_64" or platform.libc_ver()[0] != "glibc",
    reason="vector functions of glibc on x86-64",
)
def test_kernels_with_logarithms_call_vector_functions(comm):
    # Without them GCC vectorises nothing of such a kernel: it takes three times as long.
    body, _ = weight(comm, GhostMode.none)
    u, eta = fem.Function(body.V), ufl.TestFunction(body.V)
    F = ufl.Identity(3) + ufl.grad(u)

    def work(material, parameters, rho):
        P = F * material.stress(F.T * F, **parameters)
        return ufl.inner(P, ufl.grad(eta))

    form = compile_form(bulk_form([body], work))
    symbols = subprocess.run(
        ["nm", "--dynamic", form.module.__file__], capture_output=True, text=True, check=True
    )
    assert re.search(r"_ZGV[bcde]N\d+v_log", symbols.stdout)


@pytest.mark.serial
def test_ffcx_makes_few_cells_and_comparisons_and_writes_the_same_kernels(comm, monkeypatch):
    """It asks elements for a cell thousands of times, and compares expressions with all others."""
    body, _ = weight(comm, GhostMode.none)
    form = bulk_form([body], lambda material, parameters, rho: energy(body, material, parameters))
    calls = []
    for owner, name in ((ufl.Cell, "__init__"), (Expr, "__eq__"), (compat, "_equal")):
        call = getattr(owner, name)

        def counted(*given, name=name, call=call):
            calls.append(name)
            return call(*given)

        monkeypatch.setattr(owner, name, counted)

    def written():
        calls.clear()
        text = compile_ufl_objects([form], get_options())
        comparisons = calls.count("__eq__") + calls.count("_equal")
        return text, np.array([calls.count("__init__"), comparisons])

    def methods():
        return basix.ufl._ElementBase.cell, ValueNumberer.get_node_symbols, Expr.__eq__

    before = methods()
    expected, many = written()
    with compat.quicker_ffcx():
        text, few = written()
    assert text == expected
    assert np.all(few < many / 4)
    assert methods() == before


@pytest.mark.serial
def test_expressions_are_compared_node_by_node(comm):
    """UFL compares them once for each way to a node: twice as often with each line here."""
    u = fem.Function(fem.functionspace(create_unit_cube(comm, 1, 1, 1), ("Lagrange", 1)))

    def nested(x):
        for _ in range(100):
            x = ufl.sin(x) * ufl.cos(x)
        return x

    one, same, other = nested(u), nested(u), nested(2 * u)
    with compat.quicker_ffcx():
        assert one == same and one != other
        assert ExprList() == ExprList() != ExprList(u)  # an operator may have no operands
    assert one.ufl_operands is same.ufl_operands


@pytest.mark.serial
def test_installed_packages_are_searched_once_for_compiler_files(monkeypatch):
    scans, distributions = [], metadata.distributions
    monkeypatch.setattr(metadata, "distributions", lambda: scans.append(1) or distributions())
    given = metadata.entry_points
    for _ in range(3):
        with compat.quicker_ffcx():
            found = metadata.entry_points(group="console_scripts")
        assert set(found) == set(given(group="console_scripts"))
    assert metadata.entry_points is given
    assert len(scans) <= 1 + 3


def energy(body, material, parameters):
    """Strain energy of a body at some displacement."""
    F = ufl.Identity(3) + ufl.grad(fem.Function(body.V))
    return material.psi(F.T * F, **parameters)


@pytest.mark.serial
def test_matrices_are_soon_compiled(comm):
    """With GCC's higher levels of optimisation kernels take five times as long to compile."""
    body, _ = weight(comm, GhostMode.none)
    u, v = ufl.TrialFunction(body.V), ufl.TestFunction(body.V)
    form = compile_bilinear_form(bulk_form([body], lambda *_: ufl.inner(u, v)))
    module = Path(form.module.__file__)
    log = module.with_name(module.name.split(".")[0] + ".c.cached").read_text()
    (command,) = (line.split() for line in log.splitlines() if " -c " in line)
    assert [flag for flag in command if re.fullmatch("-O.", flag)][-1] == "-O1"
    assert [flag for flag in command if re.fullmatch("-g.?", flag)][-1] == "-g0"
    assert "-ftree-vectorize" in command
