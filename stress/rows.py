"""A row of the table: run a scene and judge it by the files of the recorder."""

import csv
import logging
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_nts as nts
from dolfinx_nts.diagnostics.names import pair_names
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from stress.dents import below_the_next_facet

__all__ = [
    "COLUMNS",
    "ENERGY_TOLERANCE",
    "MOMENTUM_TOLERANCE",
    "OVERLAP",
    "Case",
    "Outcome",
    "Setup",
    "above",
    "empty_row",
    "run",
]

# Tolerances relative to the largest energy (or work) and to the sum of nodal momenta.
ENERGY_TOLERANCE, MOMENTUM_TOLERANCE = 1e-9, 1e-10
# Depth of an overlap, relative to the longest facet [-], above which a report is required.
_DEEP = 0.1
# Warning of overlapping bodies.
OVERLAP = "is up to .* inside"
# Gap that counts as closed, relative to a segment; and round-off of a depth, relative to it.
_CLOSED, _ROUNDING = 1e-9, 1e-9
# Message of a step with crushed cells.
CRUSHED = "is inverted"
COLUMNS = (
    "scene",
    "parameter",
    "value",
    "outcome",
    "energy_error",
    "momentum_error",
    "angular_momentum_error",
    "min_gap",
    "least_allowed_gap",
    "steps",
    "rejected_steps",
    "message",
)


@dataclass(frozen=True)
class Setup:
    """A scene that is ready to run.

    Attributes:
        stepper: The stepper.
        until: Time at the end [s].
        check: Called after the last step; says what is wrong, or "".
        ledger: Whether loads, supports, springs or friction change the
            energy, so that the ledger is judged and not the energy.
        supported: Whether reactions at supports change the momenta.
    """

    stepper: Any
    until: float
    check: Callable[[], str] = lambda: ""
    ledger: bool = False
    supported: bool = False


