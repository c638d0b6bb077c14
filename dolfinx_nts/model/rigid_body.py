"""Free rigid bodies: meshed regions with mass and inertia that do not deform."""

from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_nts.materials.mass_only import Rigid
from dolfinx_nts.model.bodies import Body

__all__ = ["RigidBody"]


class RigidBody(Body):
    """A body that moves freely and does not deform. Collective.

    Mass, centre of mass and inertia are those of its mesh. Other bodies meet it by its surface,
    as that of any body, and it may share nodes with deformable bodies, which are then bonded to
    it. Six numbers say how it moves in a step, in the plane three.

    Args:
        V: Space of the displacement, see `Body`.
        cells: Cell tags of the mesh.
        tag: Value of the tag.
        rho: Reference density [kg/m^3].

    Attributes:
        material: Inertia without strain energy.

    Raises:
        TypeError: ``V`` is no function space, ``cells`` no MeshTags, or ``tag`` no integer.
        ValueError: The space or the tag does not fit, or the density is not positive: a body
            without mass could be anywhere.

    Example:
        >>> hammer = nts.RigidBody(V, cells, tag["upper"], rho=7800.0)  # kg/m^3
        >>> stepper = nts.EnergyMomentum([body, hammer], [pair], dt=0.01)
        >>> stepper.set_velocity(hammer, (0.0, 0.0, -1.0))
        >>> stepper.advance().num_active
        0
    """

    is_rigid = True

    def __init__(self, V: fem.FunctionSpace, cells: MeshTags, tag: int, rho: float) -> None:
        """Check the arguments, see `Body`."""
        super().__init__(V, cells, tag, Rigid(rho))
