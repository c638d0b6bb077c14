r"""Motion of nodes and of rigid bodies in explicit steps (leapfrog).

Positions and velocities of the nodes of a rigid body are linear in the reference position, with
coefficients Q and V. Their mass matrix M is constant, and N(Q) is a basis of the rigid motions. A
step is velocity Verlet with constraints (RATTLE; Hairer, Lubich and Wanner 2006, section VII.1.4).
Projection on N eliminates the multipliers:

.. math:: N(Q_n)^T M \frac{Q_{n+1} - Q_n}{\Delta t}
      = N(Q_n)^T \left( M V_n + \frac{\Delta t}{2} f_n \right), \quad
   N(Q_{n+1})^T M V_{n+1} = N(Q_{n+1})^T \left( M \frac{Q_{n+1} - Q_n}{\Delta t}
      + \frac{\Delta t}{2} f_{n+1} \right),

where :math:`V_{n+1}` is a rigid motion. The unknown of the first equation is the Cayley vector of
the rotation from :math:`Q_n` to :math:`Q_{n+1}`. As :math:`\Delta x \times \Delta x = 0` at each
node, only the impulses of the forces change the momenta. The step is symplectic: the energy error
is bounded and of second order. With a guide, only the equations of the free motions hold.
"""

import math
from collections.abc import Sequence

import numpy as np
from dolfinx import fem, la

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Flags, Floats
from dolfinx_nts.fem.components import dimension, in_space, nodal
from dolfinx_nts.integrators.rates import ConsistentMass
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.model.reaction import Reaction, reactions_of
from dolfinx_nts.solvers.rigid.linear_fields import (
    LinearFields,
    combined,
    inner_products,
    products_of,
    rigid_motions,
    spins,
    turned,
)
from dolfinx_nts.solvers.rigid.rigid_fields import RigidFields
from dolfinx_nts.solvers.rigid.rigid_states import RigidStates

__all__ = ["Drift", "RigidLeapfrog"]

# Newton's method for the rotation of a step: limit on the iterations [-], and correction below
# which the rotation is exact to round-off, as convergence is quadratic [rad].
_MAX_ITERATIONS, _SMALL = 30, 1e-9


class _Leap:
    """Leapfrog step of ``b`` rigid bodies. Local.

    Args:
        fields: Linear fields over the bodies.
        mass: Their mass products, shape ``(b, d + 1, d + 1)`` [kg].
        q, v: Coefficients of positions [m] and velocities [m/s] at the start, ``(b, d + 1, d)``.
        f: Products of the fields and the nodal forces at the start, ``(b, d + 1, d)`` [N, N m].
        prescribed: Motion prescribed by guides in the step, ``(b, k)``.
        dt: Length of the step [s].

    Attributes:
        found: Whether the rotation of a body converged, ``(b,)``.
        change: Coefficients of the displacements.
        v: Coefficients of the velocities at the end, after `kick`.
        reactions: Force, moment about the origin and work of guides, ``(b, k + 1)``, after `kick`.
    """

    def __init__(
        self,
        fields: RigidFields,
        mass: Floats,
        q: Floats,
        v: Floats,
        f: Floats,
        prescribed: Floats,
        dt: float,
    ) -> None:
        self._freedom, self._mass, self._dt, self._prescribed = fields.freedom, mass, dt, prescribed
        self._q, self.v, self._f = q, v, f
        self._start = rigid_motions(q)
        self._rate = fields.nearest(self._start, fields.products @ v)
        impulse = inner_products(self._start, mass @ v + dt / 2 * f)
        amplitudes = prescribed + self._freedom.project(self._rate) * dt
        self.found: Flags = np.zeros(len(q), dtype=bool)
        some = np.arange(len(q))
        for _ in range(_MAX_ITERATIONS):
            correction = self._correction(some, amplitudes[some], impulse[some])
            amplitudes[some] -= correction
            turns = amplitudes[some, q.shape[2] :], correction[:, q.shape[2] :]
            is_small = np.all(np.abs(turns[0]) < 2.0, axis=1)  # 90 degrees
            is_exact = np.abs(turns[1]).max(axis=1) <= _SMALL
            self.found[some[is_small & is_exact]] = True
            some = some[is_small & ~is_exact]
            if not len(some):
                break
        self.change: Floats = turned(q, amplitudes)

    def _correction(self, some: Array, amplitudes: Floats, impulse: Floats) -> Floats:
        """Newton correction to the motions of ``m`` bodies, ``(m, k)``."""
        start, mass, q = (part[some] for part in (self._start, self._mass, self._q))
        change, dim = turned(q, amplitudes), q.shape[2]
        rest: Floats = inner_products(start, mass @ change) / self._dt - impulse
        # Derivative of the rotation with respect to the Cayley vector, about the mean state.
        slopes = rigid_motions(q + change / 2)
        turn = np.linalg.inv(np.eye(dim) - spins(amplitudes) / 2)
        slopes[:, dim:] = slopes[:, dim:] @ turn.transpose(0, 2, 1)[:, None]
        slope = products_of(start, mass, slopes) / self._dt
        return self._freedom.at(some).solved(slope, rest)

    def kick(self, f: Floats) -> Floats:
        """Complete the velocities with the force products f at the end of the step [N, N m].

        Returns:
            Change of kinetic energy minus the work of forces and guides, shape ``(b,)`` [J].
        """
        change, mass, dt, freedom = self.change, self._mass, self._dt, self._freedom
        q = self._q + self.change
        end = rigid_motions(q)
        drive = mass @ change / dt + dt / 2 * f
        prescribed = 2 * self._prescribed / dt - self._rate
        prescribed = prescribed - freedom.project(prescribed)
        balance = inner_products(end, drive - mass @ combined(prescribed, end))
        v = combined(prescribed + freedom.solved(products_of(end, mass, end), balance), end)
        # Mean of the guide forces at both ends of the step.
        push: Array = mass @ (change / dt - self.v)
        first: Floats = (
            inner_products(self._start, push) / dt - inner_products(self._start, self._f) / 2
        )
        last = np.asarray(inner_products(end, mass @ v - drive) / dt, dtype=np.float64)
        work = ((first + last) * self._prescribed).sum(axis=1)
        moved = _sums_of_products(self._f + f, change) / 2
        kinetic = [_sums_of_products(w, mass @ w) / 2 for w in (self.v, v)]
        self.v = v
        wrench = _about_origin(first, self._q[:, 0]) + _about_origin(last, q[:, 0])
        self.reactions = np.column_stack([wrench, work])
        gained: Floats = kinetic[1] - kinetic[0] - moved - work
        return gained