@dataclass(frozen=True)
class Case:
    """A scene at one value of a parameter.

    Attributes:
        scene: Name of the scene.
        parameter: What varies.
        value: Its value.
        build: Makes the scene. Collective.
        stops: Pattern of the error with which it has to stop; None if it
            has to finish.
        warns: Pattern of the warning that it has to log.
        may_stop: Whether it may stop with an error, and have overlaps that it tells.
        energy_error: Largest error of the energy, relative to the largest energy or work.
        cuts: How often a step may be halved; 0 where the row shows what is refused.
    """

    scene: str
    parameter: str
    value: Any
    build: Callable[[MPI.Comm], Setup]
    stops: str | None = None
    warns: str = ""
    cuts: int = 6
    may_stop: bool = False
    energy_error: float = ENERGY_TOLERANCE

    @property
    def name(self) -> str:
        """Scene, parameter and value."""
        return f"{self.scene}: {self.parameter} = {self.value}"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a case.

    Attributes:
        row: Values of `COLUMNS`.
        wrong: Why it is not as it has to be, or "".
        seconds: Wall time [s].
    """

    row: dict[str, Any]
    wrong: str
    seconds: float


def empty_row(case: Case) -> dict[str, Any]:
    """Values of `COLUMNS` of a case that has not run."""
    said = {"scene": case.scene, "parameter": case.parameter, "value": case.value}
    return dict.fromkeys(COLUMNS, "") | said | {"steps": 0, "rejected_steps": 0}


def run(case: Case, comm: MPI.Comm) -> Outcome:
    """Run a case and judge it. Collective.

    Args:
        case: The case.
        comm: Communicator.

    Returns:
        Its row; every exception but the announced ones is passed on.
    """
    start = time.perf_counter()
    row = empty_row(case) | {"outcome": "finished"}
    folder = Path(comm.bcast(tempfile.mkdtemp() if comm.rank == 0 else None))
    table = folder / "run.csv"
    setup, error, warnings = None, "", _Warnings()
    scales, approaches, kinks, dents = [np.zeros(2)], [0.0], [0.0], [0.0]
    try:
        setup = case.build(comm)
        with nts.Recorder(folder / "run", setup.stepper, every=10**9) as record:
            scales.append(_momentum_scales(setup))
            for step in setup.stepper.run(setup.until, control=_control(case, setup)):
                record.write(step)
                scales.append(_momentum_scales(setup))
                approaches.append(_approach(setup.stepper))
                kinks.append(_kink(setup.stepper))
                dents.append(_dent(setup.stepper))
    except (nts.ConvergenceError, ValueError) as failure:
        row["outcome"], error = "stopped", str(failure)
    warnings.close()
    said = "; ".join(comm.bcast(warnings.texts))
    row["message"] = error or said
    wrong = "" if case.may_stop else _not_announced(case, error)
    if not re.search(case.warns, said):
        wrong = f"expected the warning {case.warns!r}, given {said!r}"
    if setup is not None and table.exists():
        values = comm.bcast(_read(table) if comm.rank == 0 else None)
        row |= _errors(values, setup, np.max(scales, axis=0))
        row["steps"] = len(values["step"]) - 1
        row["rejected_steps"] = int(values["rejected"].sum())
        wrong = wrong or _too_large(row, values, case)
        if setup.stepper.pairs:
            deep = _depth(row, values, _allowed(setup, values, approaches, kinks, dents))
            # A run that stops, or that requires a report of an overlap, may have deeper nodes.
            reported = case.may_stop and _is_reported(setup, row, said)
            reported = reported or case.stops or case.warns == OVERLAP
            wrong = wrong or ("" if reported else deep)
    if setup is not None and not error and not wrong:
        wrong = setup.check() or _unreported(setup, said)
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(folder)
    return Outcome(row, wrong, time.perf_counter() - start)


class _Warnings(logging.Handler):
    """Collects the warnings of the package."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []
        logging.getLogger("dolfinx_nts").addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Store the text."""
        self.texts.append(record.getMessage())

    def close(self) -> None:
        """Stop listening."""
        logging.getLogger("dolfinx_nts").removeHandler(self)
        super().close()


def above(
    stepper: Any, upper: nts.Body, lower: nts.Body, up: Any = (0.0, 0.0, 1.0)
) -> Callable[[], str]:
    """Check that one body has not gone through the other. Collective."""
    diagnostics = nts.Diagnostics(stepper)

    def check() -> str:
        heights = [diagnostics.centre_of_mass(body) @ up for body in (upper, lower)]
        return "" if heights[0] > heights[1] else f"upper body at {heights[0]:.3g}, below the other"

    return check


def _control(case: Case, setup: Setup) -> nts.StepControl:
    return nts.StepControl(smallest=0.99 * setup.stepper.dt / 2**case.cuts)


def _approach(stepper: Any) -> float:
    """Largest approach of a node and a segment in the last step [m].

    Upper bound: the sum of the largest displacement increments of both sides. Collective.
    """
    way = np.linalg.norm((stepper.u.x.array - stepper.u_n.x.array).reshape(-1, 3), axis=1)
    comm, longest = stepper.u.function_space.mesh.comm, 0.0
    for pair in stepper.pairs:
        if isinstance(pair.enforcement, nts.LagrangeMultiplier):
            both = [s for s in (pair.nodes, pair.segments) if not isinstance(s, Obstacle)]
            ways = [way[surface.nodes].max(initial=0.0) for surface in both]
            longest = max(longest, sum(comm.allreduce(way, op=MPI.MAX) for way in ways))
    return longest


def _kink(stepper: Any) -> float:
    """Depth at which a spring becomes active on a node that slid over a kink [m]. Collective."""
    springs = [contact.history.offset for contact in stepper.contacts if contact.eps_N is not None]
    deepest = max((-offset.min(initial=0.0) for offset in springs), default=0.0)
    return float(stepper.u.function_space.mesh.comm.allreduce(deepest, op=MPI.MAX))


def _dent(stepper: Any) -> float:
    """Depth below the adjacent facet in a dent, in static equilibrium [m]. Collective."""
    return below_the_next_facet(stepper) if isinstance(stepper, nts.QuasiStatic) else 0.0


def _allowed(
    setup: Setup,
    values: dict[str, Any],
    approaches: list[float],
    kinks: list[float],
    dents: list[float],
) -> Any:
    """Least gap allowed in each row of the recorder [m]. Collective.

    Nodes may be as deep as they were at the start, and deeper: with
    multipliers by the longest approach in one step so far, as elastic
    impact preserves the gap with which a node came (in equilibrium the gap
    is closed, but for dents); with springs as deep as one that has all the
    energy of contact, from where it begins.
    """
    start = min(0.0, np.nan_to_num(values["min_gap"][0]))
    depth = np.maximum.accumulate(approaches)
    if isinstance(setup.stepper, nts.QuasiStatic):
        size = [pair.segment_size for pair in setup.stepper.pairs]
        depth = np.full(len(depth), _CLOSED * max(size, default=0.0))
    comm = setup.stepper.u.function_space.mesh.comm
    springs = [c.eps_N for c in setup.stepper.contacts if c.eps_N is not None]
    weakest = min((eps_N.min(initial=np.inf) for eps_N in springs), default=np.inf)
    weakest = comm.allreduce(weakest, op=MPI.MIN)
    energy = np.maximum.accumulate(np.maximum(values["contact_energy"], 0.0))
    depth = np.maximum(depth, np.sqrt(2 * energy / weakest) + kinks) + dents
    return start - depth - _ROUNDING * (depth - start)


def _depth(row: dict[str, Any], values: dict[str, Any], allowed: Any) -> str:
    """Complete the row by the depth; describe a gap below the admissible one."""
    gap = np.nan_to_num(values["min_gap"], nan=np.inf)
    row["least_allowed_gap"] = allowed[gap.argmin()]
    deepest = (gap - allowed).argmin()
    if gap[deepest] >= allowed[deepest]:
        return ""
    return f"gap {gap[deepest]:.3g} < {allowed[deepest]:.3g} in row {deepest}"


def _is_reported(setup: Setup, row: dict[str, Any], said: str) -> bool:
    """Whether the deepest node has been reported, or is too shallow to be reported."""
    size = min(pair.segment_size for pair in setup.stepper.pairs)
    return "inside" in said or row["outcome"] == "stopped" or row["min_gap"] > -_DEEP * size


def _unreported(setup: Setup, said: str) -> str:
    """Describe final overlaps without a warning. Collective."""
    deep = [
        f"{' in '.join(o.names)}: {o.depth:.3g}"
        for o in nts.Diagnostics(setup.stepper).overlaps()
        if o.depth > _DEEP * o.size
    ]
    return "" if "inside" in said or not deep else f"overlaps without a word: {', '.join(deep)}"


def _not_announced(case: Case, error: str) -> str:
    if error and not case.stops:
        return f"stopped: {error}"
    if case.stops and not error:
        return f"finished, expected to stop with {case.stops!r}"
    if case.stops and not re.search(case.stops, error):
        return f"expected {case.stops!r}, stopped with {error}"
    return ""


def _momentum_scales(setup: Setup) -> Any:
    """Sums of the magnitudes of the nodal linear and angular momenta. Collective."""
    stepper = setup.stepper
    p = stepper.nodal_momentum()
    sizes = [np.linalg.norm(q, axis=1).sum() for q in (p, np.cross(stepper.x[: len(p)], p))]
    return stepper.u.function_space.mesh.comm.allreduce(np.array(sizes))


def _read(table: Path) -> dict[str, Any]:
    with table.open(newline="") as file:
        header, *rows = list(csv.reader(file))
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


def _errors(values: dict[str, Any], setup: Setup, scales: Any) -> dict[str, Any]:
    """Columns of the table, computed from the columns of the recorder."""
    works = [v for name, v in values.items() if name.startswith("energy_")]
    total = values["total_energy"]
    if setup.ledger:
        change, scale = values["energy_unaccounted"], max(total.max(), np.abs(works).max())
    else:
        change, scale = total - total[0], np.abs(total).max()
    gap = values["min_gap"]
    result = {
        "energy_error": _relative(change, scale),
        "min_gap": np.nanmin(gap) if np.isfinite(gap).any() else "",
    }
    if not setup.supported:
        impulse = [values["dt"] * load for load in _outer(values, setup)]
        for name, rate, scale in zip(
            ("momentum", "angular_momentum"), np.split(np.array(impulse), 2), scales, strict=True
        ):
            kind = "linear_momentum" if name == "momentum" else name
            drift = _vector(values, kind) - np.cumsum(rate, axis=1)
            size = np.linalg.norm(drift - drift[:, :1], axis=0)
            result[f"{name}_error"] = _relative(size, scale)
    return result


def _outer(values: dict[str, Any], setup: Setup) -> Any:
    """Force and torque (6, steps) of obstacles in each step."""
    total = np.zeros((6, len(values["step"])))
    pairs = setup.stepper.pairs
    for name, pair in zip(pair_names(pairs), pairs, strict=True):
        if isinstance(pair.segments, Obstacle):
            total[:3] += _vector(values, f"pair_{name}_force")
            total[3:] += _vector(values, f"pair_{name}_torque")
    return total


def _vector(values: dict[str, Any], name: str) -> Any:
    return np.array([values[f"{name}_{axis}"] for axis in "xyz"])


def _relative(change: Any, scale: float) -> float:
    size = np.abs(change)
    # Not max(), which would drop a NaN.
    return float(np.max(size)) / scale if scale > 0 else float(np.max(size))


def _too_large(row: dict[str, Any], values: dict[str, Any], case: Case) -> str:
    must = {name: column for name, column in values.items() if name != "min_gap"}
    if bad := [name for name, column in must.items() if not np.isfinite(column).all()]:
        return f"not finite: {', '.join(bad)}"
    limits = {
        "energy_error": case.energy_error,
        "momentum_error": MOMENTUM_TOLERANCE,
        "angular_momentum_error": MOMENTUM_TOLERANCE,
    }
    found: Sequence[str] = [
        f"{name} {row[name]:.1e} > {limit:g}"
        for name, limit in limits.items()
        if row[name] != "" and not row[name] <= limit
    ]
    return "; ".join(found)
