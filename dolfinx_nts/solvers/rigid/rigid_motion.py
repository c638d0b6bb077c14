r"""Rigid bodies in the balance of a step: six unknowns each, instead of nodal unknowns.

Positions of the nodes of a rigid body are linear in the reference position. With the Cayley vector
:math:`\theta` of the rotation in a step,

.. math:: x_{n+1} - x_n = \Delta\varphi + \theta \times (x_m - \varphi_m),
   \qquad x_m = \tfrac12 (x_n + x_{n+1}),

holds exactly for any rotation. The equations of a body balance resultant and moment of all nodal
forces about its mean position. They conserve both momenta and, as the forces work through resultant
and moment only, the energy. No multiplier is needed for rigidity. In statics forces act at the end
of the step, and in the generalised-alpha method between both ends: the weighted mean then replaces
:math:`x_m` in the balance.

A guide prescribes some combinations of :math:`\Delta\varphi` and :math:`\theta`, which do not
depend on the state. Only the free ones are balanced. Axisymmetric bodies are free along the axis
alone.

Linear systems keep nodal unknowns, and rigid bodies are projections of them, like contact, see
`elimination`: increments are projected on rigid motions at the end of the step, and forces on such
fields with the same resultant and moment.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.solvers.rigid.linear_fields import (
    TURNS,
    LinearFields,
    combined,
    inner_products,
    nearest,
    products_of,
    rigid_motions,
    solved,
    spins,
    turned,
)
from dolfinx_nts.solvers.rigid.rigid_fields import Freedom
from dolfinx_nts.solvers.rigid.rigid_states import RigidStates

__all__ = ["RigidColumns", "RigidMotion"]


class RigidColumns(NamedTuple):
    """Free motions of one body in the unknowns of its nodes, see `RigidMotion.columns`.

    Attributes:
        dofs: Owned dofs of the body, shape ``(d n,)``.
        end: Motions at the end of the step, shape ``(d n, k)``.
        mean: Motions at the mean position, the same shape.
        turning: Derivative of resultant and moment with respect to the motions at fixed forces,
            ``(k, k)``.
    """

    dofs: Ints
    end: Floats
    mean: Floats
    turning: Floats


class _Linearisation:
    """Linearised balance of ``b`` bodies in a step. Local.

    Args:
        freedom: Free motions of each body.
        products: Products of the linear fields, shape ``(b, d + 1, d + 1)``.
        q_n: Coefficients of the positions at the start, shape ``(b, d + 1, d)``.
        q: Coefficients of the positions at the end.
        part: Point between start and end at which forces act, from 0 to 1 [-].
        forces: Total sums of the nodal forces, shape ``(b, d + 1, d)`` [N, N m].
        inertia: Products of the linear fields with mass, times the factor of inertia in the
            tangent, shape ``(b, d + 1, d + 1)``.

    Attributes:
        end: Coefficients of the free motions at the end, shape ``(b, k, d + 1, d)``.
        mean: Coefficients at the point where forces act.
        turning: See `RigidColumns`, shape ``(b, k, k)``.
    """

    def __init__(
        self,
        freedom: Freedom,
        products: Floats,
        q_n: Floats,
        q: Floats,
        part: float,
        forces: Floats,
        inertia: Floats,
    ) -> None:
        dim, turns, (free, no_motion) = q.shape[-1], TURNS[q.shape[-1]], freedom
        end, mean = rigid_motions(q), rigid_motions((1 - part) * q_n + part * q)
        self.end, self.mean = combined(free, end[:, None]), combined(free, mean[:, None])
        # Forces are fixed while their lever arms rotate.
        turning = np.zeros_like(free)
        turned_forces = forces[:, None, 1:] @ turns
        levers = part * end[:, :, 1:]
        for turn in range(len(turns)):
            turning[:, dim + turn] = inner_products(levers, turned_forces[:, turn])
        self.turning: Floats = free @ turning @ free.transpose(0, 2, 1)
        self._of_end = np.linalg.inv(products_of(self.end, products, self.end) + no_motion)
        self._of_forces = np.linalg.inv(products_of(self.mean, products, self.end) + no_motion)
        self._stiffness = products_of(self.mean, inertia, self.end) + self.turning + no_motion

    def project(self, x: Floats, y: Floats) -> Floats:
        """Coefficients of rigid forces equivalent to y, with arms rotated by increments x."""
        amplitudes = self._of_end @ inner_products(self.end, x)[..., None]
        resultant = inner_products(self.mean, y)[..., None] + self.turning @ amplitudes
        return combined((self._of_forces @ resultant)[..., 0], self.end)

    def respond(self, r: Floats) -> Floats:
        """Coefficients of the increments whose inertia balances forces r."""
        return combined(solved(self._stiffness, inner_products(self.mean, r)), self.end)


class RigidMotion(RigidStates):
    """Motion of all rigid bodies in a step. Collective, as are all methods.

    Vectors are nodal, see `RigidStates`. Without rigid bodies they are returned unchanged.

    Args:
        V: Space of the displacement.
        bodies: Linear fields over each rigid body.
        masses: Their products with the mass of each body, see `_Linearisation` [kg].
        inertia_share: Returns the contribution of a mass to the tangent of a step [N/m].
        part: Point between start and end of a step at which forces act, from 0 to 1 [-].

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
        super().__init__(V, bodies)
        self.part, self._share = part, inertia_share
        self._states: _Linearisation | None = None
        if not self.exists:
            return
        self._masses: Floats = np.array(masses)
        self._starts: Floats = self._fields.reference

    @property
    def has_unknowns(self) -> bool:
        """Whether guides leave a rigid body any free motion. Local."""
        return self.exists and bool(self._fields.freedom.free.any())

    @property
    def has_no_inertia(self) -> bool:
        """Whether only contact and loads resist free motions of rigid bodies. Local."""
        return self.has_unknowns and not self._share(self._masses).any()

    def begin(self, u_n: Floats) -> None:
        """Begin a step from displacements u_n [m]."""
        if self.exists:
            self._starts = self._fields.positions(*self._fields.sums(u_n))

    def balance(self, u: Floats, R: Floats) -> Floats:
        """Linearise at displacements u [m], and project the residual R [N] on rigid fields."""
        if not self.exists:
            return R
        of_u, forces = self._fields.sums(u, R)
        q, inertia = self._fields.positions(of_u), self._share(self._masses)
        freedom, products = self._fields.freedom, self._fields.products
        self._states = _Linearisation(
            freedom, products, self._starts, q, self.part, forces, inertia
        )
        return self._fields.put(self._states.project(np.zeros_like(forces), forces), R.copy())

    def project(self, x: Floats | None, y: Floats) -> Floats:
        """Project forces y on rigid motions, in place.

        If increments x [m] are given, y are the tangent forces due to x, and the change of the
        forces by rotation is added.
        """
        if self._states is None:
            return y
        x = np.zeros_like(y) if x is None else x
        return self._fields.put(self._states.project(*self._fields.sums(x, y)), y)

    def respond(self, r: Floats) -> Floats:
        """Replace forces r by the increments whose inertia balances them; overwrites r."""
        assert self._states is not None
        return self._fields.put(self._states.respond(*self._fields.sums(r)), r)

    def moved(self, u: Floats, du: Floats, prescribed: Floats | float = 0.0) -> Floats:
        """Displacements u [m] after increments du [m]; rigid bodies rotate without strain.

        Increments of rigid bodies are projected on the free motions at u. In the other motions they
        follow ``prescribed``, see `Guides.prescribed`.
        """
        result: Floats = u + du
        if not self.exists:
            return result
        of_u, increments = self._fields.sums(u, du)
        q = self._fields.positions(of_u)
        amplitudes = nearest(rigid_motions(q), self._fields.products, increments)
        # Small changes are added to u, as differences of positions would have more round-off.
        amplitudes = self._fields.freedom.project(amplitudes) + prescribed
        changes = turned(q, amplitudes)
        result[self.nodes] = (u + self._fields.put(changes, np.zeros_like(u)))[self.nodes]
        return result

    def nearest_free(self, values: Floats) -> Floats:
        """Project values at rigid bodies on the free motions at the start of the step."""
        if not self.exists:
            return values
        motions, sums = rigid_motions(self._starts), self._fields.sums(values)[0]
        gram = products_of(motions, self._fields.products, motions)
        amplitudes = self._fields.freedom.solved(gram, inner_products(motions, sums))
        return self._fields.put(combined(amplitudes, motions), values)

    def centripetal(self, v: Floats) -> Floats:
        """Acceleration at the start of the step for constant velocities v [m/s^2]."""
        spin = spins(
            nearest(rigid_motions(self._starts), self._fields.products, *self._fields.sums(v))
        )
        fields = self._starts @ (spin @ spin).transpose(0, 2, 1)
        fields[:, 0] = 0.0
        return self._fields.put(fields, np.zeros_like(v))

    def prescribed_displacement(self, u: Floats) -> Floats:
        """Prescribed part of the motion to u, to first order at the position of the forces [m]."""
        q_n, q, part = self._starts, self._fields.positions(*self._fields.sums(u)), self.part
        motions = rigid_motions((1 - part) * q_n + part * q)
        return self._fields.put(combined(self.guides.prescribed, motions), np.zeros_like(u))

    def remaining(self, u: Floats, part: float) -> Floats:
        """Remaining prescribed displacements from u after part of a step, to first order [m]."""
        increment = np.zeros_like(u)
        if not (self.exists and self.guides.are_moving):
            return increment
        motions = rigid_motions(self._fields.positions(*self._fields.sums(u)))
        return self._fields.put(combined(self.guides.remaining(part), motions), increment)

    def columns(self) -> list[RigidColumns]:
        """Free motions of each body in the unknowns of its nodes. Local."""
        columns, states = [], self._states
        assert states is not None
        for i, body in enumerate(self._bodies):
            k = len(body.free)
            dofs = (self.dim * body.nodes[:, None] + np.arange(self.dim, dtype=np.int32)).ravel()
            end, mean = (
                (body.values @ part[i, :k]).transpose(1, 2, 0).reshape(len(dofs), k)
                for part in (states.end, states.mean)
            )
            columns.append(RigidColumns(dofs, end, mean, states.turning[i, :k, :k]))
        return columns

    def without(self, values: Floats) -> Floats:
        """Copy of a vector with zeros at rigid bodies. Local."""
        copy = values.copy()
        copy[self.nodes] = 0.0
        return copy
