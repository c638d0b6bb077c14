"""What a release uploads: the archive of the sources, and a wheel made of it alone."""

import os
import re
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial

PROJECT = Path(__file__).parents[1]


def run(*command: object, folder: Path, path: Path | None = None) -> str:
    """Return the output of a command in a folder, with a path first in the package search."""
    of_caller = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment = of_caller | ({} if path is None else {"PYTHONPATH": str(path)})
    words = list(map(str, command))
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


# Compiles the C++ module, which takes minutes where other tests run at the same time.
@pytest.mark.timeout(900)
def test_wheel_made_of_the_archive_runs_the_script_of_the_readme(tmp_path):
    archive_of = "from scikit_build_core.build import build_sdist; build_sdist({!r})"
    run(sys.executable, "-c", archive_of.format(str(tmp_path)), folder=PROJECT)
    (archive,) = tmp_path.glob("*.tar.gz")
    pip = sys.executable, "-m", "pip"
    alone = "--quiet", "--no-deps", "--no-index"
    # Other tests use the optimised build, whose compilation takes half as long again.
    soon = "--config-settings=cmake.define.CMAKE_CXX_FLAGS_RELEASE=-O1"
    run(*pip, "wheel", *alone, "--no-build-isolation", soon, archive, folder=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    site = tmp_path / "site"
    run(*pip, "install", *alone, "--target", site, wheel, folder=tmp_path)
    with tarfile.open(archive) as sources:
        sources.extractall(tmp_path, filter="data")
    (unpacked,) = tmp_path.glob("dolfinx_nts-*/README.md")
    (script,) = re.findall(r"```python\n(.*?)```", unpacked.read_text(), re.DOTALL)
    clone, elsewhere = unpacked.parent, tmp_path / "elsewhere"
    elsewhere.mkdir()
    origins = "print(nts.__file__, nts._kernels.__file__)\n"
    for folder, package in ((clone, clone), (elsewhere, site)):
        (folder / "impact.py").write_text(script + origins)
        printed = run(sys.executable, "impact.py", folder=folder, path=site)
        assert "200 steps from t = 0 to 2 s" in printed
        python, compiled = printed.split()[-2:]
        assert python.startswith(str(package)) and compiled.startswith(str(site))
        assert (folder / "ball_plate.vtkhdf").exists()
    # Sources of another version never use the installed module silently.
    with (clone / "dolfinx_nts" / "cpp" / "nts" / "geometry" / "gap.h").open("a") as header:
        header.write("// changed\n")
    with pytest.raises(AssertionError, match=r"given one of other sources in .* again"):
        run(sys.executable, "impact.py", folder=clone, path=site)