class RigidLeapfrog(RigidStates):
    """Motion of all rigid bodies in explicit steps. Collective, as are all methods.

    Arguments are nodal vectors, see `RigidStates`.

    Args:
        V: Space of the displacement.
        bodies: Linear fields over each rigid body.
        masses: Mass matrix of the linear fields of each body, from all mass at its nodes [kg].
        v: Velocity of all bodies.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        bodies: Sequence[LinearFields],
        masses: Sequence[Floats],
        v: fem.Function,
    ) -> None:
        super().__init__(V, bodies)
        self._v = v
        rigid = [body.body for body in bodies]
        if rigid:
            self._masses: Floats = np.array(masses)
            self._mass, self._lumped = ConsistentMass(rigid, v), lumped_mass(rigid)
        self._leap: _Leap | None = None

    def drift(self, u_n: Floats, v: Floats, forces: Floats, dt: float, du: Floats) -> str:
        """Set the displacement increments of rigid bodies in a step.

        Args:
            u_n: Displacements at the start [m].
            v: Velocities at the start [m/s].
            forces: Forces at the start [N].
            dt: Length of the step [s].
            du: Increments [m], overwritten at rigid bodies.

        Returns:
            Reason for which the step is refused, or "".
        """
        if not self.exists:
            return ""
        of_u, of_v, f = self._fields.sums(u_n, v, forces)
        fields, prescribed = self._fields, self.guides.prescribed
        state = fields.positions(of_u), fields.fit(of_v), f
        leap = self._leap = _Leap(fields, self._masses, *state, prescribed, dt)
        for body, found in zip(self._bodies, leap.found, strict=True):
            if not found:
                return f"the rigid {body.body.name} rotates too far in it"
        self._fields.put(leap.change, du)
        return ""

    def kick(self, forces: Floats, v: Floats) -> float:
        """Set the velocities v [m/s] at the end of a step by the forces there [N].

        Returns:
            Change of kinetic energy minus the work of all forces [J].
        """
        if self._leap is None:
            return 0.0
        gained = self._leap.kick(*self._fields.sums(forces))
        self._fields.put(self._leap.v, v)
        return float(gained.sum())

    def more_momentum(self) -> Floats:
        """Momentum of rigid bodies with consistent minus lumped mass [kg m/s]."""
        momentum: Floats = self._mass.momentum()
        return momentum - self._lumped[:, None] * nodal(self._v)[: len(momentum)]

    def more_energy(self, mass: Floats, v: Floats) -> float:
        """Kinetic energy of rigid bodies with exact minus lumped mass on this rank [J].

        Args:
            mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].
            v: Velocities, shape ``(n, d)`` [m/s].
        """
        if not self.exists:
            return 0.0
        coefficients, nodes = self._fields.fit(*self._fields.sums(v)), self.nodes
        energy = float(np.vdot(coefficients, self._masses @ coefficients)) / 2
        lumped = np.vdot(mass[nodes, None] * v[nodes], v[nodes]) / 2
        return energy * (self._comm.rank == 0) - float(lumped)

    def reactions(self) -> tuple[Reaction, ...]:
        """Reactions of the guides in the last step, in the order of the bodies. Local."""
        if self._leap is None:
            return ()
        guided = [body.body.guide is not None for body in self._bodies]
        rows = self._leap.reactions[guided]
        # Axisymmetric bodies have an axial force and work.
        return (
            reactions_of(rows[:, 1::2], 1)
            if self._is_axisymmetric
            else reactions_of(rows, self.dim)
        )


class Drift:
    """Displacement update of all nodes in an explicit step. Collective.

    Args:
        functions: Displacements at the start and at the end of a step, velocities at the start
            and in the middle.
        supports: Dirichlet conditions.
        rigid: Motion of the rigid bodies.
        ghosts: Vectors whose ghost values the forces need.

    Attributes:
        arrays: Values of the four functions and the displacement increment at the owned nodes,
            each of shape ``(n, d)``.
        is_prescribed: Flags of the prescribed displacements at the owned nodes, shape ``(n, d)``.
    """

    def __init__(
        self,
        functions: tuple[fem.Function, fem.Function, fem.Function, fem.Function],
        supports: Supports,
        rigid: RigidLeapfrog,
        ghosts: Sequence[la.Vector],
    ) -> None:
        u = functions[1]
        V = u.function_space
        self._u, self._ghosts = u.x.array, tuple(ghosts)
        n = V.dofmap.index_map.size_local
        u_n, end, v, rate = (nodal(f)[:n] for f in functions)
        self.arrays: tuple[Floats, ...] = (u_n, end, v, rate, np.empty_like(end))
        self._supports, self._rigid = supports, rigid
        self.is_prescribed = np.zeros((n, dimension(V)), dtype=bool)
        self.is_prescribed.ravel()[supports.fixed] = True

    def move(self, dt: float, a: Floats, forces: Floats, about: Floats) -> tuple[float, float, str]:
        """Set displacements at the end of a step and velocities in the middle.

        Args:
            dt: Length of the step [s].
            a: Accelerations at its start, shape ``(n, d)`` [m/s^2].
            forces: Forces at its start, shape ``(n, d)`` [N].
            about: Reference velocity of relative motions, shape ``(d,)`` [m/s].

        Returns:
            Largest displacement increment of a node of this rank [m]; largest increment relative to
            the reference velocity [m], with supports or rigid bodies the first number again; and
            the reason why the step is refused, or "".
        """
        u_n, u, v, rate, du = self.arrays
        moved, relative = _kernels.drift(dt, v, a, rate, u, du, about)
        rigid, supports = self._rigid, self._supports
        if rigid.exists:
            if reason := rigid.drift(u_n, v, forces, dt, du):
                return 0.0, 0.0, reason
            nodes = rigid.nodes
            u[nodes], rate[nodes] = (u_n + du)[nodes], du[nodes] / dt
        if supports.exist:
            self._u[:] = supports.applied(self._u)
            np.subtract(u, u_n, out=du)
            rate[self.is_prescribed] = du[self.is_prescribed] / dt
        if rigid.exists or supports.exist:
            longest = float(np.linalg.norm(du, axis=1).max(initial=0.0))
            moved = relative = longest if math.isfinite(moved) else moved
        for ghosts in self._ghosts:
            ghosts.scatter_forward()
        # A maximum over ranks may ignore NaN, but not infinity.
        return (moved if math.isfinite(moved) else math.inf), relative, ""


def _sums_of_products(left: Floats, right: Floats) -> Floats:
    """Inner product of coefficients ``(b, d + 1, d)`` of each body, shape ``(b,)``. Local."""
    sums: Floats = (left * right).sum(axis=(1, 2))
    return sums


def _about_origin(wrenches: Floats, points: Floats) -> Floats:
    """Move wrenches, ``(b, k)``, from points ``(b, d)`` [m] to the origin. Local."""
    d = points.shape[1]
    forces, moments = wrenches[:, :d], wrenches[:, d:]
    arms = np.cross(in_space(points), in_space(forces))
    moved: Floats = np.column_stack([forces, moments + arms[:, -moments.shape[1] :]])
    return moved
