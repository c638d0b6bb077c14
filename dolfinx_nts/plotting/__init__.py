"""Pictures, diagrams and movies of a run, by one call each."""

from dolfinx_nts.plotting.picture import Picture
from dolfinx_nts.plotting.pictures import (
    animate,
    contact,
    energies,
    energy_error,
    force_displacement,
    forces,
    ledger,
    momenta,
    show,
    snapshot,
)

__all__ = [
    "Picture",
    "animate",
    "contact",
    "energies",
    "energy_error",
    "force_displacement",
    "forces",
    "ledger",
    "momenta",
    "show",
    "snapshot",
]
