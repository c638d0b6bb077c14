"""Summary of a run: a few lines for the log, after its end."""

import time

from dolfinx_nts.diagnostics.energy_ledger import EnergyLedger
from dolfinx_nts.integrators.stepper import Stepper

__all__ = ["Summary"]


class Summary:
    """Measures the wall time of a run and describes the run. Local.

    Args:
        name: Name of the run.
        stepper: Stepper of the run.
    """

    def __init__(self, name: str, stepper: Stepper) -> None:
        self._name, self._stepper = name, stepper
        self._before = dict(stepper.timings.seconds)
        self._start = time.perf_counter()
        self._end: float | None = None

    def stop(self) -> None:
        """Stop the clock."""
        self._end = time.perf_counter()

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
            unaccounted for, and overlaps; then, after a line ``solver``, Newton iterations,
            laws of the pairs, work of the linear solver, and wall time by phase [s] on this
            rank.
        """
        phases = {
            name: seconds - self._before.get(name, 0.0)
            for name, seconds in self._stepper.timings.seconds.items()
        }
        duration = self._duration
        phases["other"] = duration - sum(phases.values())
        times = ", ".join(f"{name} {seconds:.1f}" for name, seconds in phases.items())
        time_span = f"from t = {ledger.first.time:g} to {ledger.last.time:g} s"
        return "\n".join(
            [
                f"{self._name}: {ledger.num_steps} steps {time_span}",
                *ledger.drifts(),
                *(
                    f"{o.names[0]}: up to {o.depth:.3g} inside {o.names[1]}"
                    for o in self._stepper.watch.overlaps.deepest.values()
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
