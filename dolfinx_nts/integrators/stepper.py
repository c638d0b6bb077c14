"""Stepper: owns the accepted state and advances it.

How a step is solved is up to `ImplicitStepper` and
`CentralDifference`.
"""

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

from mpi4py import MPI

import numpy as np
from dolfinx import fem, la

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import finite, instances, positive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.timing import Timings
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.start import check_start
from dolfinx_nts.fem.node_numbering import input_ids
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.step_control import EvenSteps, StepControl, StepLength
from dolfinx_nts.integrators.time_loop import run_controlled, run_evenly
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.model.bodies import Body, check_bodies
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.model.inverted_cells import VolumeRatio
from dolfinx_nts.model.loads import Load
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.errors import agreed, end_together

__all__ = ["Stepper"]


_logger = logging.getLogger("dolfinx_nts")


class Stepper(ABC):
    """Owns the accepted state (t, u, v, contact) and advances it.

    Collective, as all its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs of these bodies.
        dt: Length of a step [s].
        loads: Loads on the bodies.
        update: Called before each step with the time at its end [s].

    Attributes:
        bodies: The bodies.
        pairs: The contact pairs.
        contacts: What this stepper remembers of each pair.
        loads: The loads.
        t: Time [s].
        dt: Length of the next step [s].
        step: Number of accepted steps.
        timings: Wall time by phase.
        u: Displacement at t.
        v: Velocity at t.
        u_n: Displacement at the start of the last step.
        node_ids: Numbers of the owned nodes, see `node_numbering`, ``(n,)``.
        even: Times at the ends of equal steps.
        length: Length of a step as a part of the usual one, in controlled
            runs.
        inertia_defect: Kinetic energy gained in the last step less the
            work of all forces in it [J].
    """

    _contact: ClassVar[str]  # kernel of contact
    _load_point: float = 0.5  # where in a step the loads are taken
    _supports: Supports

    def __init__(
        self,
        bodies: Sequence[Body],
        pairs: Sequence[ContactPair],
        *,
        dt: float,
        loads: Sequence[Load],
        update: Callable[[float], None] | None,
    ) -> None:
        """Check the arguments; the bodies are at rest and undeformed."""
        V = check_bodies(bodies)
        self.bodies, self.pairs = tuple(bodies), instances(ContactPair, pairs)
        self.loads = instances(Load, loads)
        for pair in self.pairs:
            if pair.nodes.V != V:
                raise ValueError("expected bodies and pairs in one function space, given two")
            if pair.is_convective and self._contact != "midpoint":
                raise ValueError(
                    f"expected Midpoint with convective friction, given {type(self).__name__}"
                )
        for load in self.loads:
            if load.V != V:
                raise ValueError("expected bodies and loads in one function space, given two")
        end_together()
        self.contacts = tuple(PairState(pair) for pair in self.pairs)
        self.t, self.step = 0.0, 0
        self.inertia_defect = 0.0
        self.timings = Timings()
        self._update = update
        self._dt = fem.Constant(V.mesh, 0.0)
        self.dt = dt
        self.u, self.v, self.u_n = (fem.Function(V) for _ in range(3))
        self.u.name, self.v.name = "displacement", "velocity"
        # Asking a Function for its values takes as long as copying those of a small mesh.
        self._u, self._u_n = self.u.x.array, self.u_n.x.array
        self._comm: MPI.Comm = V.mesh.comm
        self._X: Floats = V.tabulate_dof_coordinates()
        self._num_owned = V.dofmap.index_map.size_local
        self.node_ids = input_ids(V)[: self._num_owned]
        self.even, self.length = EvenSteps(), StepLength()
        self._volume_ratio = VolumeRatio(self.u)

    @abstractmethod
    def first_piola(self, material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
        """First Piola-Kirchhoff stress of a step [Pa], UFL (3, 3). Local.

        Args:
            material: The material.
            parameters: Its numbers, as constants.
            F_n: Deformation gradient at the start of the step, UFL (3, 3).
            F: The same at its end.
        """

    @abstractmethod
    def nodal_momentum(self) -> Floats:
        """Momentum of the owned nodes at t, shape ``(n, 3)`` [kg m/s].

        Collective.
        """

    @abstractmethod
    def _step(self) -> StepReport:
        """Solve a step from u_n, v to u, v and set the pairs' history."""

    def describe(self) -> list[str]:
        """Lines on the pairs, with numbers that were derived. Local."""
        return [f"pair {number}: {pair}" for number, pair in enumerate(self.contacts, start=1)]

    @property
    def dt(self) -> float:
        """Length of the next step [s]."""
        return self._usual

    @dt.setter
    def dt(self, dt: float) -> None:
        self._check_dt(dt)
        self._set_dt(dt)

    def _set_dt(self, dt: float) -> None:
        self._usual = float(dt)
        self._dt.value = dt  # in the forms

    def _check_dt(self, dt: float) -> None:
        positive("a step dt", dt)

    @property
    def supports(self) -> Supports:
        """The Dirichlet conditions."""
        return self._supports

    @property
    def x(self) -> Floats:
        """Positions of the local nodes, owned then ghost, ``(l, 3)`` [m]."""
        x: Floats = self._X + self.u.x.array.reshape(-1, 3)
        return x

    def serialize(self, archive: Archive) -> None:
        """Serialize the accepted state and all that the next step depends on.

        But for what ``update`` and the functions of loads remember.

        Args:
            archive: Takes the state or gives it.
        """
        self.t = archive.same("t", self.t)
        self.step = archive.same("step", self.step)
        self._set_dt(archive.same("dt", self.dt))
        self.even.serialize(archive)
        self.length.serialize(archive)
        self.inertia_defect = archive.same("inertia_defect", self.inertia_defect)
        for name, function in (("u", self.u), ("v", self.v), ("u_n", self.u_n)):
            self._serialize_nodal(archive, name, function.x.array)
        for number, contact in enumerate(self.contacts, start=1):
            contact.serialize(archive, f"pair_{number}")

    def _serialize_nodal(self, archive: Archive, name: str, values: Floats) -> None:
        """Serialize values of the local nodes, shape ``(3 l,)``."""
        n = 3 * self._num_owned
        owned = archive.nodal(name, self.node_ids, values[:n].reshape(-1, 3))
        if archive.giving:
            vector = la.vector(self.u.function_space.dofmap.index_map, 3)
            vector.array[:n] = owned.ravel()
            vector.scatter_forward()
            values[:] = vector.array

    def set_displacement(self, body: Body, value: Any) -> None:
        """Set the displacement of a body, before or between steps.

        Args:
            body: One of the bodies.
            value: Three numbers [m]; or a function of the reference
                positions, shape ``(3, n)``, that returns ``(3, n)``; or
                a Function of the bodies' space.

        Raises:
            ValueError: The body is of another stepper, the Function of
                another space, or the value has the wrong shape.
        """
        self._set(self.u, body, value)

    def set_velocity(self, body: Body, value: Any) -> None:
        """Set the velocity of a body, before or between steps.

        Args:
            body: One of the bodies.
            value: Three numbers [m/s]; or a function of the reference
                positions, shape ``(3, n)``, that returns ``(3, n)``; or
                a Function of the bodies' space.

        Raises:
            ValueError: The body is of another stepper, the Function of
                another space, or the value has the wrong shape.
        """
        self._set(self.v, body, value)

    def _set(self, function: fem.Function, body: Body, value: Any) -> None:
        if body not in self.bodies:
            raise ValueError("expected a body of this stepper, given another")
        X = self._X[body.nodes].T
        with agreed(self._comm):
            if isinstance(value, fem.Function):
                if value.function_space != self.u.function_space:
                    raise ValueError(
                        "expected a Function of the bodies' space, given one of another"
                    )
                value = value.x.array.reshape(-1, 3)[body.nodes].T
            values = np.asarray(value(X) if callable(value) else value, dtype=np.float64)
            if values.shape not in ((3,), X.shape):
                raise ValueError(f"expected shape (3,) or {X.shape}, given {values.shape}")
        function.x.array.reshape(-1, 3)[body.nodes] = values.T
        self._state_was_set()

    @abstractmethod
    def _state_was_set(self) -> None:
        """Called after the displacement or the velocity has been set."""

    def advance(self) -> StepReport:
        """Advance by one step of length ``dt``.

        Returns:
            Report of the step.

        Raises:
            ConvergenceError: The step could not be solved. The state is
                as before the call.
            ValueError: The state, a load or a condition is not finite,
                conditions conflict, or the first step starts inside a
                rigid obstacle. The state is as before the call.
        """
        self._check_state()
        if self.step == 0:
            for contact in self.contacts:
                check_start(contact, self.x)
        if self._update is not None or self.loads:
            with agreed(self._comm):
                self._call_back()
        self._supports.check()
        self._u_n[:] = self._u
        report = self._step()
        self.t, self.step = report.t, report.step
        if self._comm.rank == 0:
            _logger.info(
                "step %d, t = %g: %d iterations, %d active",
                report.step,
                report.t,
                report.newton_iterations,
                report.num_active,
            )
        return report

    def _call_back(self) -> None:
        """Ask the user's functions for the values of the next step. Local."""
        if self._update is not None:
            self._update(self.t + self.dt)
        for load in self.loads:
            load.update(self.t + self._load_point * self.dt)

    def run(self, until: float, control: StepControl | None = None) -> Iterator[StepReport]:
        """Advance step by step; the last step ends exactly at ``until``.

        Args:
            until: Time at the end [s].
            control: Cuts steps that fail; None: every step has the length
                `dt`, but for the last.

        Yields:
            The report of each step, after it has been accepted.

        Raises:
            ConvergenceError: A step failed, with a control at its smallest
                length. The state is that of the last accepted step.
        """
        finite("until", until)
        if control is None:
            yield from run_evenly(self, until)
        else:
            yield from run_controlled(self, until, control)

    def longest_step(self) -> float:
        """Length that a step must not exceed [s]. Collective."""
        return math.inf

    def advance_to(self, end: float, dt: float) -> StepReport:
        """Advance by one step that ends exactly at a time; keeps `dt`.

        Args:
            end: Time at its end [s].
            dt: Its length [s], the difference of the times but for round-off.

        Returns:
            Report of the step.

        Raises:
            ConvergenceError: As `advance`.
        """
        usual = self.dt
        try:
            self.dt = dt
            report = self.advance()
        finally:
            self._set_dt(usual)
        self.t = end
        return report._replace(t=end)

    def _check_state(self) -> None:
        bad = [
            np.count_nonzero(~np.isfinite(function.x.array[: 3 * self._num_owned]))
            for function in (self.u, self.v)
        ]
        counts = reductions.total(self._comm, bad)
        for name, count in zip(("displacement", "velocity"), counts, strict=True):
            if count:
                raise ValueError(f"expected a finite {name}, given {count} dofs that are not")
