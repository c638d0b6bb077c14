"""Stability of central differences: largest stable step, and check for spurious energy growth.

The estimate of the stable step is conservative: with lumped mass no frequency of an assembly
exceeds the highest frequency of its cells (Irons and Treharne 1971). For a cell of degree 1 this
frequency is computed from its uniform strains with the moduli at C = 1. For uniaxial motion it is
2 c/h with the P-wave speed c and the length h, otherwise more. For cells of degree 2 and
axisymmetric cells it is an eigenvalue. It scales as 1/h when cells deform. Contact springs are
added to it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import basix
import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.explicit.penalty import ContactSprings
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.fem.axisymmetry import is_on_axis
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.strain_energy import strain_basis
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.cell_moduli import CellModuli
from dolfinx_nts.model.lumped_mass import nodal_volumes
from dolfinx_nts.parallel import reductions

__all__ = [
    "Cells",
    "Damping",
    "Stability",
    "cell_frequency",
    "highest_frequency",
    "largest_step",
]

# Default step, and longest step with default springs, relative to the estimate [-]. The remainder
# is available for the frequency of springs.
_DEFAULT, _WITH_SPRINGS = 0.7, 0.9
# Growth of the energy, relative to the sum of initial energy and magnitudes of works [-], that
# indicates an instability: far above the bounded error of a stable run.
_GROWTH = 0.25
# Energy exchanged with springs that is not stored in them, relative to the same sum [-], above
# which there is a warning: far above the error of springs that keep their segments, 0.1 % in
# impacts of blocks.
_EXCHANGED = 0.05
# Largest energy of springs in a run relative to the largest strain energy [-] above which there is
# a warning, if supports or obstacles did at least this part of the work [-]: contact yields by that
# fraction of the deformation, and forces are too small by it. Impacts and weights are not reported,
# as their forces hardly depend on it.
_COMPLIANT, _PRESCRIBED = 0.1, 0.5
# Round-off of the energy at rest, relative to the kinetic energy at one cell per step [-].
_ROUNDING = 1e-20
# Least transit time of a wave through a cell [s] whose inverse square is finite.
_SHORTEST_TIME = 1e-150
# Numbers of cells of degree 1 and 2 whose matrices are computed together [-], to save memory.
_BLOCK, _MATRICES = 4096, 64


class Stability:
    """Stable step of an explicit stepper, and check of its energy.

    Collective, except where a method says otherwise. Positions ``x`` are of the local
    nodes, shape ``(l, 3)`` [m].

    Args:
        bodies: The bodies.
        springs: Springs of the contact pairs.
        mass: Mass of all bodies [kg].

    Attributes:
        limit: Largest stable step with the current springs [s].
        smallest: Length of the smallest cell at the last check [m].
    """

    def __init__(
        self, bodies: Sequence[Body], springs: Sequence[ContactSprings], mass: float
    ) -> None:
        self._cells, self._damping = Cells(bodies), Damping.of(bodies)
        self._springs, self._mass = springs, mass
        # Squared angular frequency of springs with a given stiffness [1/s^2]; and longest step
        # relative to the estimate [-].
        self._given_springs = self._contact()
        self._margin = _WITH_SPRINGS if any(each.lacks_penalty for each in springs) else 1.0
        self.limit, self.smallest = math.inf, 0.0
        # Initial energy, work since then, and sum of its magnitudes [J].
        self._energy = self._worked = self._turnover = 0.0
        # Energy that springs gave to the bodies without having stored it, and its last reported
        # value [J].
        self._exchanged = self._reported = 0.0
        # Work of supports and obstacles, largest energy of springs and largest strain energy [J].
        self._prescribed = self._stored = self._strain = 0.0
        self._has_reported_springs = self._have_materials_changed = False

    def serialize(self, archive: Archive) -> None:
        """Serialize the energies, the limit and the smallest cell."""
        names = ["_energy", "_worked", "_turnover", "limit", "smallest", "_exchanged", "_reported"]
        names += ["_prescribed", "_stored", "_strain"]
        totals = archive.same("watch", np.array([getattr(self, name) for name in names]))
        for name, total in zip(names, totals, strict=True):
            setattr(self, name, float(total))

    def longest_steps(self, x: Floats) -> tuple[float, float]:
        """Longest step that leaves a margin for default springs, and default step, at x [s].

        Neither depends on the default springs. Also sets `limit`.
        """
        bulk, self.smallest = self._cells.limits(x)
        estimate = largest_step(bulk + self._given_springs, self._damping)
        longest = self._margin * estimate
        is_chosen = not any(springs.lacks_penalty for springs in self._springs)
        present = bulk + self._contact()
        self.limit = largest_step(present, self._damping) if is_chosen else longest
        return longest, _DEFAULT * estimate

    def choose_penalties(self, x: Floats, dt: float) -> None:
        """Choose default springs, at most as stiff as dt [s] allows, and set `limit`."""
        bulk, _ = self._cells.limits(x)
        squared = (self._damping.highest(dt) - bulk - self._given_springs) / 2
        for springs in self._springs:
            springs.choose_penalty(squared)
        self.longest_steps(x)

    def start(self, energy: float) -> None:
        """Start the energy balance from a state with this energy [J]. Local."""
        self._energy, self._worked, self._turnover = energy, 0.0, 0.0
        self._exchanged = self._reported = 0.0
        self._prescribed = self._stored = self._strain = 0.0

    def count(
        self,
        driven: Sequence[float],
        damping: float,
        contact: ContactWork,
        *,
        stored: float = 0.0,
        strain: float = 0.0,
        changes: bool = False,
    ) -> None:
        """Count the work of a step. Local.

        Args:
            driven: Work of loads, supports and obstacles [J].
            damping: Work of damping, not positive [J].
            contact: Work of contact [J].
            stored: Energy of contact springs at its end [J].
            strain: Strain energy at its end [J].
            changes: Whether values in energies have changed.
        """
        self._have_materials_changed |= changes
        self._worked += sum(driven) + damping + contact.friction
        self._turnover += sum(map(abs, driven))
        self._prescribed += sum(map(abs, driven[1:]))
        self._stored, self._strain = max(self._stored, stored), max(self._strain, strain)
        self._exchanged += contact.persistent + contact.activation + contact.facet_change

    def exchanged(self, dt: float) -> float:
        """Energy that springs gave without having stored it [J]; 0 if not to be reported. Local.

        Args:
            dt: Length of the steps [s].
        """
        least = _EXCHANGED * (self._energy + self._turnover) + self._round_off(dt)
        if abs(self._exchanged) <= max(least, 2 * self._reported):
            return 0.0
        self._reported = abs(self._exchanged)
        return self._exchanged

    def compliance(self) -> float:
        """Largest energy of springs relative to the strain energy [-]. Local.

        It is 0 if it is irrelevant or was reported.
        """
        ratio = self._stored / self._strain if self._strain > 0 else 0.0
        driven = self._prescribed >= _PRESCRIBED * (self._stored + self._strain)
        if self._has_reported_springs or ratio <= _COMPLIANT or not driven:
            return 0.0
        self._has_reported_springs = True
        return ratio

    def growth(self, energy: float, dt: float) -> str:
        """Message if the energy [J] of a run with steps dt [s] has grown, otherwise "". Local."""
        if self._have_materials_changed:
            # A change of material data, such as swelling, changes the energy.
            self.start(energy)
            self._have_materials_changed = False
            return ""
        grown = energy - self._energy - self._worked
        if grown <= _GROWTH * (self._energy + self._turnover) + self._round_off(dt):
            return ""
        return f"the energy has grown by {grown:.3g} J"

    def _round_off(self, dt: float) -> float:
        """Energy of round-off at rest [J]."""
        return _ROUNDING * self._mass * (self.smallest / dt) ** 2

    def _contact(self) -> float:
        """Highest squared angular frequency of the current springs [1/s^2]."""
        return max((springs.squared_frequency for springs in self._springs), default=0.0)


class Cells:
    """Highest frequency and smallest length of all cells.

    The length of a cell is twice the least radius of gyration of its nodes: the edge length for a
    cube of degree 1 (`cpp/nts/geometry/cell_length.h`).

    Args:
        bodies: The bodies, of one space.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        V = bodies[0].V
        self._comm, self._dim = V.mesh.comm, dimension(V)
        X, element = reference_positions(V), Element.of(V)
        nodes, k = V.dofmap.list, element.pieces.shape[1]
        cells = {
            material: np.concatenate([b.cells for b in bodies if b.material is material])
            for material in dict.fromkeys(body.material for body in bodies)
        }
        self._nodes = np.concatenate([nodes[part] for part in cells.values()])
        squared: list[Floats] = [np.empty(0)]
        for material, part in cells.items():
            for block, moduli in CellModuli(V, material).blocks(part):
                x = X[nodes[block, :k], : self._dim]
                # Axisymmetric cells have hoop strains in addition to those in the plane.
                if element.degree == 1 and not element.is_axisymmetric:
                    squared.append(cell_frequency(material, x, moduli))
                else:
                    at = is_on_axis(V.mesh, X[nodes[block]])
                    squared.append(highest_frequency(material, element, x, at, moduli))
        self._speed = np.sqrt(np.concatenate(squared)) * self._lengths(X) / 2

    def limits(self, x: Floats) -> tuple[float, float]:
        """Highest squared frequency [1/s^2] and least length [m] at positions x. Collective."""
        length = self._lengths(x)
        # In cells of rigid bodies the wave speed is set to 0.
        deforms = self._speed > 0
        times = np.divide(length, self._speed, out=np.full_like(length, np.inf), where=deforms)
        time = float(times.min(initial=np.inf))
        limits = [time, float(length[deforms].min(initial=np.inf))]
        least, shortest = reductions.least(self._comm, limits)
        return (2 / least) ** 2 if least > _SHORTEST_TIME else math.inf, shortest

    def _lengths(self, x: Floats) -> Floats:
        """Lengths of all cells at positions ``(l, 3)``, shape ``(c,)`` [m]."""
        return _kernels.cell_lengths(x[:, : self._dim], self._nodes)


