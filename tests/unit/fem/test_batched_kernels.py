"""Kernels for batches of cells against FFCx."""

import logging
import platform
import re
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

import dolfinx_nts as nts
from dolfinx_nts.fem import batched_kernels as module
from dolfinx_nts.fem.batched_kernels import batched_kernels
from dolfinx_nts.fem.batched_source import batched_source
from dolfinx_nts.fem.components import deformation_gradient, gradient
from dolfinx_nts.fem.jit import compile_form, compile_quickly
from dolfinx_nts.fem.linear_forms import CellForm
from dolfinx_nts.model.bodies import bulk_form
from helpers.models import box_meshes, plane

pytestmark = pytest.mark.at_most_two_ranks

# Functions that UFL knows; each argument of the test law is near 1.
FUNCTIONS = [
    *(ufl.acos, ufl.asin, ufl.atan, ufl.cos, ufl.cosh, ufl.erf, ufl.exp, ufl.ln, ufl.sin),
    *(ufl.sinh, ufl.sqrt, ufl.tan, ufl.tanh, abs, ufl.sign),
    *(lambda x, p=p: x**p for p in (-2, -1, -0.5, 0.5, 2, 3, 4, 1 / 3)),
    lambda x: ufl.conditional(ufl.gt(x, 0.52), x, 2.0),
    lambda x: ufl.conditional(ufl.And(ufl.lt(x, 0.48), ufl.ge(x, 0.2)), 1.0, x),
    lambda x: ufl.atan2(x, 2.0) + ufl.max_value(x, 0.45) + ufl.min_value(x, 0.55),
]


def virtual_work(comm, law, cell="hexahedron", degree=1):
    """Virtual work in a deformed body."""
    data = box_meshes.boxes([(3, 2, 3)], [(1.2, 1.0, 0.5)], cell=cell)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    u, eta = fem.Function(V), ufl.TestFunction(V)
    u.x.array[:] = 0.02 * np.sin(np.arange(len(u.x.array)))
    F = ufl.Identity(3) + ufl.grad(u)

    def work(material, parameters, rho):
        return ufl.inner(F * material.stress(F.T * F, **parameters), ufl.grad(eta))

    return expand_derivatives(bulk_form([nts.Body(V, cells, tag["body 0"], law)], work))


@pytest.mark.serial
@pytest.mark.parametrize(("number", "level"), [(4000, "-O3"), (6000, "-O1")])
def test_forms_with_many_values_are_compiled_at_a_lower_level(tmp_path, number, level):
    """At GCC's -O3 the compile time of thousands of values grows faster than their number."""
    (tmp_path / "form.c").write_text("  double value = 1.0;\n" * number)
    library = module._Library.of(tmp_path / "form.cpython.so", is_single=False, columns=None)
    assert [flag for flag in library.command if re.fullmatch("-O.", flag)][-1] == level


def source_of(form):
    """C source that FFCx generated."""
    library = Path(form.module.__file__)
    return library.with_name(library.name.split(".")[0] + ".c").read_text()


@pytest.mark.serial
def test_functions_of_energies(comm):
    def psi(C):
        x = 0.5 * C[0, 0]
        return sum(function(x) for function in FUNCTIONS) * (ufl.tr(C) - 3) ** 2

    work = virtual_work(comm, nts.Hyperelastic(psi, rho=1.0))
    reference = compile_form(work)
    assert batched_kernels(reference) is not None
    assert batched_kernels(reference, is_single=True) is not None
    expected = fem.assemble_vector(reference).array
    given = np.zeros_like(expected)
    CellForm(work).assemble(given)
    np.testing.assert_allclose(given, expected, atol=1e-13 * abs(expected).max())


@pytest.mark.serial
@pytest.mark.parametrize("is_single", [False, True])
def test_functions_of_parameters(comm, is_single):
    def psi(C, k):
        return sum(function(k) for function in FUNCTIONS) * (ufl.tr(C) - 3) ** 2

    work = virtual_work(comm, nts.Hyperelastic(psi, rho=1.0, k=0.5))
    assert batched_kernels(compile_form(work), is_single=is_single) is not None
    if is_single:
        return
    expected = fem.assemble_vector(compile_form(work)).array
    given = np.zeros_like(expected)
    CellForm(work).assemble(given)
    np.testing.assert_allclose(given, expected, atol=1e-13 * abs(expected).max())


@pytest.mark.serial
@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 1), ("hexahedron", 2)])
def test_sums_over_tables_are_taken_direction_by_direction(comm, cell, degree):
    law = nts.SaintVenantKirchhoff(E=1.0, nu=0.3, rho=1.0)
    source = batched_source(source_of(compile_quickly(virtual_work(comm, law, cell, degree))))
    sums = re.findall(r"\+= .*\[iq\]\[i", source)
    # Nine derivatives of u, nine of the coordinates in the Jacobian.
    assert source.count("_at(iq);") == (18 if degree == 1 else 0)
    assert bool(sums) == (degree == 2)


