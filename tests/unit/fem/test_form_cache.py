"""Forms whose compilation was interrupted, and kernels of another processor."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
import ufl
from dolfinx.mesh import create_unit_cube

from dolfinx_nts import compat
from dolfinx_nts.fem import form_cache, jit
from dolfinx_nts.fem.jit import compile_quickly

pytestmark = pytest.mark.serial

# Holds the lock of this form, and then completes the form.
COMPILING = """
import sys, time
from pathlib import Path
from dolfinx_nts.fem.form_cache import _locked
source = Path(sys.argv[1])
with _locked(source):
    print("locked", flush=True)
    sys.stdin.readline()
    source.with_suffix(".c.cached").touch()
"""


@pytest.fixture
def interrupted(comm, monkeypatch):
    """A form with its C file and library in the state after a killed compilation."""
    monkeypatch.setattr(compat, "_loaded", {})
    form = 7.25 * ufl.dx(domain=create_unit_cube(comm, 1, 1, 1))
    library = Path(compile_quickly(form).module.__file__)
    source = library.with_name(library.name.split(".")[0] + ".c")
    compat._loaded.clear()
    source.with_suffix(".c.cached").unlink()
    yield form, source, library
    # Keeps other tests from compiling it again.
    source.with_suffix(".c.cached").touch()


def test_form_whose_compilation_was_interrupted_is_compiled_again(interrupted):
    form, source, library = interrupted
    before = library.stat().st_mtime_ns
    begin = time.monotonic()
    assert compile_quickly(form).module.__file__ == str(library)
    assert library.stat().st_mtime_ns > before and source.with_suffix(".c.cached").exists()
    assert time.monotonic() - begin < jit._TIMEOUT


def test_form_that_another_process_compiles_is_waited_for(interrupted):
    form, source, library = interrupted
    before = library.stat().st_mtime_ns
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", COMPILING, source]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "locked\n"
        asking = subprocess.Popen(["sh", "-c", "sleep 1; echo"], stdout=process.stdin)
        assert compile_quickly(form).module.__file__ == str(library)
        asking.wait()
        process.stdin.close()
    assert library.stat().st_mtime_ns == before


def test_form_of_a_killed_process_is_compiled_again(interrupted):
    form, source, library = interrupted
    before = library.stat().st_mtime_ns
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", COMPILING, source]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "locked\n"
        process.kill()
        process.wait()
    compile_quickly(form)
    assert library.stat().st_mtime_ns > before


def test_all_kernels_have_the_processor_in_their_names(monkeypatch):
    for options in (jit._FAST, jit.compile_bilinear_form.args[0], jit.compile_quickly.args[0]):
        assert (
            f"-DDOLFINX_NTS_PROCESSOR={form_cache.processor()}"
            in options["cffi_extra_compile_args"]
        )
    assert f"-DDOLFINX_NTS_PROCESSOR={form_cache.processor()}" in jit.OPTIMISED


def test_processors_with_other_instructions_have_other_digests(tmp_path, monkeypatch):
    cpuinfo = tmp_path / "cpuinfo"
    found = []
    for flags in ("fpu sse2 avx2", "avx2 fpu sse2", "fpu sse2 avx2 avx512f"):
        cpuinfo.write_text(f"processor\t: 0\nflags\t\t: {flags}\n\nprocessor\t: 1\n")
        monkeypatch.setattr(form_cache, "_CPUS", str(cpuinfo))
        form_cache.processor.cache_clear()
        found.append(form_cache.processor())
    form_cache.processor.cache_clear()
    assert found[0] == found[1] != found[2]
