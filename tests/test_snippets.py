"""Python on the pages of the documentation runs, piece by piece, in a scene that is ready.

The script of the README has a test of its own. Each other block of Python, and each call of the
package within a sentence that is written without an ellipsis, may use the names in `space`; one
that makes displacements of two components those in `plane`. It runs in a folder of its own with
the checkpoint of an earlier run, ``preload.checkpoint.h5``.
"""

import re
import shutil
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts

pytestmark = pytest.mark.serial

DOCS = Path(__file__).parents[1] / "docs"
PAGES = sorted(set(DOCS.rglob("*.md")) - {*DOCS.glob("api/*"), *DOCS.glob("demos/*")})
RUBBER = nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3)
# Names that every snippet may use; `k` [N/m] and `volume` [m^3] belong to a spring.
NAMES = {
    "nts": nts,
    "np": np,
    "ufl": ufl,
    "fem": fem,
    "MPI": MPI,
    "rubber": RUBBER,
    "k": 10.0,
    "volume": 0.5,
}


def snippets() -> list[Any]:
    """Blocks of Python, and calls of the package in sentences, by page and number."""
    found = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
        calls = re.findall(r"(?<!`)`(nts\.\w+\([^`]*\))`", re.sub(r"^\|.*$", "", text, flags=re.M))
        for number, code in enumerate([*blocks, *(call for call in calls if "..." not in call)]):
            name = f"{page.relative_to(DOCS).with_suffix('')}-{number}"
            found.append(pytest.param(code, id=name))
    return found


@pytest.fixture(scope="module")
def space() -> dict[str, Any]:
    """A block named ball, also a tool, close above a plate, with bodies and a contact pair."""

    def build(model: Any) -> None:
        for name, z in (("plate", 0.0), ("ball", 0.51)):
            shape = {"size": (1.0, 1.0, 0.5), "cells": (1, 1, 1)}
            nts.parts.add_box(model, name, corner=(0.0, 0.0, z), **shape)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    ball, plate = (nts.Body(V, cells, tag[name], RUBBER) for name in ("ball", "plate"))
    bottom, top = (nts.Surface(V, facets, tag[name]) for name in ("ball_bottom", "plate_top"))
    return {
        **{"mesh": mesh, "cells": cells, "V": V, "tag": tag | {"tool": tag["ball"]}},
        **{"ball": ball, "plate": plate, "bodies": [ball, plate], "ball_outer": bottom},
        **{
            "plate_top": top,
            "pairs": [
                nts.ContactPair(
                    bottom, top, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
                )
            ],
        },
    }


@pytest.fixture
def plane() -> dict[str, Any]:
    """A mesh of the plane, of which nothing is made yet, with the name ``ball``."""

    def build(model: Any) -> None:
        shape = {"corner": (0.0, 0.0), "size": (1.0, 1.0), "cells": (1, 1)}
        nts.parts.add_rectangle(model, "ball", **shape)

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    return {"mesh": mesh, "cells": cells, "tag": tag}


def falling(names: dict[str, Any]) -> nts.EnergyMomentum:
    """Stepper of four steps a second in which the ball falls."""
    loads = [nts.Gravity([names["ball"]], (0.0, 0.0, -0.1))]
    return nts.EnergyMomentum(names["bodies"], names["pairs"], dt=0.25, loads=loads)


@pytest.fixture(scope="module")
def preload(space: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checkpoint after one step."""
    folder = tmp_path_factory.mktemp("preload")
    stepper = falling(space)
    with nts.Recorder(folder / "preload", stepper, checkpoint_every=1) as record:
        record.write(stepper.advance())
    return folder / "preload.checkpoint.h5"


@pytest.mark.parametrize("code", snippets())
def test_snippet_runs(code, request, preload, tmp_path, monkeypatch):
    names = dict(NAMES)
    if "(2,)" in code:
        names |= request.getfixturevalue("plane")
    else:
        names |= request.getfixturevalue("space")
        names["stepper"] = falling(names)
        names["other_loads"] = [nts.Pressure(names["plate_top"], 1.0)]
    shutil.copy(preload, tmp_path)
    if "part.inp" in code:
        cells = np.array([[0, 1, 2, 3]])
        meshio = pytest.importorskip("meshio")
        part = meshio.Mesh(np.eye(4)[:, 1:], {"tetra": cells}, cell_sets={"part": [np.array([0])]})
        part.write(tmp_path / "part.inp")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "snippet", "exec"), names)
    if "part.inp" in code:
        assert names["tag"] == {"part": 1} and list(names["cells"].values) == [1]
