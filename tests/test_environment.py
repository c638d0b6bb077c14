"""The script behind the Makefile: arguments, exit status, and failures.

Debian is not set up for real here: a stand-in project, in which no Python has DOLFINx, calls
stand-ins of ``mmdebstrap``, ``bwrap`` and ``apt``.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial

PROJECT = Path(__file__).parents[1]
RUN = PROJECT / "environment" / "run"
SCRIPTS = [RUN, PROJECT / "environment" / "ranks", PROJECT / ".ci" / "run"]

inside = pytest.mark.skipif(
    not Path(sys.prefix, "ready").exists(), reason="not called through environment/run"
)

STUBS = {
    # What follows the script itself among the arguments is the user's command.
    "bwrap": """
        while (($#)) && [[ $1 != */environment/run ]]; do
          [[ $1 != --json-status-fd ]] || report=$2
          shift
        done
        shift
        (($# == 0)) || env --default-signal=INT,QUIT,TERM "$@"
        status=$?
        [[ ! ${report:-} ]] || printf '{ "exit-code": %d }' $status >&"$report"
        exit $status
    """,
    "mmdebstrap": 'echo built >> "$HOME/builds" && tar --create --files-from=/dev/null',
    "apt-get": "",
    "apt-cache": 'echo "  Candidate: 1:0.5.2-2"',
    "apt-config": "",
    "dpkg-query": 'echo "install ok installed"',
}


class Host:
    """A machine without DOLFINx: a project, a home and the programs it finds."""

    def __init__(self, folder: Path) -> None:
        """Set it up in a folder, with the stand-ins."""
        self.project = folder / "project"
        self.home = folder / "home"
        self.cache = self.home / ".cache" / "dolfinx_nts"
        self.programs = folder / "bin"
        self.environ: dict[str, str] = {}
        self.processes: list[subprocess.Popen[str]] = []
        for new in (self.home, self.programs):
            new.mkdir()
        shutil.copytree(PROJECT / "environment", self.project / "environment")
        (self.project / "environment" / "probe.py").write_text("raise SystemExit(1)")
        for name, body in STUBS.items():
            self.stub(name, body)

    def stub(self, name: str, body: str) -> None:
        program = self.programs / name
        program.write_text(f"#!/usr/bin/env bash\n{body}\n")
        program.chmod(0o755)

    def start(self, *command: str) -> subprocess.Popen[str]:
        """Start a command as the leader of a process group."""
        keep = {k: v for k, v in os.environ.items() if not k.startswith(("DOLFINX_NTS", "XDG"))}
        path = f"{self.programs}:{os.environ['PATH']}"
        process = subprocess.Popen(
            [self.project / "environment" / "run", *command],
            cwd=self.project,
            env=keep | {"PATH": path, "HOME": str(self.home)} | self.environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.processes.append(process)
        return process

    def call(self, *command: str) -> tuple[int, str, str]:
        """Exit status, output and last line of the errors."""
        process = self.start(*command)
        output, errors = process.communicate(timeout=20)
        return process.returncode, output, (errors.splitlines() or [""])[-1]

    def builds(self) -> int:
        """How often a build was begun."""
        log = self.home / "builds"
        return len(log.read_text().splitlines()) if log.exists() else 0


@pytest.fixture
def host(tmp_path: Path) -> Iterator[Host]:
    host = Host(tmp_path)
    yield host
    for process in host.processes:
        with process, suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_scripts_parse(script: Path) -> None:
    subprocess.run(["bash", "-n", script], check=True)


@inside
def test_arguments_input_and_folder_arrive_unchanged(tmp_path: Path) -> None:
    arguments = ["two words", "", "*", "new\nline", "'", '"', "$HOME", "\\", "--", "-n"]
    show = "import os, sys; print(sys.argv[1:], os.getcwd(), sys.stdin.read())"
    command = [str(RUN), "python3", "-c", show, *arguments]
    output = subprocess.check_output(command, input="in\nput", cwd=tmp_path, text=True)
    assert output == f"{arguments} {tmp_path.resolve()} in\nput\n"


@inside
@pytest.mark.parametrize("status", [0, 1, 77, 255])
def test_exit_status_agrees_with_the_command(status: int) -> None:
    assert subprocess.run([RUN, "bash", "-c", f"exit {status}"]).returncode == status


@inside
def test_call_inside_builds_nothing(tmp_path: Path) -> None:
    environ = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    subprocess.run([RUN, "true"], check=True, env=environ)
    assert list((tmp_path / "dolfinx_nts").iterdir()) == []


@inside
def test_compiler_errors_are_shown(tmp_path: Path) -> None:
    shutil.copytree(PROJECT / "environment", tmp_path / "environment")
    source = tmp_path / "dolfinx_nts" / "cpp"
    source.mkdir(parents=True)
    (source / "CMakeLists.txt").write_text('message(FATAL_ERROR "as expected")')
    result = subprocess.run(
        [tmp_path / "environment" / "run", "true"], capture_output=True, text=True
    )
    assert result.returncode == 1
    assert "as expected" in result.stderr
    assert result.stderr.splitlines()[-1] == "environment: the C++ module does not compile"


def test_debian_is_built_once(host: Host) -> None:
    for _ in range(2):
        assert host.call("echo", "two  words")[:2] == (0, "two  words\n")
    assert host.builds() == 1


def test_suites_of_debian_live_side_by_side(host: Host) -> None:
    host.stub("mmdebstrap", 'echo "$@" >> "$HOME/builds" && tar --create --files-from=/dev/null')
    for suite in ("", "sid", "", "sid"):
        host.environ["DOLFINX_NTS_SUITE"] = suite
        assert host.call("true")[0] == 0
        for lock in host.cache.glob("*.lock"):
            os.utime(lock, (0, 0))
    first, second = (host.home / "builds").read_text().splitlines()
    assert " trixie " in first
    assert " sid " in second


def test_suite_that_is_asked_for_is_built_although_apt_has_dolfinx(host: Host) -> None:
    host.stub("apt-cache", 'echo "  Candidate: 1:0.9.0-1"')
    host.environ["DOLFINX_NTS_SUITE"] = "sid"
    assert host.call("true")[0] == 0
    assert host.builds() == 1


def test_one_debian_is_not_entered_from_another(host: Host) -> None:
    host.environ |= {"DOLFINX_NTS_ENTERED": "trixie", "DOLFINX_NTS_SUITE": "sid"}
    status, _, error = host.call("true")
    assert (status, error) == (1, "environment: this is Debian trixie: leave it for Debian sid")
    assert host.builds() == 0


def test_debian_sees_all_folders_of_users(host: Host) -> None:
    host.stub("bwrap", '(($# < 5)) || echo "$@" > "$HOME/binds"' + STUBS["bwrap"])
    assert host.call("true")[0] == 0
    binds = (host.home / "binds").read_text()
    folders = {path for path in Path("/").iterdir() if path.is_dir()}
    system = set(
        "bin boot dev etc lib lib32 lib64 libx32 lost+found proc run sbin sys usr var".split()
    )
    for folder in folders - {Path("/", name) for name in (*system, "tmp")}:
        assert f"--bind {folder} {folder} " in binds
    assert not [name for name in system if f"--bind /{name} " in binds]


def test_packages_hidden_by_debian_are_named(host: Host) -> None:
    host.call("true")
    hidden = "/usr/bin/env"
    where = "copy it to a folder outside of /usr/"
    for argument in (hidden, f"--mesh={hidden}"):
        status, _, error = host.call("true", argument, "/tmp", "/nowhere", "-x", "")
        assert status == 0 and hidden in error and error.endswith(where)
    (there,) = host.cache.glob("debian-*/root")
    (there / "usr" / "bin").mkdir(parents=True)
    (there / "usr" / "bin" / "env").touch()
    assert host.call("true", hidden)[1:] == ("", "")


@pytest.mark.parametrize("command", ["exit 3", "kill -TERM $$", "kill -KILL $$"])
def test_exit_status_passes_bubblewrap(host: Host, command: str) -> None:
    expected = subprocess.run(["bash", "-c", f"bash -c '{command}'; exit $?"]).returncode
    assert host.call("bash", "-c", command)[0] == expected


@pytest.mark.parametrize(
    ("number", "group"), [(signal.SIGTERM, False), (signal.SIGTERM, True), (signal.SIGINT, True)]
)
def test_signals_reach_the_command(host: Host, number: signal.Signals, group: bool) -> None:
    host.call("true")
    process = host.start(
        "bash", "-c", f"trap 'echo caught; exit 5' {number.name}; echo up; sleep 10 & wait"
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    (os.killpg if group else os.kill)(process.pid, number)
    assert process.stdout.readline() == "caught\n"
    assert process.wait(timeout=5) == 5


def test_concurrent_first_calls_build_once(host: Host) -> None:
    host.stub("mmdebstrap", STUBS["mmdebstrap"] + "; sleep 0.5")
    processes = [host.start("true") for _ in range(3)]
    assert [process.wait(timeout=20) for process in processes] == [0, 0, 0]
    assert host.builds() == 1


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_interrupted_build_is_not_taken_for_finished(host: Host, number: signal.Signals) -> None:
    host.stub("mmdebstrap", STUBS["mmdebstrap"] + "; : > half; exec sleep 10")
    process = host.start("true")
    wait_until((host.project / "half").exists)
    os.killpg(process.pid, number)
    assert process.wait(timeout=5) != 0
    host.stub("mmdebstrap", STUBS["mmdebstrap"])
    assert host.call("true")[0] == 0
    assert host.builds() == 2


def test_changed_package_list_rebuilds_and_old_folders_go(host: Host) -> None:
    host.call("true")
    (old,) = host.cache.glob("debian-*.lock")
    os.utime(old, (0, 0))
    with (host.project / "environment" / "packages.txt").open("a") as packages:
        packages.write("hello\n")
    assert host.call("true")[0] == 0
    assert host.builds() == 2
    assert not old.with_suffix("").exists()


def test_folder_in_use_stays(host: Host) -> None:
    process = host.start("sleep", "10")
    wait_until(lambda: len(list(host.cache.glob("debian-*/ready"))) == 1)
    (old,) = host.cache.glob("debian-*.lock")
    with (host.project / "environment" / "packages.txt").open("a") as packages:
        packages.write("hello\n")
    os.utime(old, (0, 0))
    assert host.call("true")[0] == 0
    assert process.poll() is None
    assert old.with_suffix("").exists()


FAILURES = {
    "space": ("df", "echo Avail; echo 1", "needs 4: free some"),
    "full": ("mmdebstrap", "echo No space left on device >&2; exit 1", "the disk is full"),
    "network": ("mmdebstrap", "echo Temporary failure resolving >&2; exit 1", "check the network"),
    "unknown": ("mmdebstrap", "exit 1", "the reason is at the end of"),
    "packages": ("dpkg-query", "exit 1", "apt"),
    "bubblewrap": ("bwrap", "exit 1", "neither bubblewrap nor chroot are permitted"),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_failure_is_explained_and_leaves_nothing(host: Host, failure: str) -> None:
    name, body, message = FAILURES[failure]
    host.stub("apt-get", '[[ $1 != install ]] || { echo "apt is broken" && exit 1; }')
    host.stub("unshare", "exit 1")
    host.stub(name, body)
    status, _, error = host.call("true")
    assert status == 1
    assert error.startswith("environment: ")
    assert message in error
    assert not list(host.cache.glob("*/ready"))
    if name in STUBS:
        host.stub(name, STUBS[name])
    else:
        (host.programs / name).unlink()
    assert host.call("true")[0] == 0


def test_sanitized_tests_exist():
    script = (PROJECT / "environment" / "sanitize").read_text()
    named = re.findall(r"tests/unit/([\w/]+)/(test_\w*)(?:\{(.*?)\})?\.py", script)
    files = [
        f"{folder}/{begin}{end}.py" for folder, begin, ends in named for end in ends.split(",")
    ]
    assert len(files) > 10
    assert not [file for file in files if not (PROJECT / "tests" / "unit" / file).is_file()]
