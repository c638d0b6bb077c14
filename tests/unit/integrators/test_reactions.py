"""Reactions of supports and works of loads against momenta and closed forms."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.diagnostics.balance import Diagnostics
from helpers.once import once_except
from helpers.scenes import BLOCK_RUBBER, blocks

pytestmark = pytest.mark.at_most_two_ranks

# Tolerance relative to the largest term of a sum.
TOLERANCE = 1e-11

G = np.array([1.0, -2.0, -3.0])  # m/s^2
TRACTION = np.array([2.0, 0.5, -4.0])  # Pa

SCHEMES = {
    nts.EnergyMomentum: None,
    nts.Midpoint: nts.LagrangeMultiplier("plastic"),
    nts.CentralDifference: nts.Penalty(),
    nts.QuasiStatic: None,
}


def supported(comm, scheme, enforcement, speed):
    """Return stepper and mass; the lower block stands on two supports that share a node."""
    old = blocks(comm).stepper
    V = old.u.function_space
    bottom = fem.locate_dofs_geometrical(V, lambda x: x[2] < 0.02)
    corner = fem.locate_dofs_geometrical(V, lambda x: (x[0] < 0.01) & (x[1] < 0.01))
    g = fem.Function(V)
    bcs = [fem.dirichletbc(g, bottom), fem.dirichletbc(g, corner)]
    bodies, (pair,) = old.bodies, old.pairs
    pairs = [nts.ContactPair(pair.nodes, pair.segments, enforcement, method="node-to-segment")]
    if scheme is nts.QuasiStatic:  # only the supports carry the bodies
        bcs.append(fem.dirichletbc(np.zeros(3), bodies[1].nodes, V))
        pairs = []
    loads = [nts.Gravity(bodies, G), nts.Traction(pair.segments, TRACTION)]

    def move(t):
        g.x.array.reshape(-1, 3)[:] = speed * t * np.array([0.3, -0.2, 0.1])

    dt = None if scheme is nts.CentralDifference else 0.02
    stepper = scheme(bodies, pairs, dt=dt, bcs=bcs, loads=loads, update=move)
    if scheme is not nts.QuasiStatic:
        stepper.v.x.array[:] = old.v.x.array
        stepper.set_velocity(bodies[0], speed * np.array([0.3, -0.2, 0.1]))
    mass = fem.assemble_scalar(fem.form(BLOCK_RUBBER[2] * ufl.dx(V.mesh)))
    return stepper, comm.allreduce(mass)


class Loads:
    """Area of the loaded surface, and first moments of mass and area at the present state."""

    def __init__(self, stepper, mass):
        """Compile the forms."""
        self.stepper, self.mass = stepper, mass
        self.surface = stepper.loads[1]._surface
        self.eta = ufl.TestFunction(stepper.u.function_space)
        x = ufl.SpatialCoordinate(stepper.u.function_space.mesh) + stepper.u
        dx = ufl.dx(metadata={"quadrature_degree": 2})
        self.forms = [
            [fem.form(factor * x[i] * measure) for i in range(3)]
            for factor, measure in ((BLOCK_RUBBER[2], dx), (1.0, self.surface.measure(2)))
        ]

    def moments(self):
        """First moments of mass (3,) and of loaded area (3,). Collective."""
        sums = [[fem.assemble_scalar(form) for form in forms] for forms in self.forms]
        return self.stepper.u.function_space.mesh.comm.allreduce(np.array(sums))

    def area(self):
        """Area of the loaded surface. Collective."""
        return self.stepper.u.function_space.mesh.comm.allreduce(self.surface.area.sum())


@pytest.mark.parametrize(
    "scheme",
    once_except(list(SCHEMES), nts.EnergyMomentum),
    ids=lambda scheme: scheme.__name__,
)
def test_reactions_loads_and_inertia_are_in_balance_with_separate_works(comm, scheme):
    # The moment at a support that moves is exact in the schemes that conserve it.
    speed = 0.0 if scheme is nts.CentralDifference else 1.0
    stepper, mass = supported(comm, scheme, SCHEMES[scheme], speed)
    loads, diagnostics = Loads(stepper, mass), Diagnostics(stepper)
    is_static = scheme is nts.QuasiStatic
    num_active, last, loaded = 0, np.zeros((2, 3)), 0.5 if is_static else 1.0
    for _ in range(3 if is_static else 60 if scheme is nts.CentralDifference else 5):
        before = loads.moments()
        momenta = diagnostics.linear_momentum(), diagnostics.angular_momentum()
        step = stepper.advance()
        after = loads.moments()
        at = after if is_static else (before + after) / 2
        force = mass * G + loads.area() * TRACTION
        moment = np.cross(at[0], G) + np.cross(at[1], TRACTION)
        change = diagnostics.linear_momentum() - momenta[0]
        turn = diagnostics.angular_momentum() - momenta[1]
        reactions = step.reactions
        given = np.sum([r.force for r in reactions], axis=0)
        torque = np.sum([r.moment for r in reactions], axis=0)
        scale = np.linalg.norm(force) + np.abs(given).max() + np.abs(change / step.dt).max()
        assert np.allclose(given + force, change / step.dt, rtol=0, atol=TOLERANCE * scale)
        assert np.allclose(torque + moment, turn / step.dt, rtol=0, atol=TOLERANCE * scale)
        # Works in statics are those of the means of the forces at both ends, 0 at the start.
        works = loaded * (after - before) @ np.array([G, TRACTION]).T
        assert step.load_works == pytest.approx(np.diag(works), rel=1e-9, abs=TOLERANCE * scale)
        assert step.load_work == sum(step.load_works)
        travel = speed * step.dt * np.array([0.3, -0.2, 0.1])
        forces = np.array([reaction.force for reaction in reactions[:2]])
        acting = (last + forces) / 2 if is_static else forces
        last, loaded = forces, 1.0
        for reaction, force in zip(reactions, acting, strict=False):
            work = np.dot(force, travel)
            assert reaction.work == pytest.approx(work, rel=1e-9, abs=TOLERANCE * scale)
        assert step.support_work == sum(r.work for r in reactions)
        num_active += step.num_active
    assert is_static or num_active > 0
    # The common node counts for the first, so that the other has its free part alone.
    assert all(np.linalg.norm(reaction.force) > 0 for reaction in step.reactions)


def test_explicit_contact_forces_are_those_at_the_end_of_a_step(comm):
    """A supported block is struck from below: the mean of two rows acts between them."""

    def build(model):
        nts.parts.add_box(model, "block", corner=(0, 0, 0), size=(1, 1, 1), cells=(2, 2, 2))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(E=1e4, nu=0.3, rho=1e3))
    rises = nts.Motion(lambda t: (0.0, 0.0, 0.5 * t))
    floor = nts.RigidPlane((0, 0, -0.01), (0, 0, 1)).moving(rises)
    pair = nts.ContactPair(nts.boundary_of(block), floor, nts.Penalty(), method="node-to-segment")
    top = fem.locate_dofs_geometrical(V, lambda x: x[2] > 0.99)
    support = fem.dirichletbc(np.zeros(3), top, V)
    stepper = nts.CentralDifference([block], [pair], bcs=[support])
    diagnostics = Diagnostics(stepper)
    contact, momentum = np.zeros(3), np.zeros(3)
    for _ in range(20):
        step = stepper.advance()
        force, before = contact, momentum
        contact, momentum = diagnostics.contact_force(), diagnostics.linear_momentum()
        (reaction,) = step.reactions
        acts = (reaction.force + (force + contact) / 2) * step.dt
        assert np.allclose(momentum - before, acts, rtol=0, atol=TOLERANCE * abs(acts).max())
    assert contact[2] > 0 > reaction.force[2]


@pytest.mark.serial
def test_a_stretched_bar_at_rest_pulls_at_its_supports_in_every_step(comm):
    bodies = blocks(comm).stepper.bodies
    V = bodies[0].V
    ends = [
        fem.locate_dofs_geometrical(V, lambda x, at=at: (abs(x[0] - at) < 0.01) & (x[2] < 0.6))
        for at in (0.0, 1.2)
    ]
    g = fem.Function(V)
    g.interpolate(lambda x: 0.1 * x * np.array([[1.0], [0.0], [0.0]]))
    bcs = [fem.dirichletbc(g, end) for end in ends]
    bcs.append(fem.dirichletbc(np.zeros(3), bodies[1].nodes, V))
    stepper = nts.QuasiStatic(bodies, dt=1.0, bcs=bcs)
    forces = [[r.force[0] for r in stepper.advance().reactions[:2]] for _ in range(3)]
    assert forces[0][1] > 10.0
    assert np.allclose(forces, forces[0][1] * np.array([-1.0, 1.0]), rtol=1e-9)
