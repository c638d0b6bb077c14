"""Columns of the table of a run: totals, and columns of pairs, obstacles, bodies and supports."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, Literal, get_args

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arguments import did_you_mean, functions_by_name, real_array
from dolfinx_nts.diagnostics.balance import Diagnostics
from dolfinx_nts.diagnostics.energy_ledger import EnergyLedger
from dolfinx_nts.diagnostics.names import flat, part_names
from dolfinx_nts.fem.components import dimension, moments, resultants
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.model.rigid_body import guided
from dolfinx_nts.parallel.errors import agreed

__all__ = ["OwnColumn", "Parts", "RunColumns"]

Parts = Literal["pairs", "between", "obstacles", "supports", "loads", "bodies"]
# Returns a number or a vector for the current state of a stepper.
OwnColumn = Callable[[Stepper], Any]


class RunColumns:
    """Creates the rows of the table of a run.

    Args:
        diagnostics: Diagnostics of the stepper of the run.
        parts: Parts of the scene with their own columns.
        own: User-defined columns by name, see `Recorder`.

    Raises:
        ValueError: ``parts`` contains an unknown word.
    """

    def __init__(
        self,
        diagnostics: Diagnostics,
        parts: Collection[Parts],
        own: Mapping[str, OwnColumn] | None = None,
    ) -> None:
        if unknown := sorted(set(parts) - set(get_args(Parts))):
            names = ", ".join(map(repr, get_args(Parts)))
            raise ValueError(
                f"expected columns_of some of {names}, given {unknown}"
                f"{did_you_mean(unknown[0], get_args(Parts))}"
            )
        self._diagnostics, self._own = diagnostics, functions_by_name("own_columns", own or {})
        stepper = diagnostics.stepper
        self._V = stepper.u.function_space
        self._dim, self._zero = dimension(self._V), np.zeros(3)
        guides = part_names(
            "body",
            ((body.guide and body.guide.name) or body.name for body in guided(stepper.bodies)),
        )
        of_bcs = (f"support_{i}" for i in range(1, len(stepper.supports) + 1))
        self._supports = [*of_bcs, *(f"guide_{name}" for name in guides)]
        self._loads = part_names("load", (load.name for load in stepper.loads))
        groups: dict[str, Callable[[StepReport | None, EnergyLedger], dict[str, float]]] = {
            "pairs": self._of_pairs,
            "between": self._between_bodies,
            "obstacles": self._of_obstacles,
            "supports": self._of_supports,
            "loads": self._of_loads,
            "bodies": self._of_bodies,
        }
        self._groups = [group for name, group in groups.items() if name in parts]

    def row(self, step: StepReport | None, ledger: EnergyLedger) -> dict[str, float]:
        """Values of the current state by column name. Collective.

        Args:
            step: Report of the last step; None at the start.
            ledger: Sums of all steps, including the last one.
        """
        row = {
            "step": ledger.step,
            "time": ledger.last.time,
            "dt": 0.0 if step is None else step.dt,
            **ledger.last.columns(),
            "newton_iterations": 0 if step is None else step.newton_iterations,
            "rejected": 0 if step is None else step.rejected,
            **ledger.columns(),
        }
        for group in self._groups:
            row |= group(step, ledger)
        return row | self._of_user(row) if self._own else row

    def _of_user(self, row: Collection[str]) -> dict[str, float]:
        stepper, columns = self._diagnostics.stepper, dict[str, float]()
        comm: MPI.Comm = stepper.u.function_space.mesh.comm
        for name, function in self._own.items():
            with agreed(comm, f"evaluate the column {name}"):
                value = real_array(f"the column {name}", function(stepper))
                if value.shape not in ((), (self._dim,), resultants(self._zero, self._V).shape):
                    number = {2: "two", 3: "three"}[self._dim]
                    raise ValueError(
                        f"expected a number or {number} for the column {name}, given {value.shape}"
                    )
                columns |= flat("", {name: value})
                if taken := columns.keys() & row:
                    raise ValueError(
                        f"expected names that no other column has, given {min(taken)!r}"
                    )
        return columns

    def _of_pairs(self, step: StepReport | None, ledger: EnergyLedger) -> dict[str, float]:
        columns: dict[str, float] = {}
        for name, pair in self._diagnostics.pairs().items():
            columns |= pair.columns(f"pair_{name}_")
        return columns

    def _between_bodies(self, step: StepReport | None, ledger: EnergyLedger) -> dict[str, float]:
        forces = self._diagnostics.between()
        return flat("", {f"between_{name}_force": force for name, force in forces.items()})

    def _of_obstacles(self, step: StepReport | None, ledger: EnergyLedger) -> dict[str, float]:
        columns: dict[str, float] = {}
        for name, obstacle in self._diagnostics.obstacles().items():
            columns |= obstacle.columns(f"obstacle_{name}_")
        return columns

    def _of_supports(self, step: StepReport | None, ledger: EnergyLedger) -> dict[str, float]:
        columns: dict[str, float] = {}
        if not self._supports:
            return columns
        works = ledger.each["supports"]
        force, moment = resultants(self._zero, self._V), moments(self._zero, self._V)
        nothing = Reaction(tuple(map(float, force)), tuple(map(float, moment)), 0.0)
        reactions = [nothing] * len(works) if step is None else step.reactions
        for name, reaction, work in zip(self._supports, reactions, works, strict=True):
            values = {"force": reaction.force, "moment": reaction.moment, "work": float(work)}
            columns |= flat(f"{name}_", values)
        return columns

    def _of_loads(self, step: StepReport | None, ledger: EnergyLedger) -> dict[str, float]:
        works = zip(self._loads, ledger.each["loads"], strict=True)
        return {f"load_{name}_work": float(work) for name, work in works}

    def _of_bodies(self, step: StepReport | None, ledger: EnergyLedger) -> dict[str, float]:
        columns: dict[str, float] = {}
        for name, body in self._diagnostics.bodies().items():
            columns |= body.columns(f"body_{name}_")
        return columns
