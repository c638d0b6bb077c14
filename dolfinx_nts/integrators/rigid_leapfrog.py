r"""Rigid bodies in explicit steps: central differences of their nodes that keep them rigid.

Positions and velocities of the nodes are linear in the reference position, with coefficients Q and
V, a mass matrix M that is constant, and rigid motions N(Q). A step is that of velocity Verlet with
constraints (RATTLE; Hairer, Lubich and Wanner 2006, section VII.1.4), whose multipliers N removes:

.. math:: N(Q_n)^T M \frac{Q_{n+1} - Q_n}{\Delta t}
      = N(Q_n)^T \left( M V_n + \frac{\Delta t}{2} f_n \right), \quad
   N(Q_{n+1})^T M V_{n+1} = N(Q_{n+1})^T \left( M \frac{Q_{n+1} - Q_n}{\Delta t}
      + \frac{\Delta t}{2} f_{n+1} \right),

with :math:`Q_{n+1}` turned from :math:`Q_n` by a Cayley vector, the unknown of the first equation,
and :math:`V_{n+1}` a rigid motion. As :math:`\Delta x \times \Delta x = 0`, both momenta change by
the impulses of the forces alone. The step is symplectic, so that the error of the energy is
bounded, and of second order. A guide leaves some motions free, and only their equations hold.
"""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Array, Flags, Floats
from dolfinx_nts.fem.components import in_space, nodal
from dolfinx_nts.integrators.rates import ConsistentMass
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.model.reaction import Reaction, reactions_of
from dolfinx_nts.solvers.linear_fields import (
    LinearFields,
    amounts_of,
    combined,
    products_of,
    rigid_motions,
    spins,
    turned,
)
from dolfinx_nts.solvers.rigid_fields import RigidFields
from dolfinx_nts.solvers.rigid_states import RigidStates

__all__ = ["RigidLeapfrog"]

# Most iterations of Newton's method for the turn of a step [-], and the change of it after which
# it is exact to round-off, as it converges quadratically [rad].
_MAX_ITERATIONS, _SMALL = 30, 1e-9


class _Leap:
    """Step of ``b`` bodies. Local.

    Args:
        fields: Linear fields over the bodies.
        mass: Their products with the mass, shape ``(b, d + 1, d + 1)`` [kg].
        q, v: Coefficients of positions [m] and velocities [m/s] at the start, ``(b, d + 1, d)``.
        f: Sums of the nodal forces there, ``(b, d + 1, d)`` [N, N m].
        led: How guides lead the bodies in the step, ``(b, k)``.
        dt: Length of the step [s].

    Attributes:
        found: Whether the turn of a body was found, ``(b,)``.
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
        led: Floats,
        dt: float,
    ) -> None:
        self._freedom, self._mass, self._dt, self._led = fields.freedom, mass, dt, led
        self._q, self.v, self._f = q, v, f
        self._start = rigid_motions(q)
        self._rate = fields.nearest(self._start, fields.products @ v)
        impulse = amounts_of(self._start, mass @ v + dt / 2 * f)
        amounts = led + self._freedom.part(self._rate) * dt
        self.found: Flags = np.zeros(len(q), dtype=bool)
        some = np.arange(len(q))
        for _ in range(_MAX_ITERATIONS):
            correction = self._correction(some, amounts[some], impulse[some])
            amounts[some] -= correction
            turns = amounts[some, q.shape[2] :], correction[:, q.shape[2] :]
            is_small = np.all(np.abs(turns[0]) < 2.0, axis=1)  # 90 degrees
            is_exact = np.abs(turns[1]).max(axis=1) <= _SMALL
            self.found[some[is_small & is_exact]] = True
            some = some[is_small & ~is_exact]
            if not len(some):
                break
        self.change: Floats = turned(q, amounts)

    def _correction(self, some: Array, amounts: Floats, impulse: Floats) -> Floats:
        """Excess of the amounts of motions of ``m`` bodies, by Newton's method, ``(m, k)``."""
        start, mass, q = (part[some] for part in (self._start, self._mass, self._q))
        change, dim = turned(q, amounts), q.shape[2]
        rest: Floats = amounts_of(start, mass @ change) / self._dt - impulse
        # The derivative of a turn about the mean state.
        slopes = rigid_motions(q + change / 2)
        turn = np.linalg.inv(np.eye(dim) - spins(amounts) / 2)
        slopes[:, dim:] = slopes[:, dim:] @ turn.transpose(0, 2, 1)[:, None]
        slope = products_of(start, mass, slopes) / self._dt
        return self._freedom.at(some).solved(slope, rest)

    def kick(self, f: Floats) -> Floats:
        """Complete the velocities by the sums f of the forces at the end [N, N m].

        Returns:
            Kinetic energies that forces and guides do not explain, shape ``(b,)`` [J].
        """
        change, mass, dt, freedom = self.change, self._mass, self._dt, self._freedom
        q = self._q + self.change
        end = rigid_motions(q)
        drive = mass @ change / dt + dt / 2 * f
        led = 2 * self._led / dt - self._rate
        led = led - freedom.part(led)
        balance = amounts_of(end, drive - mass @ combined(led, end))
        v = combined(led + freedom.solved(products_of(end, mass, end), balance), end)
        # Means over the step of what the guides do at both ends.
        push: Array = mass @ (change / dt - self.v)
        first: Floats = amounts_of(self._start, push) / dt - amounts_of(self._start, self._f) / 2
        last = np.asarray(amounts_of(end, mass @ v - drive) / dt, dtype=np.float64)
        work = ((first + last) * self._led).sum(axis=1)
        moved = _sums_of_products(self._f + f, change) / 2
        kinetic = [_sums_of_products(w, mass @ w) / 2 for w in (self.v, v)]
        self.v = v
        wrench = _about_origin(first, self._q[:, 0]) + _about_origin(last, q[:, 0])
        self.reactions = np.column_stack([wrench, work])
        gained: Floats = kinetic[1] - kinetic[0] - moved - work
        return gained


