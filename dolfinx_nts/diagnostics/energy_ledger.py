"""Energy ledger of a run: the change of the total energy by cause."""

import math
from dataclasses import fields
from operator import attrgetter

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.diagnostics.balance import Balance
from dolfinx_nts.integrators.report import StepReport

__all__ = ["EnergyLedger"]

# Quantities that may be conserved, with units.
_CONSERVED = {"total_energy": "J", "linear_momentum": "kg m/s", "angular_momentum": "kg m^2/s"}
# Energy added by bulk and inertia, relative to the total energy [-], above which it is reported.
# Smaller: reports of runs whose energies are still useful; larger: reports some steps later.
# Measured with a spinning bar: conserving schemes 1e-16, unstable ones 2 to 180 within 12 steps.
_SPURIOUS = 0.1
# Causes of changes of the total energy, except the bulk, with their work in a step report.
_WORKS = {
    "loads": "load_work",
    "supports": "support_work",
    "obstacles": "contact_work.obstacles",
    "damping": "damping_work",
    "persistent_contact": "contact_work.persistent",
    "activation": "contact_work.activation",
    "facet_change": "contact_work.facet_change",
    "friction": "contact_work.friction",
    "solver": "solver_work",
    "surface_equilibrium": "contact_work.equilibrium",
    "refund": "contact_work.refund",
}
_works_of = attrgetter(*_WORKS.values())
# Column names of all causes.
_CAUSES = ("bulk", *_WORKS)
_NAMES = [f"energy_{cause}" for cause in _CAUSES]


class EnergyLedger:
    """Sums of the works of all steps since a first state, by cause.

    Local, except for `serialize`; the sums are the same on all ranks.

    Args:
        step: Number of the last step before the first state.
        balance: Energies and momenta of the first state.
        num_loads: Number of loads.
        num_supports: Number of supports.

    Attributes:
        step: Number of the last step.
        first: Energies and momenta of the first state.
        last: Energies and momenta of the last state.
        num_steps: Number of steps since the first state.
        num_iterations: Number of Newton iterations in them.
        most_iterations: Largest number of iterations in one of them.
        energy: Change of the total energy since the first state by cause [J].
        drift: Largest change of each quantity that may be conserved, by name, and the largest
            ``"unaccounted"`` change of the energy [J].
        each: Works of each of the ``"loads"`` and ``"supports"`` [J].
    """

    def __init__(
        self, step: int, balance: Balance, num_loads: int = 0, num_supports: int = 0
    ) -> None:
        self.step = step
        self.first = self.last = balance
        self.num_steps = self.num_iterations = self.most_iterations = 0
        self.energy = dict.fromkeys(_CAUSES, 0.0)
        self.drift = dict.fromkeys((*_CONSERVED, "unaccounted"), 0.0)
        self.each: dict[str, Floats] = {
            "loads": np.zeros(num_loads),
            "supports": np.zeros(num_supports),
        }

    def add(self, step: StepReport, bulk_defect: float, balance: Balance) -> None:
        """Add a step to the sums.

        Args:
            step: Report of the step.
            bulk_defect: `Diagnostics.bulk_defect` after the step [J].
            balance: Numbers of the state after the step.
        """
        self.energy["bulk"] += bulk_defect
        for cause, work in zip(_WORKS, _works_of(step), strict=True):
            self.energy[cause] += work
        self.step, self.last = step.step, balance
        self.num_steps += 1
        self.num_iterations += step.newton_iterations
        self.most_iterations = max(self.most_iterations, step.newton_iterations)
        if step.load_works:
            self.each["loads"] = self.each["loads"] + step.load_works
        if step.reactions:
            self.each["supports"] = self.each["supports"] + [r.work for r in step.reactions]
        self.drift["unaccounted"] = max(self.drift["unaccounted"], abs(self.unaccounted))
        for name in _CONSERVED:
            change = getattr(balance, name) - getattr(self.first, name)
            size = math.sqrt(change @ change) if isinstance(change, np.ndarray) else abs(change)
            self.drift[name] = max(self.drift[name], size)

    def serialize(self, archive: Archive) -> None:
        """Serialize all sums. Collective."""
        for name in ("step", "num_steps", "num_iterations", "most_iterations"):
            setattr(self, name, archive.same(f"ledger/{name}", getattr(self, name)))
        for group in ("energy", "drift", "each"):
            sums = getattr(self, group)
            for name in sums:
                sums[name] = archive.same(f"ledger/{group}/{name}", sums[name])
        for name in ("first", "last"):
            balance = getattr(self, name)
            numbers = {
                key: archive.same(f"ledger/{name}/{key}", getattr(balance, key))
                for key in (field.name for field in fields(Balance))
            }
            setattr(self, name, Balance(**numbers))

    @property
    def unaccounted(self) -> float:
        """Change of the total energy without a known cause [J]."""
        return self.last.total_energy - self.first.total_energy - sum(self.energy.values())

    @property
    def spurious_gain(self) -> float:
        """Energy added by bulk and inertia [J]; 0 if small relative to the total energy."""
        energies = self.first.total_energy, self.last.total_energy
        scale = max(*map(abs, energies), self.drift["total_energy"])
        # Compared with the unaccounted energy as well, since the energy of a body at rest may be
        # round-off.
        least = max(_SPURIOUS * scale, self.drift["unaccounted"])
        return self.energy["bulk"] if self.energy["bulk"] > least else 0.0

    def columns(self) -> dict[str, float]:
        """Sums by name [J]: causes, remainder, external work and frictional dissipation."""
        energy = self.energy
        return {
            **dict(zip(_NAMES, energy.values(), strict=True)),
            "energy_unaccounted": self.unaccounted,
            "external_work": energy["loads"] + energy["supports"] + energy["obstacles"],
            "friction_dissipation": -energy["friction"],
        }

    def iterations(self) -> str:
        """Summary line of the Newton iterations."""
        mean = self.num_iterations / max(self.num_steps, 1)
        return (
            f"Newton iterations: {self.num_iterations}, mean {mean:.2f}, max {self.most_iterations}"
        )

    def energies(self) -> list[str]:
        """Summary lines of the energies of statics, without zeros."""
        values = {
            "strain energy": self.last.strain_energy,
            "energy of contact springs": self.last.contact_energy,
            "dissipation by friction": -self.energy["friction"],
            "dissipation in the material": -self.energy["damping"],
        }
        return [f"{name}: {value:.6g} J" for name, value in values.items() if value]

    def drifts(self) -> list[str]:
        """Summary lines of conserved quantities and of the ledger."""
        return [
            *(
                f"{name.replace('_', ' ')}: {np.linalg.norm(getattr(self.first, name)):.6g} "
                f"{unit}, largest change {self.drift[name]:.1e} {unit}"
                for name, unit in _CONSERVED.items()
                if np.size(getattr(self.first, name))  # none in axisymmetric meshes
            ),
            f"energy unaccounted for: at most {self.drift['unaccounted']:.1e} J",
        ]