@pytest.mark.serial
@pytest.mark.parametrize(("cell", "degree"), [("quadrilateral", 1), ("triangle", 2)])
def test_kernels_in_the_plane(comm, cell, degree):
    scene = plane.blocks(cell, angle=0.3, degree=degree, comm=comm)
    V, x = scene.V, scene.V.mesh.geometry.x
    x[:, :2] += 0.02 * np.sin(7 * x[:, 1::-1])  # no parallelograms
    u, direction, eta = fem.Function(V), fem.Function(V), ufl.TestFunction(V)
    for function in (u, direction):
        function.x.array[:] = 0.02 * np.sin(np.arange(len(u.x.array)) ** 2)
    F = deformation_gradient(u)

    def work(material, parameters, rho):
        P = F * material.stress(F.T * F, **parameters)
        return ufl.inner(P, gradient(eta)) + 1e3 * rho * ufl.dot(u, eta)

    form = bulk_form([scene.lower, scene.upper], work)
    action = expand_derivatives(ufl.derivative(form, u, direction))
    reference = compile_form(action)
    sums = re.findall(r"\+= .*\[iq\]\[i", batched_source(source_of(reference)))
    assert bool(sums) == (cell == "triangle")
    expected = fem.assemble_vector(reference).array
    for kernels, rounding in (("double", 1e-13), ("single", 1e-5)):
        given = np.zeros_like(expected)
        CellForm(action, kernels).assemble(given)
        np.testing.assert_allclose(given, expected, rtol=0, atol=rounding * abs(expected).max())


@pytest.mark.serial
@pytest.mark.skipif(
    platform.machine() != "x86_64" or platform.libc_ver()[0] != "glibc",
    reason="vector functions of glibc on x86-64",
)
def test_logarithms_are_vector_functions(comm, monkeypatch):
    # Without them a kernel takes half as long again.
    form = compile_quickly(virtual_work(comm, nts.NeoHookean(E=1.0, nu=0.3, rho=1.0)))
    loaded = []
    monkeypatch.setattr(module.ctypes, "CDLL", _recording(module.ctypes.CDLL, loaded))
    batched_kernels(form)
    symbols = subprocess.run(
        ["nm", "--dynamic", loaded[0]], capture_output=True, text=True, check=True
    )
    assert re.search(r"_ZGV[bcde]N\d+v_log", symbols.stdout)


def _recording(load, paths):
    def recorded(path):
        paths.append(path)
        return load(path)

    return recorded


@pytest.mark.serial
def test_existing_library_is_not_generated_again(comm, monkeypatch):
    """Each stepper asks for several libraries, and what FFCx writes may be long."""
    form = compile_quickly(virtual_work(comm, nts.NeoHookean(E=1.0, nu=0.3, rho=1.0)))
    assert batched_kernels(form) is not None
    calls = []
    monkeypatch.setattr(
        module, "batched_source", lambda *given: calls.append(given) or batched_source(*given)
    )
    assert batched_kernels(form) is not None
    assert not calls
    monkeypatch.setattr(module, "_STANDARD", "-std=c++17")
    monkeypatch.setenv("CXX", "no-such-compiler")
    assert batched_kernels(form) is None
    assert len(calls) == 1


def test_forms_that_cannot_be_batched_use_ffcx(comm, monkeypatch, caplog):
    work = virtual_work(comm, nts.NeoHookean(E=1.0, nu=0.3, rho=1.0))
    expected = fem.assemble_vector(compile_form(work)).array
    monkeypatch.setenv("CXX", "no-such-compiler")
    with caplog.at_level(logging.INFO, logger="dolfinx_nts"):
        given = np.zeros_like(expected)
        CellForm(work).assemble(given)
    assert "no kernels for batches of cells, which is harmless" in caplog.text
    # Integrals over the same cells are summed up cell by cell.
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-15 * abs(expected).max())


@pytest.mark.serial
def test_compilation_runs_in_the_background_until_assembly(comm, monkeypatch, tmp_path):
    work = virtual_work(comm, nts.NeoHookean(E=1.0, nu=0.3, rho=1.0))
    compiler, go = tmp_path / "compiler", tmp_path / "go"
    cxx = sysconfig.get_config_var("CXX") or "c++"
    compiler.write_text(f'#!/bin/sh\nuntil [ -e {go} ]; do sleep 0.01; done\nexec {cxx} "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CXX", str(compiler))
    form = CellForm(work)
    expected = fem.assemble_vector(compile_form(work)).array
    go.touch()
    given = np.zeros_like(expected)
    form.assemble(given)
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


@pytest.mark.serial
def test_only_kernels_of_ffcx_without_branches_are_translated(comm):
    source = source_of(compile_quickly(virtual_work(comm, nts.NeoHookean(E=1.0, nu=0.3, rho=1.0))))
    with pytest.raises(ValueError, match="expected kernels of FFCx"):
        batched_source("int main() { return 0; }")
    with pytest.raises(ValueError, match="expected kernels without branches"):
        batched_source(source.replace("for (int iq", "if (w[0] > 0)\nfor (int iq"))
