"""Energy-momentum consistent node-to-segment contact for DOLFINx."""

from dolfinx_nts.contact.builders import all_pairs, boundary_of, two_half_passes
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.contact.friction import Coulomb
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.diagnostics.balance import Diagnostics
from dolfinx_nts.integrators.central_difference import CentralDifference
from dolfinx_nts.integrators.generalized_alpha import GeneralizedAlpha
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.schemes import EnergyMomentum, Midpoint, QuasiStatic
from dolfinx_nts.integrators.step_control import StepControl
from dolfinx_nts.io.recorder import Recorder
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.library import MooneyRivlin, NeoHookean, SaintVenantKirchhoff, Yeoh
from dolfinx_nts.meshing import parts
from dolfinx_nts.meshing.gmsh import MeshData, read_mesh
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.loads import BodyForce, FormLoad, Gravity, Pressure, Traction
from dolfinx_nts.model.obstacles import RigidCylinder, RigidPlane, RigidSphere
from dolfinx_nts.model.rigid_surface import RigidSurface
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.solvers.newton import ConvergenceError

__version__ = "0.1.0"

__all__ = [
    "Body",
    "BodyForce",
    "CentralDifference",
    "ContactPair",
    "ConvergenceError",
    "Coulomb",
    "Diagnostics",
    "EnergyMomentum",
    "FormLoad",
    "GeneralizedAlpha",
    "Gravity",
    "Hyperelastic",
    "LagrangeMultiplier",
    "MeshData",
    "Midpoint",
    "MooneyRivlin",
    "NeoHookean",
    "Penalty",
    "Pressure",
    "QuasiStatic",
    "Recorder",
    "RigidCylinder",
    "RigidPlane",
    "RigidSphere",
    "RigidSurface",
    "SaintVenantKirchhoff",
    "StepControl",
    "StepReport",
    "Surface",
    "Traction",
    "Yeoh",
    "all_pairs",
    "boundary_of",
    "parts",
    "read_mesh",
    "two_half_passes",
]
