"""Vibration of bodies: their velocity without its rigid part, and the energy in it; recoil."""

from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.integrators.group_motions import GroupMotions
from dolfinx_nts.integrators.recoil import Recoil
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.redistributed_mass import RedistributedMass

__all__ = ["Vibration", "VibrationAnalysis"]

# Part of the energy of vibration that may be taken in a step, and how many times its own size
# may be added [-].
_MOST_TAKEN, _MOST_ADDED = 0.9, 3.0
# Velocities of unit vectors, the rows, in turns about each axis, by the dimension; in the plane
# about z.
_TURNS: dict[int, Floats] = {
    2: np.array([[[0.0, 1.0], [-1.0, 0.0]]]),
    3: np.cross(np.eye(3)[:, None], np.eye(3)).astype(np.float64),
}


class Vibration(NamedTuple):
    """Velocities w that are orthogonal to rigid motions with regard to the mass.

    The kinetic energy of a group less the work of moving supports changes by s b + s^2 a/2 if s w
    is added to the velocity.

    Attributes:
        w: Velocities of the owned nodes, shape ``(n, d)`` [m/s].
        held: Impulses of supports that it takes to add w, at the fixed dofs, as factors of the
            fields of `Recoil`, shape ``(g, 1 + d, d)`` [N s, N s/m].
        linear: The numbers b of the groups, shape ``(g,)`` [J].
        square: The numbers a of the groups, shape ``(g,)`` [J].
    """

    w: Floats
    held: Floats
    linear: Floats
    square: Floats

    @property
    def energy(self) -> Floats:
        """Most energy that can be taken from each group, shape ``(g,)`` [J]. Local."""
        safe = np.where(self.square > 0, self.square, 1.0)
        energy: Floats = np.where(self.square > 0, np.maximum(self.linear, 0) ** 2 / (2 * safe), 0)
        return energy

    def factors(self, wanted: Floats) -> tuple[Floats, Floats]:
        """Numbers s by which groups get energy, as far as that can be. Local.

        Args:
            wanted: Energy that each group should get, shape ``(g,)`` [J].

        Returns:
            The numbers, and the energy that the groups get [J].
        """
        energy = self.energy
        given = np.clip(wanted, -_MOST_TAKEN * energy, _MOST_ADDED * energy)
        root = np.sqrt(np.maximum(self.linear**2 + 2 * self.square * given, 0.0))
        sum_ = self.linear + root
        factors: Floats = np.divide(2 * given, sum_, out=np.zeros_like(sum_), where=sum_ > 0)
        return factors, given


class VibrationAnalysis:
    """Splits velocities into rigid motions of groups of bodies and their vibration. Collective.

    It also finds the rigid motions that groups have by impulses.

    Args:
        comm: Communicator.
        mass: The mass.
        groups: Owned nodes of each group of connected bodies.
        fixed: Owned scalar dofs with a support, which take no part.
        shape: Number of owned nodes, and of components d.
        possible: Which motions are rigid, see `possible_motions`.
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
        """Sum up the rows of the mass."""
        self._comm, self._mass, self._groups = comm, mass, groups
        d = shape[1]
        motions: Floats = np.zeros((len(possible), 1 + d, d))
        motions[:d, 0] = np.eye(d)
        motions[d:, 1:] = _TURNS[d]
        # As factors of the fields 1 and x.
        self._motions = motions[possible]
        self._m = mass.times(np.ones(shape))[:, :1]
        self._free: Floats = np.ones(shape)
        self._free.ravel()[fixed] = 0
        self._held = [[np.flatnonzero(free == 0) for free in self._free[g].T] for g in groups]

    def of(self, x: Floats, v: Floats, led: Floats, impulses: Floats) -> tuple[Vibration, Recoil]:
        """Split velocities, and find those that impulses give. Collective.

        Bodies vibrate about the rigid motion of their supports.

        Args:
            x: Positions of the owned nodes, shape ``(n, d)`` [m].
            v: Their velocities, shape ``(n, d)`` [m/s].
            led: Velocities at which supports do work, of all owned nodes, ``(n, d)`` [m/s].
            impulses: Sums of impulses, and of x times them, by the group whose nodes touch, then
                by that which gets them, shape ``(g, g, 1 + d, d)`` [N s, N s m].
        """
        d, num = v.shape[1], len(self._groups)
        momentum, Mx, led = self._mass.times(v), self._mass.times(x), (1 - self._free) * led
        first = np.array([[self._m[g].sum(), *Mx[g].sum(axis=0)] for g in self._groups])
        first = reductions.total(self._comm, first.reshape(-1, 1 + d))
        centres = first[:, 1:] / first[:, :1]
        fields, M_fields = [], []
        products = np.zeros((num, 1 + d, 1 + d + 2 * d + d * (1 + d)))
        for g, given, centre, product in zip(
            self._groups, self._held, centres, products, strict=True
        ):
            field = np.insert(x[g] - centre, 0, 1.0, axis=1)
            M_field = np.hstack([self._m[g], Mx[g] - self._m[g] * centre])
            at_supports = [field[nodes].T @ field[nodes] for nodes in given]
            some = field.T @ M_field, field.T @ momentum[g], field.T @ led[g]
            np.concatenate([*some, *at_supports], axis=1, out=product)
            fields.append(field)
            M_fields.append(M_field)
        products = reductions.total(self._comm, products)
        gram, of_momentum, lead, held = np.split(products, np.cumsum([1 + d, d, d]), axis=2)
        motions = [GroupMotions(self._motions, *some) for some in zip(gram, held, strict=True)]
        lead = np.concatenate(
            [some.at_supports(part[None]) for some, part in zip(motions, lead, strict=True)]
        )
        relative, w = np.zeros_like(v), np.zeros_like(v)
        for g, field, part in zip(self._groups, fields, lead, strict=True):
            relative[g] = v[g] - field @ part
            w[g] = self._free[g] * relative[g]
        Mw = self._mass.times(w)
        right = np.array([field.T @ Mw[g] for g, field in zip(self._groups, fields, strict=True)])
        right = reductions.total(self._comm, right.reshape(-1, 1 + d, d))
        sums, of_vibration = np.zeros((num, 2)), np.zeros_like(right)
        recoil, of_recoil = np.zeros_like(impulses), np.zeros_like(impulses)
        about = impulses.copy()
        about[:, :, 1:] -= centres[:, :, None] * impulses[:, :, :1]
        for i, (g, field, M_field) in enumerate(zip(self._groups, fields, M_fields, strict=True)):
            every = np.concatenate([right[i, None], about[:, i]])
            rigid, *recoil[:, i] = given = motions[i].by_impulses(every)
            # What supports give, so that the others have no more momentum than by impulses.
            missing = gram[i] @ given - every
            of_vibration[i], *of_recoil[:, i] = motions[i].at_supports(missing)
            w[g] -= field @ rigid
            M_vibration = Mw[g] - M_field @ rigid
            # Its product with the rigid part is round-off, and that with the motion of supports
            # is their work.
            sums[i] = np.vdot(relative[g] - field @ rigid, M_vibration), np.vdot(w[g], M_vibration)
        linear, square = reductions.total(self._comm, sums).T
        rows, M_rows = (a.reshape(num, -1) for a in (recoil, gram @ recoil))
        towards = rows @ (of_momentum - gram @ lead).ravel() + about.reshape(num, -1) @ lead.ravel()
        return (
            Vibration(w, -of_vibration, linear, square),
            Recoil(fields, recoil, of_recoil, towards, rows @ M_rows.T),
        )
