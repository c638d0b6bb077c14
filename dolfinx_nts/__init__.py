"""Energy-momentum consistent node-to-segment contact for DOLFINx."""

from dolfinx_nts.bodies import Body
from dolfinx_nts.contact import ContactPair
from dolfinx_nts.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.friction import Coulomb
from dolfinx_nts.integrators import EnergyMomentum, Midpoint, StepReport
from dolfinx_nts.materials import Hyperelastic, SaintVenantKirchhoff
from dolfinx_nts.meshing import MeshData, read_mesh
from dolfinx_nts.newton import ConvergenceError
from dolfinx_nts.surfaces import Surface

__version__ = "0.1.0"

__all__ = [
    "Body",
    "ContactPair",
    "ConvergenceError",
    "Coulomb",
    "EnergyMomentum",
    "Hyperelastic",
    "LagrangeMultiplier",
    "MeshData",
    "Midpoint",
    "Penalty",
    "SaintVenantKirchhoff",
    "StepReport",
    "Surface",
    "read_mesh",
]