@dataclass(frozen=True)
class Damping:
    """Largest Rayleigh damping coefficients of several bodies, which limit the step.

    Attributes:
        mass: Coefficient alpha [1/s].
        stiffness: Coefficient beta [s].
    """

    mass: float
    stiffness: float

    @classmethod
    def of(cls, bodies: Sequence[Body]) -> "Damping":
        """Largest coefficients of the bodies' materials."""
        laws = [body.material for body in bodies]
        return cls(max(m.mass_damping for m in laws), max(m.stiffness_damping for m in laws))

    def highest(self, dt: float) -> float:
        """Squared undamped frequency for which dt [s] is the critical step [1/s^2]."""
        return (1 - dt * self.mass / 2) / (dt**2 / 4 + dt * self.stiffness / 2)


def cell_frequency(material: Hyperelastic, x: Floats, moduli: Floats | None = None) -> Floats:
    r"""Highest squared frequency of the uniform strains of cells of degree 1. Local.

    For displacements u = H r of the vertices and lumped mass it is the maximum of
    :math:`H : D : H / (\rho_0\, H : H G)` with the moduli D at C = 1 and
    :math:`G = \sum_a r_a \otimes r_a / k`.

    Args:
        material: Material of the cells.
        x: Vertices in the reference configuration, shape ``(c, k, 3)``, in the plane
            ``(c, k, 2)`` [m].
        moduli: Moduli at p points of the cells, of which the highest frequency counts, shape
            ``(c, p, 6, 6)`` [Pa]; None: those of a material without fields.

    Returns:
        Squared frequencies, shape ``(c,)`` [1/s^2].
    """
    d, D = x.shape[2], _moduli_or_default(moduli, material, len(x))
    basis = strain_basis()[:, :d, :d]  # plane strain in two dimensions
    squared: Floats = np.empty(len(x))
    for block in np.split(np.arange(len(x)), range(_BLOCK, len(x), _BLOCK)):
        values, axes = np.linalg.eigh(_moments(x[block]))
        S = axes / np.sqrt(values)[:, None, :]
        strain = np.einsum("sij,cjk->csik", basis, S).reshape(-1, 1, 6, d * d)
        K = strain.swapaxes(2, 3) @ (D[block] @ strain)
        squared[block] = np.linalg.eigvalsh(K)[..., -1].max(axis=1) / material.rho
    return squared


