"""Mass, energies, momenta and motion of each body of a stepper."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.diagnostics.names import ByName, flat, part_names
from dolfinx_nts.fem.components import (
    deformation_gradient,
    dimension,
    in_space,
    moments,
    nodal,
    resultants,
)
from dolfinx_nts.fem.jit import assembled, compile_form, compile_quickly
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.materials.hyperelastic import right_cauchy_green
from dolfinx_nts.model.bodies import Body, bulk_form, check_member
from dolfinx_nts.parallel import reductions

__all__ = ["BodyBalance", "BodyDiagnostics"]


@dataclass(frozen=True)
class BodyBalance:
    """Energies, momenta and motion of one body, the same on all ranks.

    Attributes:
        mass: Mass [kg].
        kinetic_energy: Kinetic energy [J].
        strain_energy: Strain energy [J].
        linear_momentum: Linear momentum, shape ``(3,)``, in the plane ``(2,)`` [kg m/s].
        angular_momentum: Angular momentum about the origin, shape ``(3,)``, in the plane
            ``(1,)``, about z [kg m^2/s].
        centre_of_mass: Current centre of mass, shape ``(3,)``, in the plane ``(2,)`` [m].
        velocity: Velocity of the centre of mass, shape ``(3,)``, in the plane ``(2,)`` [m/s]. In an
            axisymmetric mesh vectors have one component, along y, and there is no angular momentum.

    Example:
        >>> upper = nts.Diagnostics(stepper).bodies()["upper"]
        >>> f"{upper.mass:.6g} kg at {upper.velocity[2]:.6g} m/s"
        '500 kg at -1 m/s'
    """

    mass: float
    kinetic_energy: float
    strain_energy: float
    linear_momentum: Floats
    angular_momentum: Floats
    centre_of_mass: Floats
    velocity: Floats

    def columns(self, prefix: str) -> dict[str, float]:
        """All quantities by name, with a prefix. Local."""
        return flat(prefix, vars(self))


class BodyDiagnostics:
    """Evaluates the quantities of each body. Collective, as are all its methods.

    Kinetic energy and angular momentum of a node that several bodies share are divided in
    proportion to their masses at the node.

    Args:
        stepper: The stepper.
    """

    def __init__(self, stepper: Stepper) -> None:
        self._stepper = stepper
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm

    @cached_property
    def _masses(self) -> dict[Body, Floats]:
        """Mass of each body at the owned nodes, each ``(n,)`` [kg]."""

        def of(body: Body) -> Floats:
            eta = ufl.TestFunction(body.V)
            form = bulk_form([body], lambda material, parameters, rho: rho * eta[0])
            masses: Floats = assembled(compile_quickly(form)).reshape(-1, dimension(body.V))
            return self._stepper.carried(masses)[:, 0]

        return {body: of(body) for body in self._stepper.bodies}

    @cached_property
    def _shares(self) -> dict[Body, Floats]:
        """Fraction of each node that belongs to each body, each ``(n,)`` [-]."""
        total: Floats = np.sum(list(self._masses.values()), axis=0)
        zero = np.zeros_like(total)
        return {
            body: np.divide(mass, total, out=zero.copy(), where=total > 0)
            for body, mass in self._masses.items()
        }

    @cached_property
    def _strain_energies(self) -> list[fem.Form]:
        C = right_cauchy_green(deformation_gradient(self._stepper.u))

        def energy(material: Any, parameters: Any, rho: Any) -> Any:
            return material.psi(C, **parameters)

        remembered = self._stepper.memory.energy
        return [
            compile_form(bulk_form([body], energy, remembered)) for body in self._stepper.bodies
        ]

    def mean(self, body: Body, values: Floats) -> Floats:
        """Mass-weighted mean of nodal values, ``(l, d)``, over a body.

        Raises:
            ValueError: The body belongs to another stepper.
        """
        check_member(body, self._stepper.bodies)
        mass = self._masses[body]
        sums = reductions.total(self._comm, np.append(mass @ values[: len(mass)], mass.sum()))
        mean: Floats = sums[:-1] / sums[-1]
        return mean

    def balances(self) -> dict[str, BodyBalance]:
        """Quantities of all bodies, by name."""
        stepper, n = self._stepper, len(self._stepper.node_ids)
        x, v = stepper.x[:n], in_space(nodal(stepper.v)[:n])
        p = in_space(stepper.nodal_momentum())
        kinetic, angular = np.einsum("ai,ai->a", v, p) / 2, np.cross(x, p)
        rows = [
            [
                [mass.sum(), share @ kinetic, fem.assemble_scalar(strain_energy)],
                *(mass @ v, share @ angular, mass @ x),
            ]
            for mass, share, strain_energy in zip(
                self._masses.values(), self._shares.values(), self._strain_energies, strict=True
            )
        ]
        sums = reductions.total(self._comm, np.array(rows))
        names = part_names("body", (body.name for body in stepper.bodies))
        V = stepper.u.function_space
        balances = list[BodyBalance]()
        for scalars, linear, turning, moment in sums:
            mass, kinetic_energy, strain_energy = scalars.tolist()
            energies = mass, kinetic_energy, strain_energy
            linear, moment = resultants(linear, V), resultants(moment, V)
            turning = moments(turning, V)
            balances.append(BodyBalance(*energies, linear, turning, moment / mass, linear / mass))
        return ByName("body", names, balances)
