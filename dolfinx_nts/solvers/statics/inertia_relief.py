"""Inertia relief: statics of bodies supported only by contact.

The tangent of such a body is singular for motions that contact does not resist. Two measures help,
and both leave the equilibrium unchanged:

- The tangent, not the residual, gets a small stiffness. It limits the motion of a body in an
  iteration.
- Motions that the current contacts do not resist either, such as sliding along a smooth plane, are
  suppressed. The unbalanced force in them is carried by the inertia of the body (inertia relief).
  It vanishes in equilibrium, and is only accepted while it is negligible.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.precond.mobility import Mobility
from dolfinx_nts.solvers.precond.tangent import Tangent
from dolfinx_nts.solvers.statics.free_bodies import FreeBody

__all__ = ["InertiaRelief"]

_logger = logging.getLogger("dolfinx_nts")

# Stiffness added to the tangent of a free body, relative to its nodes' stiffness [-].
_SHIFT = 1e-9
# Factor on this stiffness for a body that is accelerated by unbalanced forces [-].
_DRIVEN = 1e3
# Stiffness against unresisted motions, relative to the sum of the nodal stiffnesses [-].
_HOLD = 1.0
# Mean square of the slopes of gaps along a motion [-] below which the motion is unresisted.
_NEUTRAL = 1e-3
# Force in unresisted motions, relative to the forces at work [-], that inertia may carry: in a
# solution, where facets of curved surfaces and non-matching nodes cause this much; and during the
# iterations, where a larger force moves the body elsewhere.
_NEGLIGIBLE, _DRIVING = 1e-2, 0.02
# Force in unresisted motions, relative to the forces at work [-], above which there is a warning,
# as less is round-off; and growth of this force [-] for another warning.
_REPORTED, _GROWN = 1e-9, 3.0


@dataclass(frozen=True)
class _Relief:
    """Suppressed motions, and the force that inertia carries in them.

    Attributes:
        motions: The motions at the owned nodes, shape ``(k, 3 n)`` [-].
        weighted: The motions times mass [kg].
        gram: Products of ``motions`` and ``weighted``, shape ``(k, k)`` [kg].
        force: Force that inertia carries, shape ``(n, 3)`` [N].
        free: All free motions at the owned nodes, shape ``(f, n, 3)`` [-].
        suppressed: Suppressed motions as combinations of the free ones, shape ``(f, k)``.
        share: Ratio of the force to the forces at work [-].
        driven: Description of bodies accelerated by unbalanced forces, empty if there are none.
        presses: Whether any contact transmits force.
    """

    motions: Floats
    weighted: Floats
    gram: Floats
    force: Floats
    free: Floats
    suppressed: Floats
    share: float = 0.0
    driven: str = ""
    presses: bool = False

    @classmethod
    def none(cls, free: Floats, driven: str = "", *, presses: bool = False) -> "_Relief":
        """Relief without suppressed motions."""
        nodal = np.zeros(free.shape[1:])
        empty, gram = np.zeros((0, nodal.size)), np.zeros((0, 0))
        suppressed = np.zeros((len(free), 0))
        return cls(empty, empty, gram, nodal, free, suppressed, driven=driven, presses=presses)


class InertiaRelief:
    """Stabilises free bodies, unless unbalanced forces accelerate them. Collective.

    Args:
        bodies: The free bodies.
        tangent: Matrix of the bulk.
        mass: Lumped masses of the owned nodes, shape ``(n,)`` [kg].
        is_prescribed: Flags of the displacements with boundary conditions, shape ``(n, d)``.

    Attributes:
        bodies: The argument.
        force: Force that inertia carries at the owned nodes, shape ``(n, 3)`` [N].
        num_motions: Number of free motions.
        shift: Stiffness added to the tangent, shape ``(n, 1)`` [N/m].
    """

    def __init__(
        self, bodies: Sequence[FreeBody], tangent: Tangent, mass: Floats, is_prescribed: Flags
    ) -> None:
        self.bodies, self._mass = tuple(bodies), mass[:, None]
        self._is_prescribed = is_prescribed
        self._comm: MPI.Comm = tangent.comm
        self.shift = np.zeros_like(self._mass)
        self._label = np.zeros(is_prescribed.shape)  # number of the dof's body, from 1; 0 if none
        for number, body in enumerate(bodies, start=1):
            self.shift[body.nodes, 0] = _SHIFT * tangent.nodal_stiffness()[body.nodes]
            self._label[body.nodes] = number
        parts = [[self.shift[b.nodes].sum(), self._mass[b.nodes].sum()] for b in bodies]
        sums: Floats = reductions.total(self._comm, np.array([[0.0, 1.0], *parts]))
        self._stiffness = _HOLD / _SHIFT * float((sums[:, 0] / sums[:, 1]).max())
        ends = np.cumsum([0, *(body.motions.shape[1] for body in bodies)])
        self._columns = [slice(a, b) for a, b in pairwise(ends)]
        self.num_motions = int(ends[-1])
        self._reported = _REPORTED / _GROWN  # relative force of the last warning
        self.begin()
        for body in self.bodies:
            if self._comm.rank == 0:
                _logger.info("only contact can support %s", body)

    def begin(self) -> None:
        """Begin a solution, without relief."""
        self._limit = _DRIVING
        self._relief = _Relief.none(np.zeros((self.num_motions, *self._label.shape)))
        self._driven: list[str] = []

    @property
    def force(self) -> Floats:
        """Force that inertia carries at the owned nodes, shape ``(n, 3)`` [N]. Local."""
        return self._relief.force

    def relieve(
        self,
        R: Floats,
        x: Floats,
        scale: float,
        steps: Sequence[ContactStep],
        states: Sequence[ContactContribution],
    ) -> Floats:
        """Remove the unbalanced force in unresisted motions from a residual.

        Args:
            R: Residual less the current `force`, shape ``(3 n,)`` [N].
            x: Positions of the owned nodes, shape ``(n, 3)`` [m].
            scale: Norm of the forces at work [N].
            steps: Contact attempts.
            states: Their pairs.

        Returns:
            Residual less the new `force`.
        """
        if not self.bodies:
            return R
        total = R.reshape(self.force.shape) + self.force
        free = np.zeros((self.num_motions, *total.shape))
        for body, columns in zip(self.bodies, self._columns, strict=True):
            free[columns, body.nodes] = body.at(x[body.nodes])[..., : total.shape[1]]
        # Rotations that are free in the reference configuration move the supports of a deformed
        # body.
        free[:, self._is_prescribed] = 0
        pressing = sum(float(np.abs(step.normal.lambda_N).sum()) for step in steps)
        pressing = reductions.total(self._comm, pressing)
        presses = bool(pressing > _NEGLIGIBLE * scale)
        neutral = self._neutral(steps, states, presses)
        motions = np.einsum("ik,inj->knj", neutral, free)
        modes = motions.reshape(len(motions), R.size)
        weighted = (self._mass * motions).reshape(len(motions), R.size)
        sums = np.column_stack([weighted @ modes.T, modes @ total.ravel()])
        sums = reductions.total(self._comm, sums)
        gram, f = sums[:, :-1], sums[:, -1]
        # In orthonormal combinations of the free motions, unit translations and rotations by one
        # over the size of the body, forces are resultants, and moments divided by this size.
        unit, scales = np.linalg.qr(neutral)
        resultants = np.linalg.solve(scales.T, f)
        force, driven = float(np.linalg.norm(resultants)), ""
        share = force / (max(pressing, scale) or 1.0)
        if share > _NEGLIGIBLE:
            parts = [np.linalg.norm(unit[columns] @ resultants) for columns in self._columns]
            body = self.bodies[int(np.argmax(parts))]
            driven = f"no support or contact holds {body} against {force:.3g} N"
        self._driven.append(driven)
        if len(f) and share <= self._limit:
            carried = (np.linalg.solve(gram, f) @ weighted).reshape(total.shape)
            self._relief = _Relief(
                modes, weighted, gram, carried, free, neutral, share, driven, presses
            )
        else:
            self._relief = _Relief.none(free, driven, presses=presses)
        return (total - self.force).ravel()

    def resistance(self, x: Floats) -> Floats:
        """Forces of the added stiffness for displacements, both ``(n, 3)``."""
        relief = self._relief
        y = (_DRIVEN if relief.driven else 1.0) * self.shift * x
        if len(relief.gram):
            amplitudes = self.amplitudes(x.ravel())
            y += self._stiffness * (amplitudes @ relief.weighted).reshape(x.shape)
        return y

    @property
    def is_unsupported(self) -> bool:
        """Whether there are free bodies and no contact transmits force. Local.

        Inertia then carries the loads, and the active set does not matter.
        """
        return bool(self.bodies) and not self._relief.presses

    def mobility(self, added: Floats | float, drag: Floats | float) -> Mobility | None:
        """Additional compliance of free bodies; None without free bodies. Collective.

        Motions suppressed by the last `relieve` stay suppressed; all others have the compliance of
        the added stiffness.

        Args:
            added: Stiffness added to the matrix of the factors, shape ``(n, 1)`` [N/m].
            drag: Stiffness of a viscous resistance, of the same shape or of all nodes [N/m].
        """
        if not self.bodies:
            return None
        relief, driven = self._relief, _DRIVEN * self.shift + drag
        return Mobility.of(self._comm, relief.free, relief.suppressed, added, driven)

    def accept(self) -> bool:
        """Whether the force carried by inertia is negligible; otherwise lower its limit. Local."""
        is_negligible = self._relief.share <= _NEGLIGIBLE
        if not is_negligible:
            self._limit = _NEGLIGIBLE
        return is_negligible

    def advice(self) -> str:
        """Advice for a step without a solution; "" without free bodies. Local."""
        # A majority of iterates decides, since forces of diverging iterates are arbitrary.
        reasons = [driven for driven in self._driven if driven]
        if len(reasons) > len(self._driven) / 2:
            return (
                f"{reasons[-1]}; add bcs or friction, use inertia (EnergyMomentum), or start "
                "closer to the contact"
            )
        if not self.bodies:
            return ""
        names = "; ".join(map(str, self.bodies))
        return f"only contact holds {names}: bcs or friction against these motions may help"

    def warn(self, steps: Sequence[ContactStep]) -> None:
        """Warn of the force that inertia carries in a solution. Local.

        The warning is repeated if the force has grown considerably.
        """
        if self._relief.share <= _GROWN * self._reported:
            return
        self._reported = self._relief.share
        if self._comm.rank == 0:
            names = "; ".join(map(str, self.bodies))
            holds = f"only contact without friction holds {names}"
            remedy = "add bcs or friction against these motions"
            if any(step.state.pair.friction for step in steps):
                holds = (
                    f"contact does not resist all motions of {names}: there is no friction without "
                    "normal force, and contact without friction does not resist sliding"
                )
                remedy = "add bcs, or a load that closes the contact"
            _logger.warning(
                "%s; %.1e of the forces is not balanced, and the result has this relative error: "
                "if it is too large, %s",
                holds,
                self._relief.share,
                remedy,
            )

    @property
    def loads(self) -> Floats:
        """Inertial forces per amplitude of the suppressed motions, shape ``(k, d n)``. Local."""
        return self._relief.weighted

    def restrain(self, du: Floats) -> Floats:
        """Remove the unresisted motions from increments, ``(3 n,)`` [m]."""
        if not len(self._relief.gram):
            return du
        kept: Floats = du - self.amplitudes(du) @ self._relief.motions
        return kept

    def amplitudes(self, du: Floats) -> Any:
        """Amplitudes of the unresisted motions in displacements, ``(3 n,)`` [m]."""
        moments = reductions.total(self._comm, self._relief.weighted @ du)
        return np.linalg.solve(self._relief.gram, moments)

    def _neutral(
        self, steps: Sequence[ContactStep], states: Sequence[ContactContribution], presses: bool
    ) -> Floats:
        """Unresisted motions as combinations of the free motions, ``(free, neutral)``.

        Sliding nodes resist motions along the surface by friction alone, and not at all if contact
        transmits no force.
        """
        n = self.num_motions
        products, counts = np.zeros((n, n)), np.zeros(n)
        for step, state in zip(steps, states, strict=True):
            label = step.candidates.scatter.forward(in_space(self._label))[:, 0]
            x = step.state.search.frame.in_space(step.x)
            dofs, gradients = state.pairs.dofs, state.pairs.gradients
            gradients, dofs = gradients[state.active].copy(), dofs[state.active]
            if not presses:
                gradients[state.rank[state.active] == 1, 1:] = 0
            slopes = np.zeros((n, len(dofs), 3))
            for number, body in enumerate(self.bodies, start=1):
                columns = self._columns[number - 1]
                of_body = label[dofs] == number
                motions = body.at(x[dofs]) * of_body[:, :, None]
                motions = motions.reshape(len(motions), len(dofs), gradients.shape[2])
                slopes[columns] = np.einsum("mid,kmd->kmi", gradients, motions)
                counts[columns] += np.count_nonzero(of_body.any(axis=1))
            rows = slopes.reshape(n, 3 * len(dofs))
            products += rows @ rows.T
        sums = reductions.total(self._comm, np.column_stack([products, counts]))
        if not np.isfinite(sums).all():  # pairs without a projection make the step fail
            return np.zeros((n, 0))
        weight = 1 / np.sqrt(np.maximum(sums[:, -1], 1.0))
        values, vectors = np.linalg.eigh(sums[:, :-1] * weight * weight[:, None])
        neutral: Floats = weight[:, None] * vectors[:, values < _NEUTRAL]
        return neutral
