"""Rigid bodies of a stepper: what they may take part in, and their motion."""

from collections.abc import Sequence
from itertools import combinations

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.components import dimension, nodal
from dolfinx_nts.integrators.rates import ConsistentMass, Rates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.model.rigid_body import RigidBody
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear_fields import LinearFields
from dolfinx_nts.solvers.rigid_motion import RigidMotion

__all__ = ["check_rigid_bodies", "rigid_motion"]


def check_rigid_bodies(
    bodies: Sequence[Body], pairs: Sequence[ContactPair], scheme: Scheme, name: str
) -> None:
    """Raise unless rigid bodies can take part in a scene. Collective.

    Args:
        bodies: All bodies.
        pairs: All contact pairs.
        scheme: The scheme.
        name: That of the stepper.

    Raises:
        ValueError: The scheme moves no rigid bodies, two of them share nodes, or there is impact
            "resolved".
    """
    rigid = [body for body in bodies if body.is_rigid]
    if not rigid:
        return
    V = rigid[0].V
    comm: MPI.Comm = V.mesh.comm
    names = ", ".join(body.name for body in rigid)
    if not scheme.moves_rigid_bodies:
        raise ValueError(
            f"expected EnergyMomentum, Midpoint or QuasiStatic with rigid bodies ({names}), given "
            f"{name}: there a stiff material, or a moving obstacle, can take their place"
        )
    for one, other in combinations(rigid, 2):
        common = np.intersect1d(one.nodes, other.nodes)
        owned = np.count_nonzero(common < V.dofmap.index_map.size_local)
        if count := reductions.total(comm, owned):
            raise ValueError(
                f"expected rigid bodies without common nodes, given {one.name} and {other.name} "
                f"with {count}: give both one tag, as one rigid body"
            )
    for pair in pairs:
        if is_resolved(pair):
            raise ValueError(
                f"expected impact 'elastic' or 'plastic' beside rigid bodies ({names}), given "
                f"'resolved' between {pair.between}"
            )


def rigid_motion(
    bodies: Sequence[Body], rates: Rates, scheme: Scheme, supports: Supports
) -> RigidMotion:
    """Make the motion of the rigid bodies among some bodies. Collective.

    Args:
        bodies: All bodies of a stepper.
        rates: How velocities follow from displacements.
        scheme: Tells where forces act.
        supports: Dirichlet conditions.

    Raises:
        ValueError: There are conditions on rigid bodies.
    """
    V = rates.u.function_space
    rigid = [body for body in bodies if isinstance(body, RigidBody)]
    fields, masses = [], []
    supported: Ints = np.unique(supports.fixed // dimension(V))
    for body in rigid:
        shared = len(np.intersect1d(supported, body.nodes))
        if count := reductions.total(V.mesh.comm, shared):
            raise ValueError(
                f"expected bcs at nodes of deformable bodies, given {count} nodes of the rigid "
                f"{body.name}: RigidBody(guide=) holds and leads it"
            )
        of_body = LinearFields(body, _given_point(body))
        mass = _mass(of_body)
        if body.guide is not None and body.guide.point is None:
            of_body = LinearFields(body, of_body.point + mass[0, 1:] / mass[0, 0])
            mass = _mass(of_body)
        fields.append(of_body)
        masses.append(mass)
    part = 1.0 if scheme.loads_at == "end" else 0.5
    return RigidMotion(V, fields, masses, rates.inertia_share, part)


def _given_point(body: RigidBody) -> Floats | None:
    """Guided point of a body, if there is one, shape ``(d,)`` [m]."""
    return None if body.guide is None else body.guide.point


def _mass(fields: LinearFields) -> Floats:
    """Products of the linear fields over a body with its mass, ``(d + 1, d + 1)`` [kg]."""
    # The consistent mass, as the balance of momentum has it.
    body = fields.body
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
