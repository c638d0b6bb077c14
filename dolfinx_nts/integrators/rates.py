"""Rates, by which velocity and acceleration of a step follow from its displacements."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, GlobalInts
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.jit import assembled, compile_form
from dolfinx_nts.integrators.state import State, serialize_nodal
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.rigid_motion import RigidMotion

__all__ = ["ConsistentMass", "MidpointRates", "NoRates", "Rates"]


class ConsistentMass:
    """Multiplies velocities or accelerations by the consistent mass, without a matrix. Collective.

    Args:
        bodies: The bodies.
        rate: Velocity or acceleration, a Function of the bodies' space.
    """

    def __init__(self, bodies: Sequence[Body], rate: fem.Function) -> None:
        self._V = rate.function_space
        eta = ufl.TestFunction(self._V)
        self._momentum = bulk_form(
            bodies, lambda material, parameters, rho: rho * ufl.inner(rate, eta)
        )

    @cached_property
    def _form(self) -> fem.Form:
        """The compiled form. Collective at the first use."""
        return compile_form(self._momentum)

    def momentum(self) -> Floats:
        """Mass times the present rate at the owned nodes, shape ``(n, 3)``."""
        return assembled(self._form).reshape(-1, dimension(self._V))


class Rates(ABC):
    """Base class of the ways in which velocity and acceleration follow from displacements.

    Collective, except where a method says otherwise.

    Args:
        state: Its ``u``, the displacement at the end of a step, is the unknown; ``u_n`` and
            ``v`` are displacement and velocity at the start.
        dt: Length of a step, a constant [s].
        bodies: The bodies.

    Attributes:
        u_n, u, v, dt: Functions of the state, and the constant.
        mean_velocity: Mean velocity of the last step [m/s], or the velocity that was set.
        acceleration: Mean acceleration of a step, UFL (3,), a function of ``u``; None without
            inertia.
        at_rest: Whether the state at the start also solves the step.
        trial: Name of the displacement among `starts` that decides which nodes may touch.
    """

    acceleration: Any | None
    trial: ClassVar[str] = "ballistic"
    at_rest = False

    def __init__(self, state: State, dt: fem.Constant, bodies: Sequence[Body]) -> None:
        self.u_n, self.u, self.v, self.dt = state.u_n, state.u, state.v, dt
        # Contact makes velocities alternate from step to step, but not their mean in a step.
        self.mean_velocity = fem.Function(self.u.function_space)
        # DOLFINx takes its time each time that it is asked for an array.
        functions = self.u_n, self.u, self.v, self.mean_velocity
        self._values: tuple[Floats, ...] = tuple(function.x.array for function in functions)
        self.forget()

    def inertia_share(self, mass: Floats) -> Floats:
        """Lumped inertia in the tangent by the masses of the dofs [kg], ``(d n,)`` [N/m]."""
        share: Floats = 2 / float(self.dt.value) ** 2 * mass
        return share

    def starts(self) -> dict[str, Floats]:
        """Displacements from which Newton's method is tried in turn, by name. Local.

        Where the first one fails, as at the first contact of a fast body, another may not.
        """
        (u_n, _, v, mean), dt = self._values, float(self.dt.value)
        return {
            "coasting": u_n + dt * mean,
            "ballistic": u_n + dt * v,
            "last": u_n,
        }

    def forget(self) -> None:
        """Take the velocity as the mean one of the last step, because the state was set."""
        *_, v, mean = self._values
        mean[:] = v

    def begin(  # noqa: B027 (most rates have nothing to prepare)
        self,
        forces: Callable[[], Floats],
        free: Floats | None,
        rigid: RigidMotion,
        at_rest: Callable[[], bool],
        led: Callable[[], Floats],
    ) -> None:
        """Prepare a step.

        Args:
            forces: Returns the residual at the start of the step at the owned dofs, ``(d n,)``
                [N].
            free: 1 where the displacement is unknown, 0 where it is given, shape ``(n, 3)``;
                None if all are unknown.
            rigid: Motion of the rigid bodies, which has begun the step.
            at_rest: Tells whether loads and supports are still those of the last step.
            led: Returns the displacements that supports and guides give in the step at the owned
                dofs, ``(d n,)`` [m], 0 at others.
        """

    def accept(self) -> float:
        """Set the velocity at the end of the step that was solved.

        Returns:
            Kinetic energy on this rank for which the step does not account [J].
        """
        u_n, u, _, mean = self._values
        mean[:] = (u - u_n) / float(self.dt.value)
        return self._set_velocity()

    @abstractmethod
    def _set_velocity(self) -> float:
        """Set the velocity from the mean one, see `accept`."""

    def serialize(self, archive: Archive, ids: GlobalInts) -> None:
        """Serialize all on which the next step depends, by the numbers of the owned nodes."""
        serialize_nodal(archive, "mean_velocity", self.mean_velocity, ids)


class MidpointRates(Rates):
    """Velocity that changes linearly in a step: v_{n+1} = 2 (u_{n+1} - u_n)/dt - v_n."""

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
    """Absence of inertia: the velocity stays zero, and time only counts the load.

    Bodies go on as in the last step at first while supports and guides do. Where these begin, stop,
    turn or come back, as where what has been pressed is drawn sideways or let go, nodes beside
    them would be torn away, and the last state is the better start.
    """

    acceleration = None

    def __init__(self, state: State, dt: fem.Constant, bodies: Sequence[Body]) -> None:
        super().__init__(state, dt, bodies)
        self._comm = self.u.function_space.mesh.comm
        # Rates of what supports and guides give, in the last step and in the present one [m/s].
        self._led = fem.Function(self.u.function_space)
        self._now: Floats = np.zeros(0)
        self._goes_on = False

    @property
    def trial(self) -> str:  # type: ignore[override]
        """Name of the first start."""
        return "extrapolated" if self._goes_on else "last"

    def begin(
        self,
        forces: Callable[[], Floats],
        free: Floats | None,
        rigid: RigidMotion,
        at_rest: Callable[[], bool],
        led: Callable[[], Floats],
    ) -> None:
        """Find out whether bodies are likely to go on as in the last step."""
        self._now = now = np.divide(led(), float(self.dt.value))
        last, motion = (f.x.array[: len(now)] for f in (self._led, self.mean_velocity))
        squares = [float(v @ v) for v in (now, last, now - last, motion)]
        *lengths, change, moved = map(float, reductions.total(self._comm, squares))
        # Of one length they are less than 60 degrees apart.
        is_near = change == 0 or change < max(lengths)
        self.at_rest = at_rest()
        self._goes_on = moved > 0 and is_near and not self.at_rest

    def accept(self) -> float:
        self._led.x.array[: len(self._now)] = self._now
        return super().accept()

    def inertia_share(self, mass: Floats) -> Floats:
        """Zero, because the tangent has no inertia."""
        return 0.0 * mass

    def starts(self) -> dict[str, Floats]:
        """Displacements from which Newton's method is tried in turn, by name. Local."""
        u_n, dt = self.u_n.x.array, float(self.dt.value)
        if not self._goes_on:
            return {"last": u_n}
        return {"extrapolated": u_n + dt * self.mean_velocity.x.array, "last": u_n}

    def serialize(self, archive: Archive, ids: GlobalInts) -> None:
        super().serialize(archive, ids)
        serialize_nodal(archive, "given_velocity", self._led, ids)

    def _set_velocity(self) -> float:
        return 0.0
