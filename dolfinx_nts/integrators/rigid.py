"""Rigid bodies of a stepper: checks, motion, and contact stiffness."""

from collections.abc import Callable, Sequence
from itertools import combinations

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.components import dimension, nodal
from dolfinx_nts.integrators.explicit.leapfrog import RigidLeapfrog
from dolfinx_nts.integrators.rates import ConsistentMass, Rates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.rigid_body import RigidBody
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.rigid.linear_fields import LinearFields
from dolfinx_nts.solvers.rigid.rigid_motion import RigidMotion

__all__ = [
    "check_closed_contact",
    "check_rigid_bodies",
    "check_statics",
    "contact_stiffness",
    "gives_rigid_nodes",
    "redundant",
    "rigid_leapfrog",
    "rigid_motion",
    "spring_stiffness",
]

# Effective mass at a surface point of a rotating body relative to its mass [-].
_AT_A_POINT = 0.25


def check_rigid_bodies(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> None:
    """Check the rigid bodies of a scene. Collective.

    Args:
        bodies: All bodies.
        pairs: All contact pairs.

    Raises:
        ValueError: Two rigid bodies share nodes; a pair with impact "resolved" has rigid nodes, or
            is combined with guides; or a sphere is the shape of several or deformable bodies.
    """
    V, rigid = bodies[0].V, [body for body in bodies if isinstance(body, RigidBody)]
    comm: MPI.Comm = V.mesh.comm
    for segments in (pair.segments for pair in pairs):
        if isinstance(segments, Surface) and isinstance(segments.smooth, RigidSphere):
            around = [bool(np.isin(segments.segments, body.nodes).all()) for body in rigid]
            if not reductions.everywhere(comm, np.array(around, dtype=bool)).any():
                raise ValueError(
                    f"expected {segments.smooth!r} as the shape of one RigidBody, given "
                    f"{segments.name}, which is on no such body: use smooth=True for it"
                )
    if not rigid:
        return
    names = ", ".join(body.name for body in rigid)
    for one, other in combinations(rigid, 2):
        common = np.intersect1d(one.nodes, other.nodes)
        owned = np.count_nonzero(common < V.dofmap.index_map.size_local)
        if count := reductions.total(comm, owned):
            raise ValueError(
                f"expected rigid bodies without common nodes, given {one.name} and {other.name} "
                f"with {count}: make them one rigid body, with one tag"
            )
    resolved = [pair for pair in pairs if is_resolved(pair)]
    guided = ", ".join(body.name for body in rigid if body.guide is not None)
    if resolved and guided:
        raise ValueError(
            "expected rigid bodies without a guide together with impact 'resolved', given "
            f"guide= of {guided}: remove the guide, or use impact 'elastic'"
        )
    for pair in resolved:
        if gives_rigid_nodes(pair, rigid):
            raise ValueError(
                f"expected nodes of deformable bodies with impact 'resolved', given {names} "
                f"between {pair.between}: exchange nodes and segments, or use impact 'elastic'"
            )


def check_statics(bodies: Sequence[Body], fixed: Ints) -> None:
    """Check that some node deforms in statics with rigid bodies. Collective.

    Args:
        bodies: All bodies.
        fixed: Owned scalar dofs of the space whose displacement is prescribed.

    Raises:
        ValueError: All bodies are rigid, or all nodes of the others are prescribed.
    """
    V, rigid = bodies[0].V, [body for body in bodies if body.is_rigid]
    if not rigid:
        return
    comm: MPI.Comm = V.mesh.comm
    free = np.ones((V.dofmap.index_map.size_local, dimension(V)), dtype=bool)
    free.ravel()[fixed] = False
    free[np.concatenate([_owned(body, len(free)) for body in rigid])] = False
    if reductions.anywhere(comm, bool(free.any())):
        return
    names = "rigid ones alone (" + ", ".join(body.name for body in rigid) + ")"
    if prescribed := ", ".join(body.name for body in bodies if not body.is_rigid):
        names += f" and with all displacements prescribed ({prescribed})"
    raise ValueError(
        f"expected a body that deforms in statics, given {names}: use EnergyMomentum, or a stiff "
        "material in place of one rigid body"
    )


def check_closed_contact(
    bodies: Sequence[Body], pairs: Sequence[ContactPair], stepper: str
) -> None:
    """Check pairs of a scheme with inertia that closes gaps at the end of a step. Collective.

    Elastic impact requires contact forces whose work in a step is defined by the gaps, which such
    schemes do not have. Multipliers at nodes of a rigid body would stop the whole body.

    Args:
        bodies: All bodies.
        pairs: The contact pairs.
        stepper: Name of the stepper.

    Raises:
        ValueError: A pair has multipliers that such a scheme does not support.
    """
    for pair in pairs:
        law = pair.enforcement
        if not isinstance(law, LagrangeMultiplier):
            continue
        if law.holds_gaps:
            raise ValueError(
                f"expected Penalty or LagrangeMultiplier('plastic') for {stepper}, given {law!r}"
            )
        if gives_rigid_nodes(pair, bodies):
            raise ValueError(
                f"expected Penalty for {stepper} between {pair.between}, given {law!r}: a "
                "multiplier at a node stops the whole rigid body, so that the scheme gains energy; "
                "use nodes of a deformable body, or EnergyMomentum"
            )


def gives_rigid_nodes(pair: ContactPair, bodies: Sequence[Body]) -> bool:
    """Whether any node of a pair belongs to a rigid body. Collective."""
    rigid = [body.nodes for body in bodies if body.is_rigid]
    comm: MPI.Comm = pair.nodes.V.mesh.comm
    found = bool(rigid) and bool(np.isin(pair.nodes.nodes, np.concatenate(rigid)).any())
    return reductions.anywhere(comm, found)


def rigid_motion(
    bodies: Sequence[Body], rates: Rates, scheme: Scheme, supports: Supports
) -> RigidMotion:
    """Motion of the rigid bodies of an implicit stepper. Collective.

    Args:
        bodies: All bodies of a stepper.
        rates: Relation between velocities and displacements.
        scheme: Scheme, which defines when forces act.
        supports: Dirichlet conditions.

    Raises:
        ValueError: There are conditions on rigid bodies.
    """
    fields, masses = _fields(bodies, supports)
    share = rates.inertia_share
    return RigidMotion(rates.u.function_space, fields, masses, share, scheme.load_point)


def rigid_leapfrog(
    bodies: Sequence[Body], v: fem.Function, mass: Floats, supports: Supports
) -> tuple[RigidLeapfrog, Floats]:
    """Motion of the rigid bodies of an explicit stepper. Collective.

    Args:
        bodies: All bodies of a stepper.
        v: Their velocity.
        mass: Lumped mass of all bodies at the owned nodes, shape ``(n,)`` [kg].
        supports: Dirichlet conditions.

    Returns:
        The motion; and lower bounds on the effective masses of the nodes, for the frequency of
        springs at them, shape ``(n,)`` [kg]. All nodes of a rigid body have the same bound; it is
        infinite if the guide of the body leaves no direction free.

    Raises:
        ValueError: There are conditions on rigid bodies.
    """
    V = bodies[0].V
    fields, masses = _fields(bodies, supports)
    deformable = [body for body in bodies if not body.is_rigid]
    bonded = lumped_mass(deformable) if deformable and fields else np.zeros_like(mass)
    comm: MPI.Comm = V.mesh.comm
    resisting, whole = mass.copy(), []
    for of_body, own in zip(fields, masses, strict=True):
        nodes, values = of_body.nodes, of_body.values
        parts = [values.T @ (bonded[nodes, None] * values), values.T @ values]
        shared, of_ones = reductions.total(comm, np.array(parts))
        whole.append(own + shared)
        if not len(of_body.free):
            resisting[nodes] = np.inf
            continue
        resisting[nodes] = np.linalg.eigvals(np.linalg.solve(of_ones, whole[-1])).real.min()
    return RigidLeapfrog(V, fields, whole, v), resisting


def _fields(bodies: Sequence[Body], supports: Supports) -> tuple[list[LinearFields], list[Floats]]:
    """Linear fields over the rigid bodies, and their mass products. Collective."""
    V = bodies[0].V
    rigid = [body for body in bodies if isinstance(body, RigidBody)]
    fields, masses = [], []
    supported: Ints = np.unique(supports.of_user // dimension(V))
    for body in rigid:
        shared = len(np.intersect1d(supported, body.nodes))
        if count := reductions.total(V.mesh.comm, shared):
            raise ValueError(
                f"expected bcs at nodes of deformable bodies, given {count} nodes of the rigid "
                f"{body.name}: use RigidBody(guide=) to fix or to move it"
            )
        of_body = LinearFields(body, _given_point(body))
        mass = _mass(of_body)
        if body.guide is not None and body.guide.point is None:
            of_body = LinearFields(body, of_body.point + mass[0, 1:] / mass[0, 0])
            mass = _mass(of_body)
        fields.append(of_body)
        masses.append(mass)
    return fields, masses


def contact_stiffness(
    stiffness: Floats, bodies: Sequence[Body], mass: Floats, rates: Rates
) -> Floats:
    """Stiffness of the owned nodes, which scales gaps and slips in contact conditions. Collective.

    For nodes of a rigid body it includes the inertia of the whole body.

    Args:
        stiffness: Mean diagonal entry of the tangent at each node, shape ``(n,)`` [N/m].
        bodies: All bodies.
        mass: Lumped masses of the nodes, shape ``(n,)`` [kg].
        rates: Relation between velocities and displacements.

    Returns:
        Stiffness, shape ``(n,)`` [N/m].
    """
    of_nodes = stiffness.copy()
    for nodes, share in _inertia(bodies, mass, rates):
        of_nodes[nodes] = np.maximum(stiffness[nodes], share)
    return of_nodes


def spring_stiffness(
    static: Callable[[], Floats],
    bodies: Sequence[Body],
    mass: Floats,
    rates: Rates,
    free: Floats | None,
) -> tuple[Floats, Floats]:
    """Stiffness of the owned nodes from which default penalties are derived. Collective.

    Args:
        static: Returns the static stiffness of the nodes, shape ``(n,)`` [N/m].
        bodies: All bodies.
        mass: Lumped masses of the nodes, shape ``(n,)`` [kg].
        rates: Relation between velocities and displacements.
        free: 1 where a displacement is unknown, 0 where it is prescribed, shape ``(n, d)``; None
            if all are unknown.

    Returns:
        Two stiffnesses, both ``(n,)`` [N/m]. The first is the static one: infinite at nodes of
        rigid bodies, NaN at other nodes with all displacements prescribed. The second is that of
        springs at nodes that do not deform, infinite at all others. With inertia it is the
        effective mass of a body divided by the square of the step: a body striking at a point then
        penetrates by about its motion in a step. In statics it is the largest static stiffness.

    Raises:
        ValueError: No node deforms, in statics.
    """
    of_cells, in_place = static().copy(), np.full(len(mass), np.inf)
    prescribed: Flags = np.zeros(len(mass), dtype=bool)
    if free is not None:
        prescribed = np.logical_not(free.any(axis=1), out=prescribed)
    of_cells[prescribed] = np.nan
    comm: MPI.Comm = bodies[0].V.mesh.comm
    for nodes, share in _inertia(bodies, mass, rates):
        of_cells[nodes], in_place[nodes], prescribed[nodes] = np.inf, share, False
    if rates.acceleration is None:
        deforms = np.isfinite(of_cells)
        greatest = reductions.largest(comm, float(of_cells[deforms].max(initial=0.0)))
        if greatest == 0:
            raise ValueError(
                "expected the stiffness of springs in statics if all displacements are "
                "prescribed, given none: set Penalty(eps_N=...), and eps_T of Coulomb"
            )
        in_place[~deforms] = greatest
    else:
        # Prescribed nodes are treated as a guided body: the mass of all bodies limits the force.
        whole = np.array([_AT_A_POINT * float(reductions.total(comm, mass.sum()))])
        in_place[prescribed] = rates.inertia_share(whole)[0]
    return of_cells, in_place


def _inertia(bodies: Sequence[Body], mass: Floats, rates: Rates) -> list[tuple[Ints, float]]:
    """Owned nodes of each rigid body, and its effective inertia in a step [N/m]. Collective.

    A body without free motions has the mass of all rigid bodies together.
    """
    rigid = [body for body in bodies if isinstance(body, RigidBody)]
    if not rigid:
        return []
    comm: MPI.Comm = rigid[0].V.mesh.comm
    nodes = [_owned(body, len(mass)) for body in rigid]
    masses = reductions.total(comm, np.array([mass[each].sum() for each in nodes]))
    is_guided = [not len(body.free()) for body in rigid]
    shares = rates.inertia_share(_AT_A_POINT * np.where(is_guided, masses.sum(), masses))
    return [(each, float(share)) for each, share in zip(nodes, shares, strict=True)]


def _owned(body: Body, n: int) -> Ints:
    """Owned nodes of a body, given the number n of all owned nodes."""
    return body.nodes[body.nodes < n]


def redundant(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> str:
    """Names of pairs whose forces of simultaneous contacts are not unique, or "". Collective.

    These are pairs between rigid bodies, or with obstacles, that use multipliers and friction.
    """
    rigid = [body for body in bodies if body.is_rigid]
    if not rigid:
        return ""
    nodes = np.unique(np.concatenate([body.nodes for body in rigid]))
    comm: MPI.Comm = rigid[0].V.mesh.comm
    names = []
    for pair in pairs:
        surfaces = [side for side in (pair.nodes, pair.segments) if isinstance(side, Surface)]
        inside = all(bool(np.isin(side.nodes, nodes).all()) for side in surfaces)
        too_many = pair.friction is not None and isinstance(pair.enforcement, LagrangeMultiplier)
        if reductions.everywhere(comm, inside) and too_many:
            names.append(pair.between)
    return "; ".join(names)


def _given_point(body: RigidBody) -> Floats | None:
    return None if body.guide is None else body.guide.point


def _mass(fields: LinearFields) -> Floats:
    """Mass products of the linear fields over a body, ``(d + 1, d + 1)`` [kg]."""
    # Consistent mass, as in the balance of momentum.
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