def highest_frequency(
    material: Hyperelastic,
    element: Element,
    x: Floats,
    on_axis: Flags,
    moduli: Floats | None = None,
) -> Floats:
    """Highest squared frequency of cells of any degree, with the moduli at C = 1. Local.

    Args:
        material: Material of the cells.
        element: Their element.
        x: Vertices in the reference configuration, shape ``(c, k, 3)``, in the plane
            ``(c, k, 2)`` [m].
        on_axis: Nodes on the axis of an axisymmetric mesh, shape ``(c, n)``.
        moduli: As for `cell_frequency`.

    Returns:
        Squared frequencies, shape ``(c,)`` [1/s^2].
    """
    d, D = x.shape[2], _moduli_or_default(moduli, material, len(x))
    basis = strain_basis()  # plane strain in two dimensions
    points, weights = basix.make_quadrature(basix.CellType[element.cell], element.stress_degree)
    values, *slopes = element.basix.tabulate(1, points)[..., 0]
    shape, *linear = Element(element.cell, 1).basix.tabulate(1, points)[..., 0]
    squared: Floats = np.empty(len(x))
    for block in np.split(np.arange(len(x)), range(_MATRICES, len(x), _MATRICES)):
        J = np.einsum("jqv,cvi->cqij", np.array(linear), x[block])
        gradient = np.einsum("jqa,cqji->cqai", np.array(slopes), np.linalg.inv(J))
        volume = np.abs(np.linalg.det(J)) * weights
        scale = 1 / np.sqrt(material.rho * nodal_volumes(element, x[block]))
        strain = np.einsum("sij,cqaj->cqsai", basis[:, :d, :d], gradient)
        if element.is_axisymmetric:
            r = x[block, :, 0] @ shape.T
            volume *= 2 * np.pi * r
            strain[..., 0] += basis[:, 2, 2, None] * (values / r[:, :, None])[:, :, None]
            strain[..., 0] *= ~on_axis[block][:, None, None]
        strain *= np.sqrt(volume)[:, :, None, None, None] * scale[:, None, None, :, None]
        # The shape is explicit, since -1 is ambiguous on ranks without such cells.
        size = strain.shape[3] * strain.shape[4]
        strain = strain.reshape(*volume.shape, 6, size)
        rows = len(block), 6 * len(weights), size
        transposed, highest = strain.reshape(rows).swapaxes(1, 2), []
        for i in range(D.shape[1]):
            stress = D[block, None, i] @ strain
            highest.append(np.linalg.eigvalsh(transposed @ stress.reshape(rows))[:, -1])
        squared[block] = np.max(highest, axis=0)
    return squared


def largest_step(squared: float, damping: Damping) -> float:
    r"""Largest stable step [s] for the highest squared frequency without damping [1/s^2]. Local.

    It solves :math:`\omega^2 \Delta t^2/4 + (\alpha + \beta \omega^2) \Delta t/2 = 1`, because
    damping uses the velocity half a step earlier. It is 0 for an infinite frequency, and infinite
    if frequency and damping vanish.
    """
    if math.isinf(squared):
        return 0.0
    c = (damping.mass + damping.stiffness * squared) / 2
    if c == squared == 0:
        return math.inf
    return float(2 / (c + np.sqrt(c**2 + squared)))


def _moments(x: Floats) -> Floats:
    """Second moments of the vertices about their centre, ``(c, d, d)`` [m^2]."""
    r = x - x.mean(axis=1, keepdims=True)
    moments: Floats = r.transpose(0, 2, 1) @ r / x.shape[1]
    return moments


def _moduli_or_default(moduli: Floats | None, material: Hyperelastic, n: int) -> Floats:
    """Given moduli, or those of a material in n cells with one point each, see `cell_frequency`."""
    return np.broadcast_to(material.moduli, (n, 1, 6, 6)) if moduli is None else moduli
