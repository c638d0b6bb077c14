"""Summary of a run for the log."""

import time
from collections.abc import Iterable

import numpy as np

from dolfinx_nts.diagnostics.balance import Diagnostics
from dolfinx_nts.diagnostics.energy_ledger import EnergyLedger
from dolfinx_nts.fem.components import nodal
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.statics.quasi_static import QuasiStatic
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.parallel import reductions

__all__ = ["Summary"]

# Components of a vector, relative to its largest one [-], below which zero is printed: larger than
# the round-off of equilibria, smaller than the last printed digit.
_ROUND_OFF = 1e-6


class Summary:
    """Wall time and summary of a run. Local.

    Args:
        name: Name of the run.
        stepper: Stepper of the run.
    """

    def __init__(self, name: str, stepper: Stepper) -> None:
        self._name, self._stepper = name, stepper
        self._before = dict(stepper.timings.seconds)
        self._start = time.perf_counter()
        self._end: float | None = None
        self._static: list[str] = []

    def describe_equilibrium(self, diagnostics: Diagnostics, step: StepReport | None) -> None:
        """Describe the last state of a static run. Collective.

        Args:
            diagnostics: Diagnostics of the stepper.
            step: Report of the last step; None before the first one.
        """
        stepper = self._stepper
        V = stepper.u.function_space
        size = np.linalg.norm(nodal(stepper.u)[: V.dofmap.index_map.size_local], axis=1)
        largest = reductions.largest(V.mesh.comm, float(size.max(initial=0.0)))
        lines = [f"largest displacement: {largest:.4g} m"]
        for name, pair in diagnostics.pairs().items():
            text = f"contact force of pair {name}: {_vector(pair.force)} N"
            lines.append(f"{text}, largest pressure {pair.largest_pressure:.4g} Pa")
        forces = [reaction.force for reaction in step.reactions] if step else []
        for number, force in enumerate(forces[: len(stepper.supports)], start=1):
            lines.append(f"reaction of support {number}: {_vector(force)} N")
        self._static = lines

    def stop(self) -> None:
        """Stop the clock."""
        self._end = time.perf_counter()

    @property
    def _is_static(self) -> bool:
        return isinstance(self._stepper, QuasiStatic)

    @property
    def _duration(self) -> float:
        """Wall time until the clock was stopped, or until now [s]."""
        return (time.perf_counter() if self._end is None else self._end) - self._start

    def text(self, ledger: EnergyLedger) -> str:
        """Describe the run.

        Args:
            ledger: Steps and energies of the run.

        Returns:
            Lines with the number of steps, changes of conserved quantities, the energy that is
            unaccounted for, and overlaps. In statics the last displacement, forces and pressures
            replace momenta. After a line ``solver``: Newton iterations, laws of the pairs, work of
            the linear solver, and wall time by phase [s] on this rank.
        """
        phases = {
            name: seconds - self._before.get(name, 0.0)
            for name, seconds in self._stepper.timings.seconds.items()
        }
        duration = self._duration
        phases["other"] = duration - sum(phases.values())
        times = ", ".join(f"{name} {_seconds(s)}" for name, s in phases.items() if s)
        watch = self._stepper.watch.overlaps
        overlaps = [(each, watch.deepest_at[names]) for names, each in watch.deepest.items()]
        time_span = f"from t = {ledger.first.time:g} to {ledger.last.time:g} s"
        return "\n".join(
            [
                f"{self._name}: {ledger.num_steps} steps {time_span}",
                *(ledger.energies() if self._is_static else ledger.drifts()),
                *self._static,
                *(
                    f"{o.names[0]} overlaps {o.names[1]} by up to {o.depth:.3g} m at t = {t:g} s"
                    for o, t in overlaps
                ),
                "solver",
                *(
                    f"  {line}"
                    for line in (
                        ledger.iterations(),
                        *str(self._stepper.statistics).splitlines(),
                        f"wall time: {duration:.1f} s ({times})",
                    )
                ),
            ]
        )


def _vector(values: Iterable[float]) -> str:
    """Components of a vector, with zero in place of round-off of the largest one."""
    numbers = [float(value) for value in values]
    least = _ROUND_OFF * max((abs(number) for number in numbers), default=0.0)
    texts = [f"{number:.4g}" if abs(number) > least else "0" for number in numbers]
    return f"({', '.join(texts)})" if len(texts) != 1 else texts[0]


def _seconds(value: float) -> str:
    """Seconds with one decimal, or with one significant digit if that would be zero."""
    return f"{value:.1f}" if abs(value) >= 0.05 else f"{value:.1g}"
