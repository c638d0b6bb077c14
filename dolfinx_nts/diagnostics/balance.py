r"""Energies, momenta and contact forces of a stepper's accepted state.

Integrals have the quadrature of the scheme, so that what it conserves is constant to round-off.
Nodal momenta :math:`p_a = \int \rho_0 v \varphi_a` (in `CentralDifference`
:math:`p_a = v_a \int \rho_0 \varphi_a`) give the kinetic energy :math:`\sum v_a \cdot p_a / 2`,
the linear momentum :math:`\sum p_a` and the angular momentum :math:`\sum x_a \times p_a`. With
du = u_{n+1} - u_n, the total energy changes in a step by

.. math:: [V_{n+1} - V_n - f_{int} \cdot du] - \sum \lambda_N F \cdot du
   + R \cdot du:

the defect of the stress (bulk), the work of the contact forces, and that of the residual which
Newton's method leaves. `StepReport` has the last two.
"""

from dataclasses import dataclass, fields
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arguments import as_call
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.jit import assembled, compile_form
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.obstacles import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.overlaps import Overlap

__all__ = ["Balance", "Diagnostics"]

# How much farther nodes look where the last look found nothing [-].
_FARTHER = 4.0


@dataclass(frozen=True)
class Balance:
    """Energies, momenta and contact forces of one state, the same on all ranks.

    Attributes:
        time: Time [s].
        kinetic_energy: Kinetic energy [J].
        strain_energy: Strain energy [J].
        contact_energy: Energy of penalty and friction springs [J].
        linear_momentum: Linear momentum, shape ``(3,)`` [kg m/s].
        angular_momentum: Angular momentum about the origin, shape ``(3,)`` [kg m^2/s].
        contact_force: Resultant of the last step on the nodes of all pairs, shape ``(3,)`` [N].
        pairs: Force [N] and torque about the origin [N m] of the last step on the nodes of each
            pair, shape ``(p, 2, 3)``.
        obstacles: Force [N] and torque [N m] of the last step on each obstacle, ``(o, 2, 3)``,
            see `Diagnostics.obstacle_resultants`.
        active_nodes: Number of nodes that transmit force.
        min_gap: Least gap [m]; NaN if no node faces a segment.

    Example:
        >>> balance = nts.Diagnostics(stepper).balance()
        >>> f"{balance.total_energy:.6g} J"
        '250 J'
        >>> list(balance.columns())[:3]
        ['time', 'kinetic_energy', 'strain_energy']
    """

    time: float
    kinetic_energy: float
    strain_energy: float
    contact_energy: float
    linear_momentum: Floats
    angular_momentum: Floats
    contact_force: Floats
    pairs: Floats
    obstacles: Floats
    active_nodes: int
    min_gap: float

    @property
    def total_energy(self) -> float:
        """Sum of kinetic, strain and contact energy [J]."""
        return self.kinetic_energy + self.strain_energy + self.contact_energy

    def columns(self) -> dict[str, float]:
        """All numbers by name, with ``_x``, ``_y``, ``_z`` for the parts of a vector. Local."""
        columns: dict[str, float] = {}
        names = [field.name for field in fields(self)]
        names.insert(names.index("contact_energy") + 1, "total_energy")
        for name in names:
            value = getattr(self, name)
            if name in ("pairs", "obstacles"):
                for number, resultant in enumerate(value, start=1):
                    for kind, vector in zip(("force", "torque"), resultant, strict=True):
                        for axis, v in zip("xyz", vector, strict=True):
                            columns[f"{name[:-1]}_{number}_{kind}_{axis}"] = float(v)
            elif isinstance(value, np.ndarray):
                for axis, v in zip("xyz", value, strict=True):
                    columns[f"{name}_{axis}"] = float(v)
            else:
                columns[name] = value
        return columns


