"""Every demo runs, shortened, in a folder of its own, on several ranks.

`make docs` runs each as it is, on one rank.
"""

import runpy
from pathlib import Path

import pytest

pytestmark = [pytest.mark.several_ranks, pytest.mark.at_most_two_ranks]

DEMOS = sorted((Path(__file__).parents[1] / "demos").rglob("demo_*.py"))
# Files other than pictures, movies and tables.
FIELDS = {".h5", ".vtkhdf"}


@pytest.mark.parametrize("demo", DEMOS, ids=lambda demo: demo.stem)
def test_demo_runs_and_its_assertions_hold(comm, demo, tmp_path, monkeypatch):
    for module in ("pyvista", "matplotlib"):
        pytest.importorskip(module)
    folder = comm.bcast(tmp_path)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("NTS_DEMO_STEPS", "12")
    runpy.run_path(str(demo), run_name="__main__")
    comm.barrier()
    expected = {".csv", ".png"} | (set() if demo.stem == "demo_scaling" else FIELDS)
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert {path.suffix for path in files} - {".gif"} == expected
    assert all(path.stat().st_size > 0 for path in files)
