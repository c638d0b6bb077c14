"""Energy correction after the static solve of massless nodes.

Groups of connected bodies exchange energy through their vibration, the velocity without its rigid
part, and through rigid motions due to the contact impulses of the step.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.massless.redistributed_mass import RedistributedMass

__all__ = ["EnergyCorrection", "GroupMotions", "RigidCorrection", "Vibration", "VibrationAnalysis"]

# Largest fraction of the vibration energy that a step removes, and largest multiple of it that a
# step adds [-].
_MOST_TAKEN, _MOST_ADDED = 0.9, 3.0
# Velocity gradients of unit rotations about each axis (in the plane about z), by dimension.
_TURNS: dict[int, Floats] = {
    2: np.array([[[0.0, 1.0], [-1.0, 0.0]]]),
    3: np.cross(np.eye(3)[:, None], np.eye(3)).astype(np.float64),
}

# Mean square of a rigid motion at supports, relative to the largest one [-], that counts as zero.
_NO_MOTION = 1e-12

# Relative error of the exchanged energy [-] that counts as round-off.
_ROUND_OFF = 1e-12


class RigidCorrection(NamedTuple):
    r"""Rigid velocities :math:`d_i` of groups of bodies due to their contact impulses.

    The impulses of action and reaction have no resultant, so that no multiple of them changes the
    momenta. Adding :math:`\sum \alpha_i d_i` changes the kinetic energy, minus the work of moving
    supports and obstacles, by :math:`\alpha \cdot b + \alpha \cdot a \alpha / 2`.

    Attributes:
        fields: Values of 1 and x - centre at the owned nodes of each group, ``(n, 1 + d)``.
        rigid: Coefficients of these fields, by the group whose nodes touch, then by the group
            that moves, shape ``(g, g, 1 + d, d)``.
        support_impulses: Impulses of supports at the fixed dofs in these motions, same shape.
        linear: Vector b of this change, shape ``(g,)`` [J].
        square: Matrix a, shape ``(g, g)`` [J].
    """

    fields: Sequence[Floats]
    rigid: Floats
    support_impulses: Floats
    linear: Floats
    square: Floats

    @property
    def energy(self) -> Floats:
        """Energy of the relative rigid motion of touching groups, shape ``(g,)`` [J]. Local."""
        a = np.diag(self.square)
        energy: Floats = np.divide(self.linear**2, 2 * a, out=np.zeros_like(a), where=a > 0)
        return energy

    @property
    def most(self) -> Floats:
        """Largest energy change for factors from -1 to 1, shape ``(g,)`` [J]. Local."""
        most: Floats = np.abs(self.linear) + np.diag(self.square) / 2
        return most

    def factors(self, wanted: Floats) -> tuple[Floats, Floats]:
        """Factors in [-1, 1] that change the energy of groups without tensile contact. Local.

        Args:
            wanted: Energy that each group should receive, shape ``(g,)`` [J].

        Returns:
            The factors, and the energy that the groups receive [J], both ``(g,)``.
        """
        factors, given = np.zeros_like(wanted), np.zeros_like(wanted)
        for i, a in enumerate(np.diag(self.square)):
            if not a > 0:
                continue
            b = self.linear[i] + self.square[i] @ factors
            size = abs(b)
            least = size - a / 2 if size > a else size**2 / (2 * a)
            given[i] = np.clip(wanted[i], -least, size + a / 2)
            root = np.sqrt(max(size**2 + 2 * a * given[i], 0.0))
            if size + root > 0:
                factors[i] = np.copysign(2 * given[i] / (size + root), b * given[i])
        return factors, given

    def velocities(self, factors: Floats) -> list[Floats]:
        """Nodal velocities of each group, ``(n, d)`` [m/s], for factors alpha, ``(g,)``. Local."""
        return self.at_nodes(np.einsum("i,igcd->gcd", factors, self.rigid))

    def at_nodes(self, parts: Floats) -> list[Floats]:
        """Nodal values of each group, ``(n, d)``, for coefficients ``(g, 1 + d, d)``. Local."""
        return [field @ part for field, part in zip(self.fields, parts, strict=True)]


class GroupMotions:
    """Rigid motions of a group, split into free ones and those prescribed by supports.

    A motion is given by coefficients of the fields 1 and x - centre, ``(1 + d, d)``. Local, as are
    all methods.

    Args:
        motions: Basis of the rigid motions, shape ``(k, 1 + d, d)``.
        gram: Mass products of the fields, shape ``(1 + d, 1 + d)``.
        at_supports: Products of the fields over the supported nodes, direction by direction,
            shape ``(1 + d, d (1 + d))``.
    """

    def __init__(self, motions: Floats, gram: Floats, at_supports: Floats) -> None:
        _, fields, d = motions.shape
        self._shape = fields, d
        self._basis = basis = motions.reshape(len(motions), -1)
        held = np.einsum("aib,kbi->kai", at_supports.reshape(fields, d, fields), motions)
        products = basis @ (gram @ motions).reshape(basis.shape).T
        weights = basis @ held.reshape(basis.shape).T
        size = np.sqrt(np.diag(products))
        scale = 1 / np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(weights * scale * scale[:, None])
        vectors *= scale[:, None]
        stays = values <= _NO_MOTION * max(values[-1], 0.0)
        self._free, self._supported = (
            vectors[:, stays],
            vectors[:, ~stays] / np.sqrt(values[~stays]),
        )
        self._inertia = self._free.T @ products @ self._free

    def by_impulses(self, impulses: Floats) -> Floats:
        """Free motions due to impulses, given by their products with the fields.

        Impulses and motions have the shape ``(r, 1 + d, d)``.
        """
        right = self._free.T @ self._basis_products(impulses)
        return self._motions(self._free @ np.linalg.lstsq(self._inertia, right, rcond=None)[0])

    def at_supports(self, products: Floats) -> Floats:
        """Motions given by products with the fields over supported nodes, ``(r, 1 + d, d)``.

        For velocities of supports this is the nearest motion in the least-squares sense. For
        impulses it gives the smallest reactions with their resultant and moment.
        """
        return self._motions(self._supported @ (self._supported.T @ self._basis_products(products)))

    def _basis_products(self, products: Floats) -> Floats:
        """Products with each basis motion, shape ``(k, r)``."""
        of_basis: Floats = self._basis @ products.reshape(len(products), -1).T
        return of_basis

    def _motions(self, coefficients: Floats) -> Floats:
        """Linear combinations of the basis motions with coefficients ``(k, r)``."""
        return (coefficients.T @ self._basis).reshape(-1, *self._shape)


class Vibration(NamedTuple):
    """Velocities w that are orthogonal to rigid motions in the mass product.

    Adding s w to the velocity changes the kinetic energy of a group, minus the work of moving
    supports, by s b + s^2 a/2.

    Attributes:
        w: Velocities of the owned nodes, shape ``(n, d)`` [m/s].
        support_impulses: Impulses of supports at the fixed dofs when w is added, as coefficients of
            the fields of `RigidCorrection`, shape ``(g, 1 + d, d)`` [N s, N s/m].
        linear: Coefficient b of each group, shape ``(g,)`` [J].
        square: Coefficient a of each group, shape ``(g,)`` [J].
    """

    w: Floats
    support_impulses: Floats
    linear: Floats
    square: Floats

    @property
    def energy(self) -> Floats:
        """Largest energy that each group can lose, shape ``(g,)`` [J]. Local."""
        safe = np.where(self.square > 0, self.square, 1.0)
        energy: Floats = np.where(self.square > 0, np.maximum(self.linear, 0) ** 2 / (2 * safe), 0)
        return energy

    def factors(self, wanted: Floats) -> tuple[Floats, Floats]:
        """Factors s that change the energy of groups, within bounds. Local.

        Args:
            wanted: Energy that each group should receive, shape ``(g,)`` [J].

        Returns:
            The factors, and the energy that the groups receive [J], both ``(g,)``.
        """
        energy = self.energy
        given = np.clip(wanted, -_MOST_TAKEN * energy, _MOST_ADDED * energy)
        root = np.sqrt(np.maximum(self.linear**2 + 2 * self.square * given, 0.0))
        sum_ = self.linear + root
        factors: Floats = np.divide(2 * given, sum_, out=np.zeros_like(sum_), where=sum_ > 0)
        return factors, given


class VibrationAnalysis:
    """Splits velocities of groups of bodies into rigid motion and vibration. Collective.

    Also computes the rigid velocities of groups due to contact impulses.

    Args:
        comm: Communicator.
        mass: Mass matrix of the bodies.
        groups: Owned nodes of each group of connected bodies.
        fixed: Owned scalar dofs with a support, which are left out.
        shape: Number of owned nodes, and of components d.
        possible: Flags of the admissible rigid motions, see `possible_motions`.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        mass: RedistributedMass,
        groups: list[Ints],
        fixed: Ints,
        shape: tuple[int, int],
        possible: Flags,
    ) -> None:
        self._comm, self._mass, self._shape = comm, mass, shape
        self._groups = [_contiguous(nodes) for nodes in groups]
        d = shape[1]
        motions: Floats = np.zeros((len(possible), 1 + d, d))
        motions[:d, 0] = np.eye(d)
        motions[d:, 1:] = _TURNS[d]
        # Rigid motions as coefficients of the fields 1 and x.
        self._motions = motions[possible]
        self._m = mass.times(np.ones(shape))[:, :1]
        held: Flags = np.zeros(shape, dtype=bool)
        held.ravel()[fixed] = True
        supported = [nodes[held[nodes].any(axis=1)] for nodes in groups]
        self._supports = [(nodes, held[nodes]) for nodes in supported]

    def of(
        self, x: Floats, v: Floats, v_support: Floats, impulses: Floats
    ) -> tuple[Vibration, RigidCorrection]:
        """Split velocities, and compute rigid velocities due to impulses. Collective.

        Vibration is relative to the rigid motion nearest to the motion of the supports.

        Args:
            x: Positions of the owned nodes, shape ``(n, d)`` [m].
            v: Their velocities, shape ``(n, d)`` [m/s].
            v_support: Their mean velocities in the step, used for the work of supports, shape
                ``(n, d)`` [m/s].
            impulses: Sums of impulses and of x times impulses, by the group whose nodes touch,
                then by the group on which they act, ``(g, g, 1 + d, d)`` [N s, N s m].
        """
        d, num = v.shape[1], len(self._groups)
        field, M_field, about = self._about_centres(x, impulses)
        products = self._sums(field, np.hstack([M_field, self._mass.times(v)]), v_support)
        gram, of_momentum, of_supports, held = np.split(products, np.cumsum([1 + d, d, d]), axis=2)
        motions = [GroupMotions(self._motions, gram[i], held[i]) for i in range(num)]
        support_motion = np.array(
            [motions[i].at_supports(of_supports[i, None])[0] for i in range(num)]
        )
        w = v - self._at_nodes(field, support_motion)
        # Fixed dofs have no velocity relative to this motion.
        lost = [np.where(is_held, w[nodes], 0.0) for nodes, is_held in self._supports]
        for (nodes, _), values in zip(self._supports, lost, strict=True):
            w[nodes] -= values
        Mw = self._mass.times(w)
        every = np.concatenate([self._sums(field, Mw)[None], about])
        rigid, by_supports = np.zeros_like(every), np.zeros_like(every)
        for i in range(num):
            rigid[:, i] = motions[i].by_impulses(every[:, i])
            # Supports provide the missing impulses.
            missing = gram[i] @ rigid[:, i] - every[:, i]
            by_supports[:, i] = motions[i].at_supports(missing)
        w -= self._at_nodes(field, rigid[0])
        M_vibration = Mw - self._at_nodes(M_field, rigid[0])
        # The product of w with the rigid part is round-off; with the motion of supports it is their
        # work.
        energies = np.zeros((2, num))
        for i, (g, (nodes, _)) in enumerate(zip(self._groups, self._supports, strict=True)):
            energies[:, i] = np.vdot(w[g], M_vibration[g])
            energies[0, i] += np.vdot(lost[i], M_vibration[nodes])
        linear, square = reductions.total(self._comm, energies)
        rigid_correction = rigid[1:]
        rows, M_rows = (a.reshape(num, -1) for a in (rigid_correction, gram @ rigid_correction))
        towards = (
            rows @ (of_momentum - gram @ support_motion).ravel()
            + about.reshape(num, -1) @ support_motion.ravel()
        )
        fields = [field[g] for g in self._groups]
        return (
            Vibration(w, -by_supports[0], linear, square),
            RigidCorrection(fields, rigid_correction, by_supports[1:], towards, rows @ M_rows.T),
        )

    def _about_centres(self, x: Floats, impulses: Floats) -> tuple[Floats, Floats, Floats]:
        """Fields 1 and x - centre, ``(n, 1 + d)``, mass times fields, and impulses.

        Moments of impulses are about the centres of mass.
        """
        fields = np.insert(x, 0, 1.0, axis=1)
        M_fields = np.hstack([self._m, self._mass.times(x)])
        first = self._sums(np.ones((len(x), 1)), M_fields)[:, 0]
        about = impulses.copy()
        for i, g in enumerate(self._groups):
            centre = first[i, 1:] / first[i, 0]
            fields[g, 1:] -= centre
            M_fields[g, 1:] -= self._m[g] * centre
            about[:, i, 1:] -= centre[:, None] * impulses[:, i, :1]
        return fields, M_fields, about

    def _sums(self, fields: Floats, values: Floats, v_support: Floats | None = None) -> Floats:
        """Products of fields, ``(n, k)``, and values, ``(n, m)``, by group, ``(g, k, m)``.

        With velocities of supports, ``(n, d)``, products over the fixed dofs of the fields with
        these velocities and with the fields are appended, ``(g, k, m + d + d k)``.
        """
        sums = [fields[g].T @ values[g] for g in self._groups]
        if v_support is not None:
            for i, (nodes, is_held) in enumerate(self._supports):
                some = fields[nodes]
                each = (is_held[:, :, None] * some[:, None]).reshape(
                    len(some), is_held.shape[1] * some.shape[1]
                )
                sums[i] = np.hstack(
                    [sums[i], some.T @ np.hstack([is_held * v_support[nodes], each])]
                )
        return reductions.total(self._comm, np.array(sums))

    def _at_nodes(self, fields: Floats, parts: Floats) -> Floats:
        """Nodal values, ``(n, d)``, for coefficients of each group, ``(g, 1 + d, d)``."""
        values: Floats = np.empty(self._shape)
        for g, part in zip(self._groups, parts, strict=True):
            values[g] = fields[g] @ part
        return values