class Diagnostics:
    """Evaluates energies, momenta and contact of a stepper's accepted state, without changing it.

    Collective, as are all its methods.

    Args:
        stepper: The stepper.

    Raises:
        TypeError: ``stepper`` is no stepper.

    Example:
        >>> diagnostics = nts.Diagnostics(stepper)
        >>> f"{diagnostics.kinetic_energy():.6g} J, {diagnostics.min_gap():.2g} m"
        '250 J, 0.01 m'
    """

    def __init__(self, stepper: Stepper) -> None:
        """Check the stepper, and compile the forms of the energies."""
        if not isinstance(stepper, Stepper):
            raise TypeError(f"expected a stepper, given {type(stepper).__name__}")
        self._stepper = stepper
        u, u_n = stepper.u, stepper.u_n
        V = u.function_space
        self._comm: MPI.Comm = V.mesh.comm
        self._num_owned = V.dofmap.index_map.size_local
        F_n, F = ufl.Identity(3) + ufl.grad(u_n), ufl.Identity(3) + ufl.grad(u)

        def strain_energy(material: Any, parameters: Any, rho: Any) -> Any:
            return material.psi(F.T * F, **parameters)

        def bulk_defect(material: Any, parameters: Any, rho: Any) -> Any:
            P = stepper.scheme.stress(material, parameters, F_n, F)
            change = material.psi(F.T * F, **parameters) - material.psi(F_n.T * F_n, **parameters)
            return change - ufl.inner(P, F - F_n)

        self._strain_energy, self._bulk_defect = (
            compile_form(bulk_form(stepper.bodies, integrand))
            for integrand in (strain_energy, bulk_defect)
        )
        self._nodal_mass: dict[Body, Floats] = {}

    def __repr__(self) -> str:
        """Return the call that makes such diagnostics, with the class of the stepper. Local."""
        return as_call(self, stepper=type(self._stepper))

    def kinetic_energy(self) -> float:
        """Kinetic energy [J]."""
        return self._motion()[0]

    def strain_energy(self) -> float:
        """Strain energy [J]."""
        return float(self._sum(fem.assemble_scalar(self._strain_energy)))

    def contact_energy(self) -> float:
        """Energy of penalty and friction springs [J]."""
        return float(self._sum(sum(pair.history.energy.sum() for pair in self._stepper.contacts)))

    def linear_momentum(self) -> Floats:
        """Linear momentum, shape ``(3,)`` [kg m/s]."""
        return self._motion()[1]

    def angular_momentum(self) -> Floats:
        """Angular momentum about the origin, shape ``(3,)`` [kg m^2/s]."""
        return self._motion()[2]

    def bulk_defect(self) -> float:
        """Energy that bulk and inertia added to the total energy in the last step [J].

        It is the integral of psi(C) - psi(C_n) - P : (F - F_n), with the stress P of the
        scheme, plus ``inertia_defect`` of the stepper.
        """
        defect = self._sum(fem.assemble_scalar(self._bulk_defect))
        return float(defect + self._stepper.inertia_defect)

    def contact_force(self) -> Floats:
        """Resultant of the last step on the nodes of all pairs, shape ``(3,)`` [N]."""
        force: Floats = self.pair_resultants()[:, 0].sum(axis=0)
        return force

    def pair_resultants(self) -> Floats:
        """Force [N] and torque [N m] of the last step on the nodes of each pair, ``(p, 2, 3)``.

        The torque is about the origin, with the positions in the middle of the step.
        """
        stepper = self._stepper
        x_m = stepper.x - (stepper.u.x.array - stepper.u_n.x.array).reshape(-1, 3) / 2
        parts = np.zeros((len(stepper.contacts), 2, 3))
        for part, pair in zip(parts, stepper.contacts, strict=True):
            force = pair.history.force
            part[:] = force.sum(axis=0), np.cross(x_m[pair.nodes.nodes], force).sum(axis=0)
        resultants: Floats = self._sum(parts)
        return resultants

    def obstacle_resultants(self) -> Floats:
        """Force [N] and torque [N m] of the last step on each rigid obstacle, ``(o, 2, 3)``.

        Obstacles come in the order in which the pairs name them first. The torque is about the
        centre of the motion in the middle of the step, or about the origin if the obstacle is at
        rest. With `EnergyMomentum` the work of a moving obstacle on the bodies is minus force
        times displacement of the centre, minus torque times 2 tan(angle/2) along the axis of the
        turn in the step.
        """
        return self._on_obstacles(self.pair_resultants())

    def _on_obstacles(self, pairs: Floats) -> Floats:
        """Resultants on the obstacles by those on the nodes of all pairs, ``(p, 2, 3)``."""
        stepper = self._stepper
        totals: dict[Obstacle, Floats] = {}
        for number, pair in enumerate(stepper.pairs):
            obstacle = pair.segments
            if isinstance(obstacle, Obstacle):
                force, torque = pairs[number]
                centre = obstacle.motion.frame(stepper.t_n, stepper.t).centre
                on_nodes = np.array([force, torque - np.cross(centre, force)])
                totals[obstacle] = totals.get(obstacle, 0.0) - on_nodes
        return np.array([*totals.values()]).reshape(-1, 2, 3)

    def active_nodes(self) -> int:
        """Number of nodes that transmit force, on all ranks."""
        active = [np.count_nonzero(pair.history.active) for pair in self._stepper.contacts]
        return int(self._sum(sum(active)))

    def min_gap(self) -> float:
        """Least gap of all pairs [m]; NaN if no node faces a segment.

        Pairs whose bounding boxes are farther apart than the least gap found so far are left
        out, and so are segments farther from a node than that. Otherwise nodes look farther and
        farther until one finds a segment.
        """
        x, pairs, least = self._stepper.x, self._stepper.contacts, np.inf
        nearest, farthest = self._distances(x)
        for i in np.argsort(nearest, kind="stable"):
            pair, size = pairs[i], pairs[i].pair.segment_size
            # The point of a gap may lie beside a facet, by up to its size.
            limit = min(least, farthest[i]) + size
            # Nodes that face nothing look at all segments in reach, so most looks are short.
            reach = limit if nearest[i] < 0 else nearest[i] + size
            while nearest[i] <= limit:
                gap = pair.gap(x, min(reach, limit))
                own = reductions.least(self._comm, float(gap[~np.isnan(gap)].min(initial=np.inf)))
                enough = min(own + size, limit)
                if reach >= enough:
                    least = min(least, own)
                    break
                reach = enough if own < np.inf else _FARTHER * reach
        return least if least < np.inf else np.nan

    def overlaps(self) -> list[Overlap]:
        """Find bodies that are inside each other or inside obstacles, whatever the pairs are.

        Bodies that share nodes count as one, and self contact is not looked at. Facets of
        quadrilaterals count as two triangles. A `RigidSurface` is looked at down to half a facet.

        Returns:
            One `Overlap` for each two, empty if bodies only touch.
        """
        stepper = self._stepper
        return stepper.watch.overlaps.search.find(stepper.x, t=stepper.t)[0]

    def _distances(self, x: Floats) -> tuple[Floats, Floats]:
        """Least and greatest distances between nodes and segments of the pairs, each ``(p,)`` [m].

        They are those of the bounding boxes. Those of obstacles are below zero, so that they come
        first, as they know their gaps.
        """
        pairs = self._stepper.contacts
        # Least coordinates of nodes and segments, and least negative ones.
        least = np.full((len(pairs), 2, 2, 3), np.inf)
        for box, pair in zip(least, pairs, strict=True):
            for part, surface in zip(box, (pair.nodes, pair.segments), strict=True):
                if isinstance(surface, Surface):
                    some = x[surface.nodes]
                    part[:] = [(s * some).min(axis=0, initial=np.inf) for s in (1, -1)]
        least = reductions.least(self._comm, least)
        lower, upper = least[:, :, 0], -least[:, :, 1]
        has_box = np.isfinite(least).all(axis=(1, 2, 3))
        lower, upper = (np.where(has_box[:, None, None], ends, 0.0) for ends in (lower, upper))
        apart = np.maximum(lower, lower[:, ::-1]) - np.minimum(upper, upper[:, ::-1])
        nearest = np.linalg.norm(np.maximum(apart[:, 0], 0.0), axis=1)
        farthest = np.linalg.norm(upper.max(axis=1) - lower.min(axis=1), axis=1)
        return np.where(has_box, nearest, -1.0), np.where(has_box, farthest, np.inf)

    def centre_of_mass(self, body: Body) -> Floats:
        """Current centre of mass of a body, shape ``(3,)`` [m].

        Args:
            body: One of the stepper's bodies.

        Raises:
            ValueError: The body belongs to another stepper.
        """
        return self._mean(body, self._stepper.x)

    def body_velocity(self, body: Body) -> Floats:
        """Velocity of the centre of mass of a body, shape ``(3,)`` [m/s].

        Argument and error are those of `centre_of_mass`.
        """
        return self._mean(body, self._stepper.v.x.array.reshape(-1, 3))

    def balance(self) -> Balance:
        """All numbers of the state at once."""
        kinetic_energy, linear, angular = self._motion()
        energies = kinetic_energy, self.strain_energy(), self.contact_energy()
        pairs = self.pair_resultants()
        resultants = pairs[:, 0].sum(axis=0), pairs, self._on_obstacles(pairs)
        counts = self.active_nodes(), self.min_gap()
        return Balance(self._stepper.t, *energies, linear, angular, *resultants, *counts)

    def _motion(self) -> tuple[float, Floats, Floats]:
        """Kinetic energy, linear and angular momentum."""
        n = self._num_owned
        p = self._stepper.nodal_momentum()
        v = self._stepper.v.x.array.reshape(-1, 3)[:n]
        parts = [[np.sum(v * p) / 2], p.sum(axis=0), np.cross(self._stepper.x[:n], p).sum(axis=0)]
        sums = self._sum(np.concatenate(parts))
        return float(sums[0]), sums[1:4], sums[4:]

    def _mean(self, body: Body, values: Floats) -> Floats:
        """Mass-weighted mean of nodal values ``(l, 3)`` over a body."""
        if body not in self._stepper.bodies:
            raise ValueError("expected a body of this stepper, given another")
        if body not in self._nodal_mass:
            eta = ufl.TestFunction(body.V)
            form = bulk_form([body], lambda material, parameters, rho: rho * eta[0])
            masses = assembled(compile_form(form)).reshape(-1, 3)
            self._nodal_mass[body] = self._stepper.carried(masses)[:, 0]
        mass = self._nodal_mass[body]
        sums = self._sum(np.append(mass @ values[: self._num_owned], mass.sum()))
        mean: Floats = sums[:3] / sums[3]
        return mean

    def _sum(self, values: Any) -> Any:
        return reductions.total(self._comm, values)
