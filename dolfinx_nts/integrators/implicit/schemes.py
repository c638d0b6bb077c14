"""Implicit steppers whose schemes have no parameters.

They differ in the stress and in the contact kernel; `ImplicitStepper` implements the rest.
"""

from typing import Any

from dolfinx_nts.integrators.implicit.implicit_stepper import ImplicitStepper
from dolfinx_nts.integrators.rates import MidpointRates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green

__all__ = ["EnergyMomentum", "Midpoint"]


def _midpoint_stress(material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    F_m = (F_n + F) / 2
    return F_m * material.stress(right_cauchy_green(F_m), **parameters)


def _conserving_stress(material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    C_n, C = right_cauchy_green(F_n), right_cauchy_green(F)
    return (F_n + F) / 2 * material.conserving_stress(C_n, C, **parameters)


class Midpoint(ImplicitStepper):
    """Midpoint rule, with stress and contact gradient at the mean state, for comparison.

    It conserves both momenta but not the energy (Franke, Hesch and Betsch 2011, eqs. 47-52).
    Arguments, attributes and errors as for `EnergyMomentum`. Collective, as are all its
    methods.

    Example:
        >>> stepper = nts.Midpoint(bodies, [pair], dt=0.01)
        >>> stepper.set_velocity(other, (0.0, 0.0, -1.0))
        >>> [step.num_active for step in stepper.run(until=0.02)]
        [0, 4]
    """

    scheme = Scheme(
        contact="midpoint",
        stress=_midpoint_stress,
        rates=MidpointRates,
    )


class EnergyMomentum(ImplicitStepper):
    """Advances bodies and their contact by the energy-momentum scheme.

    It conserves linear and angular momentum and, with springs or elastic impact, the total energy,
    to the tolerance of Newton's method. If a loaded spring loses its segment, an impulse returns
    its energy to the bodies. Where that is impossible, the energy is lost, and the energy ledger
    lists it as ``facet_change``. The work of the stress in a step is exactly the change of the
    strain energy, and the contact force is a discrete gradient of the gap (Franke, Hesch and Betsch
    2011, eqs. 53-58). Collective, as are all its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs of these bodies.
        dt: Length of a step [s].
        bcs: Dirichlet conditions on the displacement at the end of a step. Nodes of a moving
            support should start with its velocity, because the velocity of all nodes follows
            from their displacements.
        loads: Loads on the bodies.
        update: Called before each step with the time at its end [s], to set the functions and
            constants in ``bcs`` and ``loads``. If ``loads`` contain any of these, it is also called
            with the time of the loads, the middle of the step. Its results should depend on the
            time only.
        petsc_options: Options of the linear solver by name, without a dash. Options ``ksp_...``
            are for the Krylov method, a flexible GMRES; another ``ksp_type`` needs preconditioning
            from the right, so that ``cg`` is refused. Newton's method sets tolerances and the
            largest number of iterations. All other options, such as ``pc_type``, select a PETSc
            preconditioner of the bodies.

    Attributes:
        bodies, pairs, loads: The arguments.
        contacts: State of each pair in this stepper.
        t: Time [s].
        dt: Length of the next step [s].
        step: Number of accepted steps.
        statistics: Counts of solver work so far.
        timings: Wall time by phase.
        u: Displacement at t [m], a Function of the bodies' space.
        v: Velocity at t [m/s], a Function of the same space.
        x: Current positions of the local nodes, owned then ghost, shape ``(l, 3)`` [m].

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: Bodies overlap or do not fill the mesh; something belongs to another space;
            ``dt`` is not positive; conditions conflict.

    Example:
        >>> gravity = nts.Gravity(bodies, (0.0, 0.0, -9.81))
        >>> stepper = nts.EnergyMomentum(bodies, [pair], dt=0.01, loads=[gravity])
        >>> step = stepper.advance()
        >>> stepper
        EnergyMomentum(t=0.01, dt=0.01, step=1, bodies=2, pairs=1, loads=1)
    """

    scheme = Scheme(
        contact="conserving",
        stress=_conserving_stress,
        rates=MidpointRates,
        resolves_impact=True,
    )