class EnergyCorrection(NamedTuple):
    """Energy correction of groups, by changes of rigid motion and vibration.

    Attributes:
        wanted: Energy that each group should receive, shape ``(g,)`` [J].
        received: Energy that each group receives, within its bounds, shape ``(g,)`` [J].
        rigid_factors: Factors of the velocities of `RigidCorrection`, shape ``(g,)`` [-].
        factors: Factors of the velocities of `Vibration`, shape ``(g,)`` [-].
    """

    wanted: Floats
    received: Floats
    rigid_factors: Floats
    factors: Floats

    @classmethod
    def of(
        cls, vibration: Vibration, rigid_correction: RigidCorrection, wanted: Floats
    ) -> "EnergyCorrection":
        """Distribute the energy in proportion to rigid motion and vibration. Local."""
        whole = vibration.energy + rigid_correction.energy
        share = np.divide(rigid_correction.energy, whole, out=np.zeros_like(whole), where=whole > 0)
        rigid_factors, by_rigid = rigid_correction.factors(share * wanted)
        factors, by_vibration = vibration.factors(wanted - by_rigid)
        return cls(wanted, by_rigid + by_vibration, rigid_factors, factors)

    @property
    def is_whole(self) -> Flags:
        """Whether each group receives all of the wanted energy, shape ``(g,)``."""
        whole: Flags = np.abs(self.wanted - self.received) <= _ROUND_OFF * np.abs(self.wanted)
        return whole


def _contiguous(nodes: Ints) -> Ints | slice:
    """Sorted nodes, as a slice if they are contiguous, which is faster."""
    if len(nodes) and nodes[-1] - nodes[0] + 1 == len(nodes):
        return slice(int(nodes[0]), int(nodes[-1]) + 1)
    return nodes
