"""Energy-momentum consistent contact and impact for DOLFINx.

The public interface is in ``__all__``: declarations of bodies, surfaces, loads and contact pairs,
time integrators, and functions that record and draw a run.
"""

from dolfinx_nts.common import installation  # noqa: F401, before all that imports DOLFINx

# isort: split
from dolfinx_nts.common import compiled  # noqa: F401, before all that uses the compiled module

# isort: split
from dolfinx_nts import plotting
from dolfinx_nts.contact.builders import all_pairs, boundary_of, two_half_passes
from dolfinx_nts.contact.close_gaps import close_gaps
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Penalty, Tied
from dolfinx_nts.contact.friction.laws import (
    Coulomb,
    FrictionLaw,
    FrictionNodes,
    SlipWeakening,
    Stribeck,
    Tresca,
)
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.diagnostics.balance import Balance, Diagnostics
from dolfinx_nts.diagnostics.bodies import BodyBalance
from dolfinx_nts.diagnostics.contact import PairBalance
from dolfinx_nts.diagnostics.fields import Fields
from dolfinx_nts.fem.axisymmetry import axisymmetric
from dolfinx_nts.gradients.gradient import Gradient
from dolfinx_nts.integrators.conditions import ContactForce
from dolfinx_nts.integrators.explicit.central_difference import CentralDifference
from dolfinx_nts.integrators.implicit.generalized_alpha import (
    GeneralizedAlpha,
    Newmark,
    NewmarkRates,
)
from dolfinx_nts.integrators.implicit.implicit_stepper import ImplicitStepper
from dolfinx_nts.integrators.implicit.schemes import EnergyMomentum, Midpoint
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.statics.quasi_static import QuasiStatic
from dolfinx_nts.integrators.statistics import StepperStatistics
from dolfinx_nts.integrators.step_control import StepControl
from dolfinx_nts.io.load_state import load_state
from dolfinx_nts.io.recorder import Recorder
from dolfinx_nts.materials.fibres import HolzapfelGasserOgden
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.library import MooneyRivlin, NeoHookean, SaintVenantKirchhoff, Yeoh
from dolfinx_nts.materials.ogden import Ogden
from dolfinx_nts.materials.plane_stress import PlaneStress
from dolfinx_nts.materials.plasticity import J2Plasticity
from dolfinx_nts.meshing import examples, parts
from dolfinx_nts.meshing.gmsh import MeshData, read_mesh
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.guide import Guide
from dolfinx_nts.model.loads.body_loads import BodyForce, Gravity
from dolfinx_nts.model.loads.form_load import FormLoad
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.model.loads.resultants import Force, Moment
from dolfinx_nts.model.loads.surface_loads import Pressure, Traction
from dolfinx_nts.model.obstacles.exact_obstacle import ExactObstacle
from dolfinx_nts.model.obstacles.motion import Motion
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rigid_cone import RigidCone
from dolfinx_nts.model.obstacles.rigid_shapes import RigidCylinder, RigidPlane, RigidSphere
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.model.rigid_body import RigidBody
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel.errors import end_together
from dolfinx_nts.parallel.signals import restore_broken_pipe
from dolfinx_nts.search.overlap.overlaps import Overlap
from dolfinx_nts.solvers.newton_report import ConvergenceError

__version__ = "0.2.0"

# From here on an error on one rank ends the program on all ranks, so that none of them waits
# forever.
end_together()
# The imports above have initialised PETSc, which replaces the signal handler.
restore_broken_pipe()

__all__ = [
    "Balance",
    "Body",
    "BodyBalance",
    "BodyForce",
    "CentralDifference",
    "ContactForce",
    "ContactPair",
    "ConvergenceError",
    "Coulomb",
    "Diagnostics",
    "EnergyMomentum",
    "ExactObstacle",
    "Fields",
    "Force",
    "FormLoad",
    "FrictionLaw",
    "FrictionNodes",
    "GeneralizedAlpha",
    "Gradient",
    "Gravity",
    "Guide",
    "HolzapfelGasserOgden",
    "Hyperelastic",
    "ImplicitStepper",
    "J2Plasticity",
    "LagrangeMultiplier",
    "Load",
    "MeshData",
    "Midpoint",
    "Moment",
    "MooneyRivlin",
    "Motion",
    "NeoHookean",
    "Newmark",
    "NewmarkRates",
    "Obstacle",
    "Ogden",
    "Overlap",
    "PairBalance",
    "Penalty",
    "PlaneStress",
    "Pressure",
    "QuasiStatic",
    "Reaction",
    "Recorder",
    "RigidBody",
    "RigidCone",
    "RigidCylinder",
    "RigidPlane",
    "RigidSphere",
    "RigidSurface",
    "SaintVenantKirchhoff",
    "Scheme",
    "SlipWeakening",
    "StepControl",
    "StepReport",
    "StepperStatistics",
    "Stribeck",
    "Surface",
    "Tied",
    "Traction",
    "Tresca",
    "Yeoh",
    "all_pairs",
    "axisymmetric",
    "boundary_of",
    "close_gaps",
    "examples",
    "load_state",
    "parts",
    "plotting",
    "read_mesh",
    "two_half_passes",
]


def __dir__() -> list[str]:
    """List the public names only, for `dir` and for completion at a prompt."""
    return sorted([*__all__, "__version__"])
