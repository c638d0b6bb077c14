"""One process computes a scene with all settings, whose steps alternate.

Run as ``python3 -m benchmarks.defaults.run '"name of the scene"'``, which prints the results as
JSON.
"""

import json
import logging
import sys
import time
from collections.abc import Iterator
from typing import Any

import dolfinx_nts as nts
from benchmarks.defaults.scenes import SCENES
from benchmarks.defaults.settings import BASE, METHODS, SETTINGS, Setting

__all__ = ["measure"]

# Relative change of the energy that counts as a separate error [-]: of the rebound, which users of
# an energy-momentum scheme expect to be exact.
ENERGY = 1e-3
# Largest CPU time of a run relative to that of the base setting, after which it counts as failed.
_LONGEST = 20.0
# CPU time of a run that is always accepted [s].
_SHORT = 20.0


class _Run:
    """Run of a scene with one setting, until its end or its failure.

    Args:
        name: Name of the scene.
        setting: The setting.
    """

    def __init__(self, name: str, setting: Setting) -> None:
        self._kind, self.cpu, self.failure = SCENES[name], 0.0, ""
        self._newton = self._steps = 0
        self._energy = 0.0
        self.is_over = False
        try:
            self._scene = scene = self._kind.build(setting)
            self._diagnostics = nts.Diagnostics(scene.stepper)
            self._start = self._diagnostics.balance().total_energy
            self._advance: Iterator[Any] = scene.stepper.run(until=scene.t_end)
        except (TypeError, ValueError, NotImplementedError) as refusal:
            self._fail("refused", refusal)

    def advance(self) -> None:
        """Make a step."""
        start = time.process_time()
        try:
            step = next(self._advance, None)
        except (ArithmeticError, RuntimeError, ValueError) as error:
            self._fail("failed", error)
            return
        self.cpu += time.process_time() - start
        if step is None:
            self.is_over = True
            return
        self._newton += step.newton_iterations
        self._steps += 1
        if self._kind.conserves:
            energy = self._diagnostics.balance().total_energy / self._start - 1
            self._energy = energy if abs(energy) > abs(self._energy) else self._energy
        self._scene.record()

    def too_long(self, base: float) -> None:
        """End the run if its CPU time is far above ``base``, that of the base setting [s]."""
        if not self.is_over and self.cpu > max(_SHORT, _LONGEST * base):
            self._fail("failed", f"took more than {_LONGEST:g} times as long")

    def _fail(self, how: str, why: object) -> None:
        """End without a result."""
        self.failure = f"{how}: {' '.join(str(why).split())[:160]}"
        self.is_over = True

    def result(self, name: str, setting: str, base: float) -> dict[str, Any]:
        """Arguments of `Result`; ``base`` is the CPU time of the base setting [s]."""
        row: dict[str, Any] = {"scene": name, "setting": setting, "contact": self._kind.contact}
        if self.failure:
            return {**row, "errors": {}, "failure": self.failure}
        errors = self._scene.judge()
        parts = [errors[quantity] / t for quantity, t in self._kind.tolerances.items()]
        parts.append(abs(self._energy) / ENERGY)
        return {
            **row,
            "errors": errors,
            "error": max(parts),
            "energy": abs(self._energy),
            "cost": self.cpu / base,
            "newton": self._newton / self._steps,
        }


def measure(name: str) -> list[dict[str, Any]]:
    """Results of all settings in a scene, arguments of `Result`."""
    # Warnings concern unreasonable settings only.
    logging.getLogger("dolfinx_nts").setLevel(logging.ERROR)
    settings = {key: setting for key, setting in SETTINGS.items() if own_method(name, setting)}
    runs = {key: _Run(name, setting) for key, setting in settings.items()}
    while left := [run for run in runs.values() if not run.is_over]:
        for run in left:
            run.advance()
            if runs[BASE].is_over:
                run.too_long(runs[BASE].cpu)
    base = runs[BASE].cpu
    rows = {settings[key]: run.result(name, key, base) for key, run in runs.items()}
    # Where a method does not exist, results are those of node-to-segment contact.
    found = []
    for key, setting in SETTINGS.items():
        instead = setting if setting in rows else setting._replace(method=METHODS[0])
        found.append({**rows[instead], "setting": key})
    return found


def own_method(name: str, setting: Setting) -> bool:
    """Whether the method of a setting exists for the contact of a scene."""
    return setting.method in (None, METHODS[0]) or SCENES[name].contact not in ("obstacle", "self")


if __name__ == "__main__":
    print("ROW", json.dumps(measure(json.loads(sys.argv[1]))))
