"""Velocity and acceleration of a step as functions of its displacements."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, ClassVar

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, GlobalInts
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.jit import assembled, compile_form
from dolfinx_nts.integrators.state import State, serialize_nodal
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.rigid.rigid_motion import RigidMotion

__all__ = ["ConsistentMass", "MidpointRates", "NoRates", "Rates"]


# Conjugate gradients with the mass matrix: limit on the iterations [-], never reached in practice,
# and relative residual at which they stop [-], of the order of round-off.
_MAX_ITERATIONS, _REDUCTION = 1000, 1e-15


class ConsistentMass:
    """Consistent mass matrix, matrix-free. Collective, as are all methods.

    Args:
        bodies: The bodies.
        rate: Velocity or acceleration, a Function of the space of the bodies.
    """

    def __init__(self, bodies: Sequence[Body], rate: fem.Function) -> None:
        self._V, self._rate, self._bodies = rate.function_space, rate, tuple(bodies)
        self._comm: MPI.Comm = self._V.mesh.comm
        eta = ufl.TestFunction(self._V)
        self._momentum = bulk_form(
            bodies, lambda material, parameters, rho: rho * ufl.inner(rate, eta)
        )

    @cached_property
    def _form(self) -> fem.Form:
        # The first use is collective.
        return compile_form(self._momentum)

    @cached_property
    def _inverse_lumped(self) -> Floats:
        """Inverse lumped mass of the owned dofs, 1 at massless ones, ``(d n,)`` [1/kg]."""
        mass = np.repeat(lumped_mass(self._bodies), dimension(self._V))
        return np.divide(1.0, mass, out=np.ones_like(mass), where=mass > 0)

    def momentum(self) -> Floats:
        """Mass times the current rate at the owned nodes, shape ``(n, d)``."""
        return assembled(self._form).reshape(-1, dimension(self._V))

    def times(self, values: Floats) -> Floats:
        """Mass times a rate at the owned dofs, both ``(d n,)``, which is stored."""
        self._rate.x.array[: len(values)] = values
        self._rate.x.scatter_forward()
        return self.momentum().ravel()

    def solve(self, force: Floats, projected: Callable[[Floats], Floats]) -> Floats:
        """Admissible rate for a force, by conjugate gradients with the mass matrix.

        They are preconditioned by the lumped mass.

        Args:
            force: Force or impulse at the owned dofs, shape ``(d n,)``.
            projected: Orthogonal projection of values of the owned dofs on admissible rates.

        Returns:
            The rate, shape ``(d n,)``. The values of the Function are overwritten.
        """
        rate, r = np.zeros(len(force)), projected(force)
        z = projected(self._inverse_lumped * r)
        p = z.copy()
        first = square = float(reductions.total(self._comm, r @ z))
        for _ in range(_MAX_ITERATIONS):
            if square <= _REDUCTION**2 * first:
                break
            product = projected(self.times(p))
            step = square / float(reductions.total(self._comm, p @ product))
            rate += step * p
            r -= step * product
            z = projected(self._inverse_lumped * r)
            before, square = square, float(reductions.total(self._comm, r @ z))
            p = z + square / before * p
        return rate


class Rates(ABC):
    """Base class of time discretisations of velocity and acceleration.

    Collective, except where a method says otherwise.

    Args:
        state: State whose ``u``, the displacement at the end of a step, is the unknown; ``u_n``
            and ``v`` are displacement and velocity at the start.
        dt: Length of a step, a constant [s].
        bodies: The bodies.

    Attributes:
        u_n, u, v, dt: Functions of the state, and the constant.
        mean_velocity: Mean velocity of the last step, or the velocity that was set [m/s].
        acceleration: Mean acceleration of a step as a function of ``u``, UFL (3,); None without
            inertia.
        is_unchanged: Whether the state at the start also solves the step.
        trial: Name of the starting guess that is the trial motion in the search for candidate
            segments.
        spring_points: Name of the starting guess at which points of mortar contact by springs are
            chosen. The velocity of a node that springs hold may alternate from step to step: points
            chosen by this velocity are far from the loaded ones, and springs that change their
            points under load let bodies sink into each other.
        force_time: Time of stress and loads for second order, from 0 at the start of a step to 1 at
            its end [-]; None if the scheme chooses it.
    """

    acceleration: Any | None
    force_time: float | None = None
    trial: ClassVar[str] = "ballistic"
    spring_points: ClassVar[str] = "coasting"
    is_unchanged = False

    def __init__(self, state: State, dt: fem.Constant, bodies: Sequence[Body]) -> None:
        self.u_n, self.u, self.v, self.dt = state.u_n, state.u, state.v, dt
        # In contact the nodal velocity may alternate from step to step; its mean over a step does
        # not.
        self.mean_velocity = fem.Function(self.u.function_space)
        # Cached, since access to the array of a Function is slow.
        functions = self.u_n, self.u, self.v, self.mean_velocity
        self._values: tuple[Floats, ...] = tuple(function.x.array for function in functions)
        self.forget()

    def inertia_share(self, mass: Floats) -> Floats:
        """Inertia terms of the tangent for lumped masses of the dofs [kg], ``(d n,)`` [N/m]."""
        share: Floats = 2 / float(self.dt.value) ** 2 * mass
        return share

    def starts(self) -> dict[str, Floats]:
        """Starting guesses of Newton's method by name, in the order of attempts. Local.

        If one fails, for instance at the first contact of a fast body, the next one is tried.
        """
        (u_n, _, v, mean), dt = self._values, float(self.dt.value)
        return {
            "coasting": u_n + dt * mean,
            "ballistic": u_n + dt * v,
            "last": u_n,
        }

    def forget(self) -> None:
        """Reset the mean velocity of the last step after the state was set."""
        *_, v, mean = self._values
        mean[:] = v

    def begin(  # noqa: B027 (most rates have nothing to prepare)
        self,
        forces: Callable[[], Floats],
        free: Floats | None,
        rigid: RigidMotion,
        is_unchanged: Callable[[], bool],
        prescribed: Callable[[], Floats],
    ) -> None:
        """Prepare a step.

        Args:
            forces: Returns the residual at the start of the step at the owned dofs, with contact
                springs, ``(d n,)`` [N].
            free: 1 at unknown displacements, 0 at prescribed ones, shape ``(n, 3)``; None if all
                are unknown.
            rigid: Motion of the rigid bodies in the step.
            is_unchanged: Returns whether loads and supports are unchanged since the last step.
            prescribed: Returns the prescribed displacement increments at the owned dofs,
                ``(d n,)`` [m], 0 at others.
        """

    def accept(self) -> float:
        """Set the velocity at the end of the step that was solved.

        Returns:
            Change of kinetic energy on this rank minus the work in the step [J].
        """
        u_n, u, _, mean = self._values
        mean[:] = (u - u_n) / float(self.dt.value)
        return self._set_velocity()

    @abstractmethod
    def _set_velocity(self) -> float:
        """Set the velocity at the end of the step from the mean velocity, see `accept`."""

    def serialize(self, archive: Archive, ids: GlobalInts) -> None:
        """Serialize the state of the rates, by the input numbers of the owned nodes."""
        serialize_nodal(archive, "mean_velocity", self.mean_velocity, ids)


class MidpointRates(Rates):
    """Velocity that is linear in a step: v_{n+1} = 2 (u_{n+1} - u_n)/dt - v_n."""

    force_time = 0.5

    def __init__(self, state: State, dt: fem.Constant, bodies: Sequence[Body]) -> None:
        super().__init__(state, dt, bodies)
        self.acceleration = 2 / dt * ((self.u - self.u_n) / dt - self.v)

    def mean_acceleration(self) -> Floats:
        """Values of `acceleration` at the local dofs, shape ``(d l,)`` [m/s^2]. Local."""
        (u_n, u, v, _), dt = self._values, float(self.dt.value)
        acceleration: Floats = 2 / dt * ((u - u_n) / dt - v)
        return acceleration

    def _set_velocity(self) -> float:
        *_, v, mean = self._values
        v[:] = 2 * mean - v
        return 0.0


class NoRates(Rates):
    """No inertia: the velocity stays zero, and time is a load parameter.

    The first starting guess extrapolates the last step as long as supports and guides continue to
    move similarly. If they start, stop or turn, extrapolation would distort adjacent cells, and the
    last state is the first guess.
    """

    acceleration = None

    def __init__(self, state: State, dt: fem.Constant, bodies: Sequence[Body]) -> None:
        super().__init__(state, dt, bodies)
        self._comm = self.u.function_space.mesh.comm
        # Prescribed velocities of supports and guides in the last and in the current step [m/s].
        self._last = fem.Function(self.u.function_space)
        self._now: Floats = np.zeros(0)
        self._extrapolates = False

    @property
    def trial(self) -> str:  # type: ignore[override]
        """Name of the first starting guess."""
        return "extrapolated" if self._extrapolates else "last"

    @property
    def spring_points(self) -> str:  # type: ignore[override]
        """Name of the first starting guess."""
        return self.trial

    def begin(
        self,
        forces: Callable[[], Floats],
        free: Floats | None,
        rigid: RigidMotion,
        is_unchanged: Callable[[], bool],
        prescribed: Callable[[], Floats],
    ) -> None:
        self._now = now = np.divide(prescribed(), float(self.dt.value))
        last, motion = (f.x.array[: len(now)] for f in (self._last, self.mean_velocity))
        squares = [float(v @ v) for v in (now, last, now - last, motion)]
        *lengths, change, moved = map(float, reductions.total(self._comm, squares))
        # For velocities of equal length the angle between them is below 60 degrees.
        is_near = change == 0 or change < max(lengths)
        self.is_unchanged = is_unchanged()
        self._extrapolates = moved > 0 and is_near and not self.is_unchanged

    def accept(self) -> float:
        self._last.x.array[: len(self._now)] = self._now
        return super().accept()

    def inertia_share(self, mass: Floats) -> Floats:
        return 0.0 * mass

    def starts(self) -> dict[str, Floats]:
        u_n, dt = self.u_n.x.array, float(self.dt.value)
        if not self._extrapolates:
            return {"last": u_n}
        return {"extrapolated": u_n + dt * self.mean_velocity.x.array, "last": u_n}

    def serialize(self, archive: Archive, ids: GlobalInts) -> None:
        super().serialize(archive, ids)
        serialize_nodal(archive, "given_velocity", self._last, ids)

    def _set_velocity(self) -> float:
        return 0.0
