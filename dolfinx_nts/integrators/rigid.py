"""Rigid bodies of a stepper: what they may take part in, and their motion."""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import dimension, nodal
from dolfinx_nts.integrators.rates import ConsistentMass, Rates
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.rigid_motion import LinearFields, RigidMotion

__all__ = ["rigid_motion"]


def rigid_motion(bodies: Sequence[Body], rates: Rates) -> RigidMotion:
    """Make the motion of the rigid bodies among some bodies. Collective.

    Args:
        bodies: All bodies of a stepper.
        rates: How velocities follow from displacements.
    """
    V = rates.u.function_space
    rigid = [body for body in bodies if body.is_rigid]
    fields = [LinearFields(body) for body in rigid]
    masses = [_mass(body, of_body) for body, of_body in zip(rigid, fields, strict=True)]
    return RigidMotion(V, fields, masses, rates.inertia_share)


def _mass(body: Body, fields: LinearFields) -> Floats:
    """Products of the linear fields over a body with its mass, ``(d + 1, d + 1)`` [kg]."""
    # The consistent mass, which is that of the balance of momentum, as every node has it.
    field = fem.Function(body.V)
    mass, values = ConsistentMass([body], field), nodal(field)
    products = np.zeros((len(fields.reference),) * 2)
    for column, value in enumerate(fields.values.T):
        values[:] = 0.0
        values[fields.nodes, 0] = value
        field.x.scatter_forward()
        products[:, column] = fields.values.T @ mass.momentum()[fields.nodes, 0]
    total: Floats = reductions.total(body.V.mesh.comm, products)
    return total
