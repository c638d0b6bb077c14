"""Examples in the docstrings of public names run and print what the docstrings say.

They may use the names in `constant_names` and in `names_of_an_example`, and read the files
in `FILES`. Each runs in a folder of its own. A test runs all examples of a package.
"""

import doctest
import inspect
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.scenes import BALL_PLATE

pytestmark = pytest.mark.serial

# A mesh, and table and fields of a run of three states.
FILES = ("ball_plate.msh", "run.csv", "run.vtkhdf")

# Numbers may have more digits than are printed, and ... stands for anything.
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def public_objects(module: ModuleType, prefix: str = "") -> dict[str, Any]:
    """Classes and functions in ``__all__`` of a module, and of the modules in it."""
    found = {}
    for name in module.__all__:
        item = getattr(module, name)
        if inspect.ismodule(item):
            found |= public_objects(item, f"{name}.")
        elif inspect.isclass(item) or inspect.isfunction(item):
            found[f"{prefix}{name}"] = item
    return found


def examples() -> dict[str, dict[str, doctest.DocTest]]:
    """Lines at a prompt in the docstrings of public names, by package and name."""
    found: dict[str, dict[str, doctest.DocTest]] = {}
    parser = doctest.DocTestParser()
    for name, item in sorted(public_objects(nts).items()):
        package = item.__module__.split(".")[1]
        found.setdefault(package, {})[name] = parser.get_doctest(item.__doc__, {}, name, name, 0)
    return found


EXAMPLES = examples()


@pytest.fixture(scope="module")
def constant_names() -> dict[str, Any]:
    """Modules; mesh, bodies and surfaces of two blocks, one 0.01 m above the other."""

    def build(model: Any) -> None:
        size = {"size": (1.0, 1.0, 0.5), "cells": (2, 2, 1)}
        nts.parts.add_box(model, "lower", corner=(0.0, 0.0, 0.0), **size)
        nts.parts.add_box(model, "upper", corner=(0.2, 0.1, 0.51), **size)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3)
    body, other = (nts.Body(V, cells, tag[name], rubber) for name in ("lower", "upper"))
    top, bottom = (nts.Surface(V, facets, tag[name]) for name in ("lower_top", "upper_bottom"))
    return {
        **{"nts": nts, "parts": nts.parts, "plotting": nts.plotting},
        **{"np": np, "ufl": ufl, "fem": fem, "MPI": MPI, "comm": MPI.COMM_WORLD},
        **{"mesh": mesh, "cells": cells, "facets": facets, "tag": tag, "V": V},
        **{"rubber": rubber, "body": body, "other": other, "bodies": [body, other]},
        **{"surface": top, "top": top, "bottom": bottom},
    }


@contextmanager
def names_of_an_example(constant_names: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Add a new stepper, and a pair that belongs to no stepper; restore the mesh at the end."""
    pair = nts.ContactPair(
        constant_names["bottom"],
        constant_names["top"],
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    x = constant_names["mesh"].geometry.x
    before = x.copy()
    yield constant_names | {"pair": pair, "stepper": falling_block(constant_names)}
    x[:] = before


def falling_block(names: dict[str, Any]) -> nts.EnergyMomentum:
    """Stepper in which the upper block strikes the lower one in the second step."""
    pair = nts.ContactPair(
        names["bottom"],
        names["top"],
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum(names["bodies"], [pair], dt=0.01)
    stepper.set_velocity(names["other"], (0.0, 0.0, -1.0))
    return stepper


@pytest.fixture(scope="module")
def folder(constant_names: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the files that examples read."""
    path = tmp_path_factory.mktemp("files")
    stepper = falling_block(constant_names)
    with nts.Recorder(path / "run", stepper) as record:
        for step in stepper.run(until=0.02):
            record.write(step)
    shutil.copy(BALL_PLATE, path)
    assert all((path / name).exists() for name in FILES)
    return path


def run(example: doctest.DocTest, names: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> str:
    """Run an example; return the report of its failures."""
    example.globs.update(names)
    window: Any = nullcontext()
    if example.name == "plotting.show":  # needs a display, which a test machine may not have
        monkeypatch.setenv("DISPLAY", ":0")
        window = mock.patch("pyvista.Plotter")
    printed: list[str] = []
    with window:
        result = doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=printed.append)
    return "".join(printed) if result.failed else ""


@pytest.mark.parametrize("package", sorted(EXAMPLES))
def test_examples_print_as_in_their_docstrings(
    package, constant_names, folder, tmp_path, monkeypatch
):
    if package == "plotting":
        pytest.importorskip("pyvista")
        pytest.importorskip("matplotlib")
    failures = []
    for name, example in EXAMPLES[package].items():
        if not example.examples:
            failures.append(f"add an example to the docstring of {name}")
            continue
        own_folder = tmp_path / name
        if any(f'"{file}"' in example.docstring for file in FILES):
            shutil.copytree(folder, own_folder)
        else:
            own_folder.mkdir()
        monkeypatch.chdir(own_folder)
        with names_of_an_example(constant_names) as names:
            failures.append(run(example, names, monkeypatch))
    assert not any(failures), "\n".join(filter(None, failures))
