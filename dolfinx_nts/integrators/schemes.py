"""Implicit schemes: what is evaluated where within a step.

They differ in the stress, in the kernel of the contact force, and in whether there is inertia;
all else is `ImplicitStepper`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from dolfinx import fem

from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.integrators.implicit import ImplicitStepper
from dolfinx_nts.integrators.rates import MidpointRates, NoRates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.loads import Load

__all__ = ["EnergyMomentum", "Midpoint", "QuasiStatic"]


def _midpoint_stress(material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    """Stress at the mean deformation gradient, see `Scheme`."""
    F_m = (F_n + F) / 2
    return F_m * material.stress(right_cauchy_green(F_m), **parameters)


def _conserving_stress(material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    """Conserving stress on the mean deformation gradient, see `Scheme`."""
    C_n, C = right_cauchy_green(F_n), right_cauchy_green(F)
    return (F_n + F) / 2 * material.conserving_stress(C_n, C, **parameters)


def _end_stress(material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    """Stress at the end of the step, see `Scheme`."""
    return F * material.stress(right_cauchy_green(F), **parameters)


class _FixedScheme(ImplicitStepper):
    """A stepper whose scheme has no parameters."""

    _scheme: ClassVar[Scheme]

    def __init__(
        self,
        bodies: Sequence[Body],
        pairs: Sequence[ContactPair] = (),
        *,
        dt: float,
        bcs: Sequence[fem.DirichletBC] = (),
        loads: Sequence[Load] = (),
        update: Callable[[float], None] | None = None,
        petsc_options: Mapping[str, Any] | None = None,
    ) -> None:
        """Compile the forms; the bodies are at rest and undeformed."""
        super().__init__(
            self._scheme,
            bodies,
            pairs,
            dt=dt,
            bcs=bcs,
            loads=loads,
            update=update,
            petsc_options=petsc_options,
        )


class Midpoint(_FixedScheme):
    """Midpoint rule: stress and contact gradient at (x_n + x_{n+1})/2.

    Conserves momenta; energy is not conserved (Franke, Hesch and Betsch 2011, eqs. 47-52).
    Arguments, attributes and errors are those of `EnergyMomentum`. Collective, as all its
    methods.
    """

    _scheme = Scheme(contact="midpoint", stress=_midpoint_stress, rates=MidpointRates)


class EnergyMomentum(_FixedScheme):
    """Energy-momentum scheme: conserving stress and discrete gradient.

    Conserves linear and angular momentum and, with elastic impact, the total energy, to the
    tolerance of Newton's method (Franke, Hesch and Betsch 2011, eqs. 53-58). Collective, as all
    its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs of these bodies.
        dt: Length of a step [s].
        bcs: Dirichlet conditions on the displacement at the end of a step. Nodes of a moving
            support should start with its velocity: as of any node, it follows from the
            displacements.
        loads: Loads on the bodies.
        update: Called before each step with the time at its end [s], to set the functions and
            constants in ``bcs`` and ``loads``.
        petsc_options: Options of the linear solver: ``ksp_...`` for the Krylov method; all
            others, such as ``pc_type``, for the preconditioner of the bulk, which PETSc makes
            if there are any. Tolerances are set by Newton's method.

    Attributes:
        bodies: The bodies.
        pairs: The contact pairs.
        contacts: What this stepper remembers of each pair.
        loads: The loads.
        t: Time [s].
        dt: Length of the next step [s].
        step: Number of accepted steps.
        timings: Wall time by phase.
        u: Displacement at t [m], a Function of the bodies' space.
        v: Velocity at t [m/s].
        x: Current positions of the local nodes, owned then ghost, shape ``(l, 3)`` [m].

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: Bodies overlap or do not fill the mesh; something belongs to another space;
            ``dt`` is not positive; conditions conflict.
    """

    _scheme = Scheme(contact="conserving", stress=_conserving_stress, rates=MidpointRates)


class QuasiStatic(_FixedScheme):
    """Equilibrium at the end of each step; time only counts the load.

    Contact is closed, g = 0 (there is no impact, so the kind of impact of a multiplier does not
    matter); friction follows the slip from step to step. Supports must leave no body free to
    move rigidly, unless contact holds it. Arguments, attributes and errors are those of
    `EnergyMomentum`; the velocity stays zero, and damping has no effect. Collective, as all its
    methods.
    """

    _scheme = Scheme(
        contact="static",
        stress=_end_stress,
        rates=NoRates,
        stress_share=1.0,
        load_point=1.0,
        loads_at="end",
    )
