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
        self._comm, self._mass, self._shape = comm, mass, shape
        self._groups = [_contiguous(nodes) for nodes in groups]
        d = shape[1]
        motions: Floats = np.zeros((len(possible), 1 + d, d))
        motions[:d, 0] = np.eye(d)
        motions[d:, 1:] = _TURNS[d]
        # As factors of the fields 1 and x.
        self._motions = motions[possible]
        self._m = mass.times(np.ones(shape))[:, :1]
        held: Flags = np.zeros(shape, dtype=bool)
        held.ravel()[fixed] = True
        supported = [nodes[held[nodes].any(axis=1)] for nodes in groups]
        self._supports = [(nodes, held[nodes]) for nodes in supported]

    def of(self, x: Floats, v: Floats, led: Floats, impulses: Floats) -> tuple[Vibration, Recoil]:
        """Split velocities, and find those that impulses give. Collective.

        Bodies vibrate about the rigid motion that is nearest to that of their supports.

        Args:
            x: Positions of the owned nodes, shape ``(n, d)`` [m].
            v: Their velocities, shape ``(n, d)`` [m/s].
            led: Their mean velocities in the step, in which supports work, ``(n, d)`` [m/s].
            impulses: Sums of impulses, and of x times them, by the group whose nodes touch, then
                by that which gets them, shape ``(g, g, 1 + d, d)`` [N s, N s m].
        """
        d, num = v.shape[1], len(self._groups)
        field, M_field, about = self._about_centres(x, impulses)
        products = self._sums(field, np.hstack([M_field, self._mass.times(v)]), led)
        gram, of_momentum, of_led, held = np.split(products, np.cumsum([1 + d, d, d]), axis=2)
        motions = [GroupMotions(self._motions, gram[i], held[i]) for i in range(num)]
        lead = np.array([motions[i].at_supports(of_led[i, None])[0] for i in range(num)])
        w = v - self._at_nodes(field, lead)
        # Fixed dofs do not keep what they have relative to this motion.
        lost = [np.where(is_held, w[nodes], 0.0) for nodes, is_held in self._supports]
        for (nodes, _), values in zip(self._supports, lost, strict=True):
            w[nodes] -= values
        Mw = self._mass.times(w)
        every = np.concatenate([self._sums(field, Mw)[None], about])
        rigid, by_supports = np.zeros_like(every), np.zeros_like(every)
        for i in range(num):
            rigid[:, i] = motions[i].by_impulses(every[:, i])
            # Supports give what the impulses do not.
            missing = gram[i] @ rigid[:, i] - every[:, i]
            by_supports[:, i] = motions[i].at_supports(missing)
        w -= self._at_nodes(field, rigid[0])
        M_vibration = Mw - self._at_nodes(M_field, rigid[0])
        # The rigid part has no product with it but that of round-off, and the product with the
        # motion of supports is their work.
        energies = np.zeros((2, num))
        for i, (g, (nodes, _)) in enumerate(zip(self._groups, self._supports, strict=True)):
            energies[:, i] = np.vdot(w[g], M_vibration[g])
            energies[0, i] += np.vdot(lost[i], M_vibration[nodes])
        linear, square = reductions.total(self._comm, energies)
        recoil = rigid[1:]
        rows, M_rows = (a.reshape(num, -1) for a in (recoil, gram @ recoil))
        towards = rows @ (of_momentum - gram @ lead).ravel() + about.reshape(num, -1) @ lead.ravel()
        fields = [field[g] for g in self._groups]
        return (
            Vibration(w, -by_supports[0], linear, square),
            Recoil(fields, recoil, by_supports[1:], towards, rows @ M_rows.T),
        )

    def _about_centres(self, x: Floats, impulses: Floats) -> tuple[Floats, Floats, Floats]:
        """Fields 1 and x - centre, ``(n, 1 + d)``, their products with the mass, and impulses.

        The impulses and the moments are those with regard to these fields.
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

    def _sums(self, fields: Floats, values: Floats, led: Floats | None = None) -> Floats:
        """Products of fields, ``(n, k)``, and values, ``(n, m)``, by groups, ``(g, k, m)``.

        With velocities of supports, ``(n, d)``, also those of the fields at fixed dofs with these
        and with the fields, ``(g, k, m + d + d k)``.
        """
        sums = [fields[g].T @ values[g] for g in self._groups]
        if led is not None:
            for i, (nodes, is_held) in enumerate(self._supports):
                some = fields[nodes]
                each = (is_held[:, :, None] * some[:, None]).reshape(
                    len(some), is_held.shape[1] * some.shape[1]
                )
                sums[i] = np.hstack([sums[i], some.T @ np.hstack([is_held * led[nodes], each])])
        return reductions.total(self._comm, np.array(sums))

    def _at_nodes(self, fields: Floats, parts: Floats) -> Floats:
        """Fields, ``(n, 1 + d)``, times factors of each group, ``(g, 1 + d, d)``; ``(n, d)``."""
        values: Floats = np.empty(self._shape)
        for g, part in zip(self._groups, parts, strict=True):
            values[g] = fields[g] @ part
        return values


def _contiguous(nodes: Ints) -> Ints | slice:
    """The same sorted nodes, as a slice if none is missing between them, which is quicker."""
    if len(nodes) and nodes[-1] - nodes[0] + 1 == len(nodes):
        return slice(int(nodes[0]), int(nodes[-1]) + 1)
    return nodes
