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

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import nodal
from dolfinx_nts.integrators.rates import ConsistentMass
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.solvers.linear_fields import (
    TURNS,
    LinearFields,
    nearest,
    products_of,
    rigid_motions,
    turned,
)
from dolfinx_nts.solvers.rigid_states import RigidStates

__all__ = ["RigidLeapfrog"]

# Most iterations of Newton's method for the turn of a step [-], and the change of it after which
# it is exact to round-off, as it converges quadratically [rad].
_MAX_ITERATIONS, _SMALL = 30, 1e-9


class _Leap:
    """Step of one body. Local.

    Args:
        body: Linear fields over it.
        mass: Their products with the mass, shape ``(d + 1, d + 1)`` [kg].
        q, v: Coefficients of positions [m] and velocities [m/s] at the start.
        f: Sums of the nodal forces there [N, N m].
        led: How the guide leads the body in the step.
        dt: Length of the step [s].

    Attributes:
        change: Coefficients of the displacement; None if the turn was not found.
        v: Coefficients of the velocity at the end, after `kick`.
        gained: Kinetic energy that forces and guide do not explain [J], after `kick`.
        reaction: Force, moment about the origin and work of the guide, after `kick`.
    """

    change: Floats | None = None
    gained = 0.0

    def __init__(
        self,
        body: LinearFields,
        mass: Floats,
        q: Floats,
        v: Floats,
        f: Floats,
        led: Floats,
        dt: float,
    ) -> None:
        """Find where the body is at the end."""
        self._body, self._mass, self._dt, self._led = body, mass, dt, led
        self._q, self.v, self._f = q, v, f
        self._start = rigid_motions(q)
        self._rate = nearest(self._start, body.products, body.products @ v)
        free, wanted = body.free, mass @ v + dt / 2 * f
        amounts = led + free.T @ (free @ self._rate) * dt
        impulse, dim = np.einsum("kmi,mi->k", self._start, wanted), q.shape[1]
        for _ in range(_MAX_ITERATIONS):
            change = turned(q, amounts)
            rest = np.einsum("kmi,mi->k", self._start, mass @ change) / dt - impulse
            # The derivative of a turn about the mean state.
            slopes = rigid_motions(q + change / 2)
            half = np.einsum("k,kij->ij", amounts[dim:], TURNS[dim]) / 2
            slopes[dim:] = slopes[dim:] @ np.linalg.inv(np.eye(dim) - half).T
            slope = free @ products_of(self._start, mass, slopes) @ free.T / dt
            correction = free.T @ np.linalg.solve(slope, free @ rest)
            amounts = amounts - correction
            if not np.all(np.abs(amounts[dim:]) < 2.0):  # 90 degrees
                return
            if np.abs(correction[dim:]).max() <= _SMALL:
                self.change = turned(q, amounts)
                return

    def kick(self, f: Floats) -> None:
        """Complete the velocity by the sums f of the forces at the end [N, N m]."""
        assert self.change is not None
        change, mass, dt, free = self.change, self._mass, self._dt, self._body.free
        end, q = rigid_motions(self._q + change), self._q + change
        drive = mass @ change / dt + dt / 2 * f
        led = 2 * self._led / dt - self._rate
        led = led - free.T @ (free @ led)
        known = np.einsum("k,kmi->mi", led, end)
        balance = np.einsum("kmi,mi->k", end, drive - mass @ known)
        matrix = free @ products_of(end, mass, end) @ free.T
        rate = led + free.T @ np.linalg.solve(matrix, free @ balance)
        v = np.einsum("k,kmi->mi", rate, end)
        # Means over the step of what the guide does at both ends.
        first = np.einsum("kmi,mi->k", self._start, mass @ (change / dt - self.v)) / dt
        first -= np.einsum("kmi,mi->k", self._start, self._f) / 2
        last = np.einsum("kmi,mi->k", end, mass @ v - drive) / dt
        work = float((first + last) @ self._led)
        moved = float(np.vdot(self._f + f, change)) / 2
        kinetic = [np.vdot(w, mass @ w) / 2 for w in (self.v, v)]
        self.gained, self.v = float(kinetic[1] - kinetic[0]) - moved - work, v
        self.reaction = _about_origin(first, self._q[0]) + _about_origin(last, q[0])
        self.reaction = np.append(self.reaction, work)


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
        """Keep the bodies, as yet without motion."""
        super().__init__(V, bodies)
        self._masses, self._v = tuple(masses), v
        rigid = [body.body for body in bodies]
        if rigid:
            self._mass, self._lumped = ConsistentMass(rigid, v), lumped_mass(rigid)
        self._leaps: list[_Leap] = []

    def drift(self, u_n: Floats, v: Floats, forces: Floats, dt: float, du: Floats) -> str:
        """Set displacements du [m] of a step from the state at its start; say why not, or "".

        Args:
            u_n: Displacements [m].
            v: Velocities [m/s].
            forces: Forces [N].
            dt: Length of the step [s].
            du: Overwritten at rigid bodies.
        """
        sums = self._sums(u_n, v, forces)
        self._leaps = [
            _Leap(body, mass, q, body.fit(of_v), f, led, dt)
            for body, mass, q, (_, of_v, f), led in zip(
                self._bodies,
                self._masses,
                self._positions(sums),
                sums,
                self.guides.led,
                strict=True,
            )
        ]
        changes = []
        for body, leap in zip(self._bodies, self._leaps, strict=True):
            if leap.change is None:
                return f"the rigid {body.body.name} turns too far in it"
            changes.append(leap.change)
        self._put(changes, du)
        return ""

    def kick(self, forces: Floats, v: Floats) -> float:
        """Set the velocities v [m/s] at the end of a step by the forces there [N].

        Returns:
            Kinetic energy gained beside the work of all forces [J].
        """
        for leap, (f,) in zip(self._leaps, self._sums(forces), strict=True):
            leap.kick(f)
        self._put((leap.v for leap in self._leaps), v)
        return sum(leap.gained for leap in self._leaps)

    def more_momentum(self) -> Floats:
        """Momentum by the consistent mass of rigid bodies less that by the lumped one [kg m/s]."""
        momentum: Floats = self._mass.momentum()
        return momentum - self._lumped[:, None] * nodal(self._v)[: len(momentum)]

    def more_energy(self, mass: Floats, v: Floats) -> float:
        """Kinetic energy by velocities [m/s] beside that of lumped masses, on this rank [J].

        ``mass`` are those of the owned nodes, shape ``(n,)`` [kg].
        """
        nodes, energy = self.nodes, 0.0
        for body, products, (of_v,) in zip(self._bodies, self._masses, self._sums(v), strict=True):
            coefficients = body.fit(of_v)
            energy += float(np.vdot(coefficients, products @ coefficients)) / 2
        lumped = np.vdot(mass[nodes, None] * v[nodes], v[nodes]) / 2
        return energy * (self._comm.rank == 0) - float(lumped)

    def reactions(self) -> tuple[Reaction, ...]:
        """Reactions of the guides in the last step, in the order of the bodies. Local."""
        rows: list[list[float]] = [
            list(map(float, leap.reaction))
            for body, leap in zip(self._bodies, self._leaps, strict=True)
            if body.body.guide is not None
        ]
        d = self.dim
        return tuple(Reaction(tuple(row[:d]), tuple(row[d:-1]), row[-1]) for row in rows)


def _about_origin(wrench: Floats, point: Floats) -> Floats:
    """Force, and moment about the origin, of those at a point. Local."""
    d = len(point)
    force, moment = np.zeros(3), wrench[d:]
    force[:d] = wrench[:d]
    arm = np.cross(np.append(point, np.zeros(3 - d)), force)
    return np.concatenate([wrench[:d], moment + (arm if d == 3 else arm[2:])])