class RigidLeapfrog(RigidStates):
    """Motion of all rigid bodies in explicit steps. Collective, as are all methods.

    Vectors are nodal, see `RigidStates`.

    Args:
        V: Space of the displacement.
        bodies: Linear fields over each rigid body.
        masses: Their products with all mass at the nodes of each [kg].
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
        """Set displacements du [m] of a step from the state at its start; say why not, or "".

        Args:
            u_n: Displacements [m].
            v: Velocities [m/s].
            forces: Forces [N].
            dt: Length of the step [s].
            du: Overwritten at rigid bodies.
        """
        if not self.exists:
            return ""
        of_u, of_v, f = self._fields.sums(u_n, v, forces)
        fields, led = self._fields, self.guides.prescribed
        state = fields.positions(of_u), fields.fit(of_v), f
        leap = self._leap = _Leap(fields, self._masses, *state, led, dt)
        for body, found in zip(self._bodies, leap.found, strict=True):
            if not found:
                return f"the rigid {body.body.name} turns too far in it"
        self._fields.put(leap.change, du)
        return ""

    def kick(self, forces: Floats, v: Floats) -> float:
        """Set the velocities v [m/s] at the end of a step by the forces there [N].

        Returns:
            Kinetic energy gained beside the work of all forces [J].
        """
        if self._leap is None:
            return 0.0
        gained = self._leap.kick(*self._fields.sums(forces))
        self._fields.put(self._leap.v, v)
        return float(gained.sum())

    def more_momentum(self) -> Floats:
        """Momentum by the consistent mass of rigid bodies less that by the lumped one [kg m/s]."""
        momentum: Floats = self._mass.momentum()
        return momentum - self._lumped[:, None] * nodal(self._v)[: len(momentum)]

    def more_energy(self, mass: Floats, v: Floats) -> float:
        """Kinetic energy by velocities [m/s] beside that of lumped masses, on this rank [J].

        ``mass`` are those of the owned nodes, shape ``(n,)`` [kg].
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
        # Of rings the force along y, and the work.
        return reactions_of(rows[:, 1::2], 1) if self._are_rings else reactions_of(rows, self.dim)


def _sums_of_products(left: Floats, right: Floats) -> Floats:
    """Sums of the products of coefficients ``(b, d + 1, d)``, ``(b,)``. Local."""
    sums: Floats = (left * right).sum(axis=(1, 2))
    return sums


def _about_origin(wrenches: Floats, points: Floats) -> Floats:
    """Forces, and moments about the origin, ``(b, k)``, of those at points ``(b, d)``. Local."""
    d = points.shape[1]
    forces, moments = wrenches[:, :d], wrenches[:, d:]
    arms = np.cross(in_space(points), in_space(forces))
    moved: Floats = np.column_stack([forces, moments + arms[:, -moments.shape[1] :]])
    return moved
