"""Pictures, diagrams and movies of a run, one call each."""

from dolfinx_nts.plotting.pictures import (
    animate,
    contact,
    energies,
    energy_error,
    forces,
    momenta,
    show,
    snapshot,
)

__all__ = [
    "animate",
    "contact",
    "energies",
    "energy_error",
    "forces",
    "momenta",
    "show",
    "snapshot",
]
