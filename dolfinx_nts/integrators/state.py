"""Accepted state of a stepper: displacement, velocity and time."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem, la

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import positive, real_array, with_article
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.declaration import SetOnce
from dolfinx_nts.fem.axisymmetry import axis_nodes, is_axisymmetric
from dolfinx_nts.fem.components import dimension, in_space, nodal
from dolfinx_nts.fem.node_numbering import input_ids, reference_positions
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.checks.speed_limit import warn_of_speed
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.errors import agreed

__all__ = ["State", "current_positions", "serialize_nodal"]

# Radial component on the axis relative to the largest one [-] that counts as round-off.
_ROUND_OFF = 1e-9


class State(ABC):
    """Displacement, velocity and time of bodies, which the user may set between steps.

    Collective, as are all its methods, except for `x`.

    Args:
        V: Space of the displacement.
        dt: Length of a step [s].

    Attributes:
        t_n: Time at the start of the last step [s].
        step: Number of accepted steps.
        u: Displacement at t [m], a Function.
        v: Velocity at t [m/s], a Function.
        u_n: Displacement at the start of the last step [m], a Function.
        node_ids: Input numbers of the owned nodes, see `node_numbering`, shape ``(n,)``.
        inertia_defect: Change of kinetic energy minus the work of all forces in the last step
            [J].
    """

    u = SetOnce[fem.Function]("set its values by set_displacement")
    v = SetOnce[fem.Function]("set its values by set_velocity")
    u_n = SetOnce[fem.Function]("it follows from u")

    def __init__(self, V: fem.FunctionSpace, dt: float) -> None:
        # An array, so that other objects can read the time without a reference to this state.
        self._now: Floats = np.zeros(())
        self.t_n, self.step, self.inertia_defect = 0.0, 0, 0.0
        self.u, self.v, self.u_n = (fem.Function(V) for _ in range(3))
        self.u.name, self.v.name = "displacement", "velocity"
        self.node_ids = input_ids(V)[: V.dofmap.index_map.size_local]
        self._comm: MPI.Comm = V.mesh.comm
        self._X: Floats = reference_positions(V)
        self.dt = dt
        # Length of the current step, or between steps of the last one.
        self._dt = fem.Constant(V.mesh, self.dt)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Raise an error with advice if a subclass has not called ``super().__init__``."""
            kind = type(self).__name__
            if "_comm" not in vars(self) and name != "scheme":
                raise AttributeError(
                    f"expected super().__init__(bodies, pairs, dt=...) in the __init__ of {kind} "
                    f"before any use of it, given {with_article(kind)} without {name}"
                )
            raise AttributeError(f"{kind!r} object has no attribute {name!r}")

    @property
    def t(self) -> float:
        """Time [s]."""
        return self._now.item()

    @t.setter
    def t(self, t: float) -> None:
        self._now[()] = t

    @property
    def dt(self) -> float:
        """Length of the next step [s]."""
        return self._usual_dt

    @dt.setter
    def dt(self, dt: float) -> None:
        self._check_dt(dt)
        self._usual_dt = float(dt)

    def _check_dt(self, dt: float) -> None:
        positive("a step dt", dt)

    @contextmanager
    def _steps_of(self, dt: float) -> Iterator[None]:
        """Context with another length dt of steps [s] than the usual one."""
        usual = self._usual_dt
        try:
            self.dt = dt
            yield
        finally:
            self._usual_dt = usual

    @contextmanager
    def _step_of_one_length(self) -> Iterator[None]:
        """Context in which the length of steps must not change. Local."""
        dt = self._usual_dt
        yield
        if (given := self._usual_dt) != dt:
            self._usual_dt = dt
            raise ValueError(
                f"expected dt to be set between two steps, given {given:g} within a step of "
                f"{dt:g}: not in update or in a load, but in the loop over run()"
            )

    @property
    def x(self) -> Floats:
        """Current positions of the local nodes, owned then ghost, shape ``(l, 3)`` [m]."""
        return current_positions(self._X, self.u)

    def serialize(self, archive: Archive) -> None:
        """Serialize all data on which the next step depends.

        Internal variables of ``update`` and of functions in loads are not included.
        """
        self._usual_dt = archive.same("dt", self.dt)
        self.inertia_defect = archive.same("inertia_defect", self.inertia_defect)
        self._serialize_motion(archive)

    def _serialize_motion(self, archive: Archive) -> None:
        self.t = archive.same("t", self.t)
        self.t_n = archive.same("t_n", self.t_n)
        if archive.restores and self.t > self.t_n:
            self._dt.value = self.t - self.t_n
        self.step = archive.same("step", self.step)
        for name, function in (("u", self.u), ("v", self.v), ("u_n", self.u_n)):
            serialize_nodal(archive, name, function, self.node_ids)

    def set_displacement(self, body: Body, value: Any) -> None:
        """Set the displacement of a body, before the first step or between steps.

        Args:
            body: One of the bodies.
            value: One number per component [m]; or a function of the reference positions, shape
                ``(3, n)``, that returns shape ``(3, n)``, in the plane ``(2, n)``; or a Function
                of the space of the bodies.

        Raises:
            TypeError: ``body`` is not a Body, or the value does not consist of real numbers.
            ValueError: The body belongs to another stepper, the Function to another space, or
                the value has the wrong shape, or moves nodes off the axis of an axisymmetric
                mesh.
        """
        self._set(self.u, body, value)

    def set_velocity(self, body: Body, value: Any) -> None:
        """Set the velocity of a body [m/s], before the first step or between steps.

        Arguments and errors as for `set_displacement`. Before the first step, warns of a body that
        is faster than its elastic waves.
        """
        self._set(self.v, body, value)
        if self.step == 0:
            warn_of_speed(body, nodal(self.v)[body.nodes])

    def _set(self, function: fem.Function, body: Body, value: Any) -> None:
        self._check_body(body)
        V, X = self.u.function_space, self._X[body.nodes].T
        with agreed(self._comm, f"set the {function.name} of a body"):
            if isinstance(value, fem.Function):
                if value.function_space != V:
                    raise ValueError(
                        "expected a Function of the bodies' space, given one of another space"
                    )
                value = nodal(value)[body.nodes].T
            values = real_array(f"a {function.name}", value(X) if callable(value) else value)
            shape = dimension(V), X.shape[1]
            if values.shape not in (shape[:1], shape):
                raise ValueError(
                    f"expected a {function.name} of shape {shape[:1]} or {shape}, given "
                    f"{values.shape}"
                )
        before = nodal(function)[body.nodes]
        nodal(function)[body.nodes] = values.T
        try:
            self._keep_axis(function)
        except ValueError:
            nodal(function)[body.nodes] = before
            raise
        self._state_was_set()

    def _keep_axis(self, function: fem.Function) -> None:
        """Raise if a function has a radial component on the axis of an axisymmetric mesh."""
        V, values = function.function_space, nodal(function)
        if not is_axisymmetric(V.mesh):
            return
        axis = axis_nodes(V)
        radial = _kernels.largest_size(values[axis, 0])
        parts = [radial, _kernels.largest_size(values)]
        radial, largest = reductions.largest(self._comm, parts)
        if radial > _ROUND_OFF * largest:
            raise ValueError(
                f"expected no radial {function.name} on the axis x = 0, given one of {radial:g}: "
                "it must vanish there, and be proportional to x near the axis"
            )
        values[axis, 0] = 0.0

    @abstractmethod
    def _check_body(self, body: Body) -> None:
        """Raise unless the body belongs to this state."""

    @abstractmethod
    def _state_was_set(self) -> None:
        """Discard data that depend on the replaced state."""


def current_positions(X: Floats, u: fem.Function) -> Floats:
    """Current positions of the local nodes, shape ``(l, 3)`` [m]. Local.

    Args:
        X: Reference positions, shape ``(l, 3)`` [m].
        u: The displacement [m].
    """
    x: Floats = X + in_space(nodal(u))
    return x


def serialize_nodal(archive: Archive, name: str, function: fem.Function, ids: Any) -> None:
    """Serialize the values of a function at all nodes. Collective.

    Args:
        archive: Archive that stores or returns the values.
        name: Name of the values.
        function: The function, including ghosts.
        ids: Input numbers of the owned nodes, shape ``(n,)``.
    """
    V, values = function.function_space, nodal(function)
    owned = archive.nodal(name, ids, values[: len(ids)])
    if archive.restores:
        vector = la.vector(V.dofmap.index_map, dimension(V))
        vector.array[: owned.size] = owned.ravel()
        vector.scatter_forward()
        values.ravel()[:] = vector.array
