r"""Rigid bodies in the balance of a step: six unknowns each, in the place of those of their nodes.

Positions of the nodes of a rigid body are linear in the reference position. A step rotates them, so
that with the Cayley vector :math:`\theta` of the rotation, whatever it is,

.. math:: x_{n+1} - x_n = \Delta\varphi + \theta \times (x_m - \varphi_m),
   \qquad x_m = \tfrac12 (x_n + x_{n+1}),

holds exactly. The balance of a body is that of resultant and moment of all nodal forces about its
mean position: both momenta are conserved, and as the work of the forces is that of resultant and
moment, so is the energy. No multiplier keeps the body rigid. In statics forces act at the end of
the step, and in the generalised-alpha method between both ends: the weighted mean there takes the
place of :math:`x_m` in the balance.

A guide leaves some combinations of :math:`\Delta\varphi` and :math:`\theta` free, which do not
depend on the state, and gives the others. The balance is that of the free ones.

Linear systems keep nodal unknowns. Rigid bodies project them, as contact does, see `elimination`:
increments are rigid motions at the end of the step, and forces are replaced by such fields with
the same resultant and moment.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.solvers.linear_fields import (
    TURNS,
    LinearFields,
    nearest,
    products_of,
    rigid_motions,
    turned,
)
from dolfinx_nts.solvers.rigid_states import RigidStates

__all__ = ["RigidColumns", "RigidMotion"]


class RigidColumns(NamedTuple):
    """Free motions of one body in the unknowns of its nodes, see `RigidMotion.columns`.

    Attributes:
        dofs: Owned dofs of the body, shape ``(d n,)``.
        end: Motions at the end of the step, shape ``(d n, k)``.
        mean: The same at the mean position.
        turning: Derivative of resultant and moment by the motions at fixed forces, ``(k, k)``.
    """

    dofs: Ints
    end: Floats
    mean: Floats
    turning: Floats


class _Linearisation:
    """Balance of one body near positions in a step. Local.

    Args:
        fields: Linear fields over the body.
        q_n: Coefficients of the positions at the start.
        q: The same at the end.
        part: Where between them forces act, from 0 to 1 [-].
        forces: Total sums of the nodal forces on the body [N, N m].
        inertia: Sums of products of the fields with mass, times what inertia has of it in the
            tangent, shape ``(d + 1, d + 1)``.

    Attributes:
        end: Coefficients of the free motions at the end, shape ``(k, d + 1, d)``.
        mean: The same where forces act.
        turning: See `RigidColumns`.
    """

    def __init__(
        self,
        fields: LinearFields,
        q_n: Floats,
        q: Floats,
        part: float,
        forces: Floats,
        inertia: Floats,
    ) -> None:
        turns, free = TURNS[q.shape[1]], fields.free
        end, mean = rigid_motions(q), rigid_motions((1 - part) * q_n + part * q)
        self.end, self.mean = (np.einsum("kl,lmi->kmi", free, motions) for motions in (end, mean))
        # Forces stay as they are where their levers turn.
        turning = np.zeros((len(end), len(end)))
        levers = part * end[:, 1:]
        turning[-len(turns) :] = np.einsum("kij,lmj,mi->kl", turns, levers, forces[1:])
        self.turning: Floats = free @ turning @ free.T
        products = fields.products
        self._of_end = np.linalg.inv(products_of(self.end, products, self.end))
        self._of_forces = np.linalg.inv(products_of(self.mean, products, self.end))
        self._stiffness = products_of(self.mean, inertia, self.end) + self.turning

    def project(self, x: Floats, y: Floats) -> Floats:
        """Coefficients of the forces that stand for y where increments x turn the levers."""
        amounts = self._of_end @ np.einsum("kmi,mi->k", self.end, x)
        resultant = self._resultant(y) + self.turning @ amounts
        return self._field(self._of_forces @ resultant)

    def respond(self, r: Floats) -> Floats:
        """Coefficients of the increments by which inertia alone balances forces r."""
        amounts = np.linalg.solve(self._stiffness, self._resultant(r))
        return self._field(np.asarray(amounts, dtype=np.float64))

    def _resultant(self, sums: Floats) -> Floats:
        """Resultant and moment in the free motions [N, N m]."""
        resultant: Floats = np.einsum("kmi,mi->k", self.mean, sums)
        return resultant

    def _field(self, amounts: Floats) -> Floats:
        field: Floats = np.einsum("k,kmi->mi", amounts, self.end)
        return field


class RigidMotion(RigidStates):
    """Motion of all rigid bodies in a step. Collective, as are all methods.

    Vectors are nodal, see `RigidStates`. Without rigid bodies they are returned as they are.

    Args:
        V: Space of the displacement.
        bodies: Linear fields over each rigid body.
        masses: Their products with the mass of each, see `_Linearisation` [kg].
        inertia_share: What inertia has of a mass in the tangent of a step [N/m].
        part: Where between start and end of a step forces act, from 0 to 1 [-].

    Attributes:
        part: The argument.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        bodies: Sequence[LinearFields] = (),
        masses: Sequence[Floats] = (),
        inertia_share: Callable[[Floats], Floats] = np.zeros_like,
        part: float = 0.5,
    ) -> None:
        """Keep the bodies, as yet without positions."""
        super().__init__(V, bodies)
        self.part, self._masses, self._share = part, tuple(masses), inertia_share
        self._starts: list[Floats] = []
        self._states: list[_Linearisation] = []

    @property
    def has_no_inertia(self) -> bool:
        """Whether contact and loads alone resist free motions of bodies. Local."""
        moves = any(np.any(self._share(mass)) for mass in self._masses)
        return not moves and any(body.free.size for body in self._bodies)

    def begin(self, u_n: Floats) -> None:
        """Begin a step from displacements u_n [m]."""
        if self.exists:
            self._starts = self._positions(self._sums(u_n))

    def balance(self, u: Floats, R: Floats) -> Floats:
        """Linearise at displacements u [m], and replace the residual R [N] by rigid fields."""
        if not self.exists:
            return R
        sums = self._sums(u, R)
        self._states = [
            _Linearisation(body, q_n, q, self.part, forces[1], self._share(mass))
            for body, mass, q_n, q, forces in zip(
                self._bodies, self._masses, self._starts, self._positions(sums), sums, strict=True
            )
        ]
        fields = (s.project(np.zeros_like(f), f) for s, (_, f) in self._with_states(sums))
        return self._put(fields, R.copy())

    def project(self, x: Floats, y: Floats) -> Floats:
        """Replace forces y by rigid fields, for increments x [m]; overwrites y."""
        if not self.exists:
            return y
        sums = self._sums(x, y)
        return self._put((state.project(*each) for state, each in self._with_states(sums)), y)

    def respond(self, r: Floats) -> Floats:
        """Replace forces r by the increments with which inertia balances them; overwrites r."""
        sums = self._sums(r)
        return self._put((state.respond(f) for state, (f,) in self._with_states(sums)), r)

    def moved(self, u: Floats, du: Floats, *, leads: float = 0.0) -> Floats:
        """Displacements u [m] after increments du, by which rigid bodies turn and do not stretch.

        Increments of rigid bodies are taken as free motions at u. At the start of a step guides
        lead the bodies in the others, by the part ``leads`` of their way.
        """
        result: Floats = u + du
        if not self.exists:
            return result
        sums = self._sums(u, du)
        fields = []
        for body, q, (_, increment), led in zip(
            self._bodies, self._positions(sums), sums, self.guides.led, strict=True
        ):
            amounts = nearest(rigid_motions(q), body.products, increment)
            amounts = body.free.T @ (body.free @ amounts) + leads * led
            # Small changes that are added have all their digits; positions would lose some.
            fields.append(turned(q, amounts))
        changes = self._put(fields, np.zeros_like(u))
        result[self.nodes] = (u + changes)[self.nodes]
        return result

    def nearest_free(self, values: Floats) -> Floats:
        """Replace values at rigid bodies by the nearest free motions at the start of the step."""
        if not self.exists:
            return values
        fields = []
        for body, q, (of_values,) in zip(
            self._bodies, self._starts, self._sums(values), strict=True
        ):
            motions = np.einsum("kl,lmi->kmi", body.free, rigid_motions(q))
            amounts = nearest(motions, body.products, of_values)
            fields.append(np.einsum("k,kmi->mi", amounts, motions))
        return self._put(fields, values)

    def centripetal(self, v: Floats) -> Floats:
        """Acceleration at the start of the step by velocities v that stay [m/s^2]."""
        fields = []
        for body, q, (of_v,) in zip(self._bodies, self._starts, self._sums(v), strict=True):
            rate = nearest(rigid_motions(q), body.products, of_v)
            spin = np.einsum("k,kij->ij", rate[self.dim :], TURNS[self.dim])
            field = q @ (spin @ spin).T
            field[0] = 0.0
            fields.append(field)
        return self._put(fields, np.zeros_like(v))

    def led(self, u: Floats) -> Floats:
        """Part of the displacement to u in the step that guides give, where forces act [m]."""
        fields = []
        sums, part = self._sums(u), self.part
        for q_n, q, led in zip(self._starts, self._positions(sums), self.guides.led, strict=True):
            motions = rigid_motions((1 - part) * q_n + part * q)
            fields.append(np.einsum("k,kmi->mi", led, motions))
        return self._put(fields, np.zeros_like(u))

    def columns(self) -> list[RigidColumns]:
        """Motions of each body in the unknowns of its nodes. Local."""
        columns = []
        for body, state in zip(self._bodies, self._states, strict=True):
            dofs = (self.dim * body.nodes[:, None] + np.arange(self.dim, dtype=np.int32)).ravel()
            ends = (np.einsum("nm,kmi->nik", body.values, c) for c in (state.end, state.mean))
            end, mean = (motions.reshape(len(dofs), len(state.end)) for motions in ends)
            columns.append(RigidColumns(dofs, end, mean, state.turning))
        return columns

    def without(self, values: Floats) -> Floats:
        """Copy of a vector with zeros at rigid bodies. Local."""
        copy = values.copy()
        copy[self.nodes] = 0.0
        return copy

    def _with_states(self, sums: Sequence[Floats]) -> "zip[tuple[_Linearisation, Floats]]":
        return zip(self._states, sums, strict=True)
