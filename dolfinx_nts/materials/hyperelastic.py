r"""Hyperelastic materials: strain energy psi(C), its stress, and a conserving stress.

Everything is UFL. ``C`` is the right Cauchy-Green tensor and ``psi`` the strain energy per
reference volume; bodies turn both into forms. The numbers of a material reach the forms as
constants, so that nothing is compiled again when one changes. Materials that have a name are in
`library`.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial
from itertools import combinations_with_replacement
from types import MappingProxyType
from typing import Any

import numpy as np
import ufl
from ufl.domain import extract_domains

from dolfinx_nts.common.arguments import as_call, finite, positive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.materials.energy_curve import GENERIC_STRAIN, EnergyCurve

__all__ = ["Hyperelastic", "MassOnly", "PartOfEnergy", "poisson_ratio", "right_cauchy_green"]

# Gauss points and weights [-] of the average over [0, 1]: three are exact to degree 5.
_POINTS = 0.5 + 0.5 * np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18
# |dC| [-] above which the average misses the energy by more than round-off and is
# corrected; below it the correction would be round-off divided by |dC|.
_SMALL_STRAIN_INCREMENT = 1e-2
# Size of a strain [-] at which an energy is compared with the sum of its parts: so large that
# terms of every order count.
_LARGE_STRAIN = 0.1
# Relative errors [-] of energies, and of eigenvalues of moduli, that are round-off.
_ROUND_OFF = 1e-10
# Stress that should vanish, relative to the moduli [-], that comes from rounded parameters.
_NO_STRESS = 1e-6
# Poisson's ratios of small strains [-], rounded, from which on hexahedra lock enough to matter;
# and at which nothing but volume has energy.
_LOCKS, _FLUID = 0.3 - 1e-9, 0.5 - 1e-9
# Energies at C = s 1 with these s [-] tell whether a material resists collapse: from one to the
# other a logarithm of the volume doubles, a bounded energy hardly changes.
_COLLAPSED, _GROWTH = (1e-8, 1e-4), 1.5


def right_cauchy_green(F: Any) -> Any:
    """C = F^T F of a deformation gradient F, both UFL (3, 3)."""
    return F.T * F


class Hyperelastic(Declaration):
    r"""A material given by its strain energy. Local.

    Damping, if any, is Rayleigh damping: a force :math:`-\alpha \rho_0 v` per reference volume,
    and a stress :math:`S = \beta\, 4 \psi''(1) : \dot E` with the moduli of the undeformed
    material. The force also slows rigid motion, the stress does not.

    Args:
        psi: Strain energy density ``psi(C, **parameters)`` [J/m^3] of the right Cauchy-Green
            tensor, a UFL scalar, twice differentiable.
        rho: Reference density [kg/m^3].
        mass_damping: Coefficient alpha [1/s].
        stiffness_damping: Coefficient beta [s].
        one_point: What has one point a cell, with the mean deformation gradient of the cell.
            ``"volumetric"``: what resists a change of volume, in hexahedra and quadrilaterals of
            degree 1, which then do not lock in nearly incompressible materials; this is the
            default from a Poisson's ratio of 0.3 on, but for energies with fields, or with fibres
            that resist an equal change of volume. Or names of parameters whose terms of ``psi``,
            in which it must be linear, have one point; ``()`` for none, as in the paper. Energy is
            conserved with every choice, because every point has an energy and a conserving stress
            of its own.
        **parameters: Numbers that ``psi`` takes by keyword.

    Attributes:
        rho, mass_damping, stiffness_damping: As given.
        one_point: Names as given, a frozen set, or those of the volumetric terms.
        splits_volume: Whether ``"volumetric"`` was given or is the default. Without names the
            energy of an equal change of volume, psi(J^(2/3) 1), has one point.
        parameters: Numbers by name, read-only.

    Raises:
        TypeError: ``psi`` cannot be called.
        ValueError: A number is not finite or has the wrong sign; ``psi`` is no scalar, or not
            twice differentiable at C = 1, where energies without fields are evaluated, or has a
            stress there; stiffness damping would add energy, as the moduli at C = 1 have a
            negative eigenvalue; ``one_point`` names no parameter or all of them, or ``psi`` is
            not the sum of both parts, or under an equal change of volume has a stress that is
            no pressure where ``"volumetric"`` is given.

    Example:
        >>> def psi(C, mu, kappa):
        ...     J2 = ufl.det(C)
        ...     return mu / 2 * (ufl.tr(C) - 3 - ufl.ln(J2)) + kappa / 8 * ufl.ln(J2) ** 2
        >>> nts.Hyperelastic(psi, rho=1.0e3, mu=3.0e4, kappa=1.0e5)  # kg/m^3, Pa
        Hyperelastic(psi=psi, mu=30000, kappa=100000, rho=1000)
    """

    def __init__(
        self,
        psi: Callable[..., Any],
        *,
        rho: float,
        mass_damping: float = 0.0,
        stiffness_damping: float = 0.0,
        one_point: str | Sequence[str] | None = None,
        **parameters: float,
    ) -> None:
        """Check the numbers and the energy."""
        if not callable(psi):
            raise TypeError(f"expected a function psi(C), given {type(psi).__name__}")
        damping = {"mass_damping": mass_damping, "stiffness_damping": stiffness_damping}
        for name, value in {"rho": rho, **damping, **parameters}.items():
            finite(name, value)
        positive("a density rho", rho)
        for name, value in damping.items():
            if value < 0:
                raise ValueError(f"expected {name} >= 0, given {value}")
        self.rho = float(rho)
        self.mass_damping, self.stiffness_damping = float(mass_damping), float(stiffness_damping)
        numbers = {name: float(value) for name, value in parameters.items()}
        self.parameters = MappingProxyType(numbers)
        self._psi = psi
        self._check_energy()
        self._has_default = one_point is None
        self.splits_volume, self.one_point = self._rule(one_point)
        if self.one_point and not self.one_point < parameters.keys():
            raise ValueError(
                f"expected one_point 'volumetric', or out of {sorted(parameters)} but not all, "
                f"given {one_point!r}"
            )
        self._check_parts()

    def __repr__(self) -> str:
        """Numbers in SI units, and the options that are set, in one line. Local."""
        names = tuple(sorted(self.one_point))
        damping = {"mass_damping": self.mass_damping, "stiffness_damping": self.stiffness_damping}
        options: dict[str, Any] = {name: value for name, value in damping.items() if value}
        if not self._has_default:
            options["one_point"] = "volumetric" if self.splits_volume else names
        return as_call(self, **self._described(), rho=self.rho, **options)

    def _described(self) -> dict[str, Any]:
        """Arguments that ``repr`` tells of the energy, by name."""
        return {"psi": self._psi, **self.parameters}

    @property
    def is_damped(self) -> bool:
        """Whether the material has damping of either kind."""
        return self.mass_damping > 0 or self.stiffness_damping > 0

    def psi(self, C: Any, **parameters: Any) -> Any:
        """Strain energy per reference volume.

        Args:
            C: Right Cauchy-Green tensor, UFL (3, 3).
            **parameters: Values of parameters of the energy, by name; others have their own.

        Returns:
            Energy [J/m^3], a UFL scalar.
        """
        return self._psi(C, **self.parameters | parameters)

    def stress(self, C: Any, **parameters: Any) -> Any:
        """Second Piola-Kirchhoff stress S = 2 d psi/d C.

        Args:
            C: Right Cauchy-Green tensor, UFL (3, 3).
            **parameters: Values of parameters of the energy, by name; others have their own.

        Returns:
            Stress [Pa], UFL (3, 3).
        """
        C = ufl.variable(C)
        # UFL's derivative is not symmetric if psi names entries of C.
        return 2 * ufl.sym(ufl.diff(self.psi(C, **parameters), C))

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        r"""Stress whose work in a step is exactly the change of the strain energy.

        :math:`S : (C_{n+1} - C_n)/2 = \psi_{n+1} - \psi_n`. It is the average of the stress on
        the straight path between the states, by three Gauss points. The correction along dC of
        Gonzalez (2000) is added where dC is so large that the average needs it; there is no 0/0
        where C does not change.

        Args:
            C_n: Right Cauchy-Green tensor at t_n, UFL (3, 3).
            C: The same at t_{n+1}.
            **parameters: Values of parameters of the energy, by name; others have their own.

        Returns:
            Stress [Pa], UFL (3, 3).
        """
        dC = C - C_n
        S = sum(
            w * self.stress(C_n + s * dC, **parameters)
            for s, w in zip(_POINTS, _WEIGHTS, strict=True)
        )
        square = ufl.inner(dC, dC)
        defect = self.psi(C, **parameters) - self.psi(C_n, **parameters) - ufl.inner(S, dC) / 2
        large = ufl.gt(square, _SMALL_STRAIN_INCREMENT**2)
        safe = ufl.conditional(large, square, 1.0)
        return S + ufl.conditional(large, 2 * defect / safe, 0.0) * dC

    def linear_stress(self, E_GL: Any, **parameters: Any) -> Any:
        r"""Stress of a strain by the moduli at C = 1, :math:`4 \psi''(1) : E`.

        Args:
            E_GL: Green-Lagrange strain, or its rate, UFL (3, 3).
            **parameters: Values of parameters of the energy, by name; others have their own.

        Returns:
            Stress [Pa], or its rate [Pa/s], UFL (3, 3).
        """
        C = ufl.variable(ufl.Identity(3))
        moduli = 2 * ufl.diff(self.stress(C, **parameters), C)
        i, j, m, n = ufl.indices(4)
        return ufl.as_tensor(moduli[i, j, m, n] * E_GL[m, n], (i, j))

    def _check_energy(self) -> None:
        """Raise unless the energy is a scalar with derivatives that fit the damping."""
        value = ufl.as_ufl(self.psi(ufl.Identity(3), **self.parameters))
        if (shape := value.ufl_shape) != ():
            raise ValueError(f"expected a scalar strain energy psi(C), given shape {shape}")
        if extract_domains(value):
            return
        try:
            self._curve.check()
        except (ArithmeticError, TypeError, ValueError) as error:
            raise ValueError(
                f"expected psi(C) twice differentiable at C = 1, given {error}"
            ) from error
        self._check_stress()
        if self.stiffness_damping > 0:
            least, most = np.linalg.eigvalsh(self.moduli)[[0, -1]]
            if least < -_ROUND_OFF * max(most, -least):
                raise ValueError(
                    "expected moduli without negative eigenvalue at C = 1 for stiffness_damping, "
                    f"given {least:g} Pa"
                )

    def _check_stress(self) -> None:
        """Raise unless bodies without deformation have no stress."""
        basis = self.strain_basis()
        S = sum(2 * self._curve.slope(D) * D for D in basis)
        moduli = [4 * self._curve.curvature(D) for D in basis]
        if np.abs(S).max() > _NO_STRESS * np.abs(moduli).max():
            rows = [[float(f"{value:.4g}") for value in row] for row in S]
            raise ValueError(
                f"expected psi(C) without stress at C = 1, given S = {rows} Pa: an undeformed "
                "body would start to move by itself; add a term that takes this stress away, as "
                "- mu ln J does to mu/2 tr C"
            )

    def _check_parts(self) -> None:
        """Raise unless the energy is the sum of its parts for `one_point`."""
        if not self.one_point or self._has_fields:
            return
        C = ufl.Identity(3) + ufl.as_matrix((_LARGE_STRAIN * GENERIC_STRAIN).tolist())
        names = self.parameters.keys()
        parts = [self._number(C, without) for without in (self.one_point, names - self.one_point)]
        total = self._number(C)
        if not abs(total - sum(parts)) <= _ROUND_OFF * (abs(total) + np.abs(parts).sum()):
            raise ValueError(
                "expected an energy that is linear in its parameters for one_point, "
                f"given {total:g} J/m^3 and parts of {parts}"
            )

    def _number(self, C: Any, without: Iterable[str] = ()) -> float:
        """Energy [J/m^3] of a constant tensor with some parameters zero."""
        return float(ufl.as_ufl(self.psi(C, **dict.fromkeys(without, 0.0)))(()))

    @cached_property
    def _curve(self) -> EnergyCurve:
        return EnergyCurve(partial(self.psi, **self.parameters))

    @staticmethod
    def strain_basis() -> Floats:
        """Orthonormal basis of the symmetric tensors, shape ``(6, 3, 3)``."""
        basis = np.zeros((6, 3, 3))
        for D, (i, j) in zip(basis, combinations_with_replacement(range(3), 2), strict=True):
            D[i, j] = D[j, i] = 1.0 if i == j else np.sqrt(0.5)
        return basis

    @cached_property
    def moduli(self) -> Floats:
        """Moduli 4 psi''(1) in the basis `strain_basis`, shape ``(6, 6)`` [Pa].

        Only for energies without fields.
        """
        basis = self.strain_basis()
        curvature = np.zeros((6, 6))
        for i, j in combinations_with_replacement(range(6), 2):
            curvature[i, j] = curvature[j, i] = self._curve.curvature(basis[i] + basis[j])
        diagonal = np.diag(curvature) / 4
        moduli: Floats = 2 * (curvature - diagonal[:, None] - diagonal)
        return moduli

    def _rule(self, one_point: str | Sequence[str] | None) -> tuple[bool, frozenset[str]]:
        """`splits_volume` and `one_point` of what was given."""
        if one_point is None:
            splits = _LOCKS <= poisson_ratio(self) < _FLUID
        else:
            splits = one_point == "volumetric"
        if not splits:
            return False, frozenset(one_point or ())
        names = self._volumetric_parameters()
        if names or self._has_fields or self._volume_has_pressure_alone():
            return True, names
        if one_point is None:
            return False, frozenset()
        raise ValueError(
            "expected an energy whose stress is a pressure where nothing but the volume changes, "
            "for one_point='volumetric', given one with another stress there, as of fibres: some "
            "deformations would release energy; give one_point=(), or let fibres feel "
            "(det C)^(-1/3) C only"
        )

    def _volume_has_pressure_alone(self) -> bool:
        """Whether the stress of a small equal change of volume is a pressure."""
        volume = np.einsum("aii->a", self.strain_basis())
        stress = self.moduli @ volume
        rest = stress - stress @ volume / 3 * volume
        return bool(np.abs(rest).max() <= _NO_STRESS * np.abs(self.moduli).max())

    def _volumetric_parameters(self) -> frozenset[str]:
        """Names of parameters whose terms of the energy resist changes of volume.

        Of an energy that is linear in its parameters, all whose terms depend on det C only.
        """
        names = self.parameters.keys()
        shape = ufl.as_matrix((np.eye(3) + _LARGE_STRAIN * GENERIC_STRAIN).tolist())
        as_large = ufl.det(shape) ** (1 / 3) * ufl.Identity(3)
        try:
            terms = {n: [self._number(C, names - {n}) for C in (shape, as_large)] for n in names}
            total = self._number(shape)
        except ArithmeticError:
            return frozenset()
        size = sum(abs(energy) for energy, _ in terms.values())
        if not abs(total - sum(energy for energy, _ in terms.values())) <= _ROUND_OFF * size:
            return frozenset()
        return frozenset(
            name
            for name, (energy, of_volume) in terms.items()
            if abs(energy - of_volume) <= _ROUND_OFF * abs(energy) != 0
        )

    @property
    def _has_fields(self) -> bool:
        return bool(extract_domains(ufl.as_ufl(self.psi(ufl.Identity(3)))))

    @property
    def least_modulus(self) -> float:
        """Least eigenvalue of `moduli`, at least 0; NaN for energies with fields [Pa].

        For an isotropic material it is twice the shear modulus.
        """
        if self._has_fields:
            return np.nan
        return max(float(np.linalg.eigvalsh(self.moduli)[0]), 0.0)

    @property
    def resists_collapse(self) -> bool:
        """Whether the energy grows without bound as the volume vanishes.

        Energies with fields are not evaluated and count as such.
        """
        C = [ufl.as_matrix((scale * np.eye(3)).tolist()) for scale in _COLLAPSED]
        values = [ufl.as_ufl(self.psi(each, **self.parameters)) for each in C]
        if any(extract_domains(value) for value in values):
            return True
        smaller, small = (float(value(())) for value in values)
        return smaller > _GROWTH * small


class PartOfEnergy(Hyperelastic):
    """Damping of a material and an energy that is a part of its own. Local.

    Args:
        material: The material, which has been checked.
        psi: Strain energy density of the part, see `Hyperelastic`.
    """

    def __init__(self, material: Hyperelastic, psi: Callable[..., Any]) -> None:
        """Take over all numbers."""
        self.rho, self.parameters = material.rho, material.parameters
        self.one_point, self.splits_volume, self._has_default = frozenset(), False, True
        self.mass_damping = material.mass_damping
        self.stiffness_damping = material.stiffness_damping
        self._psi = psi


class MassOnly(Hyperelastic):
    """Inertia and mass damping of a material, without its stress. Local.

    Bodies need it where inertia and energy have quadratures of their own.

    Args:
        material: The material.
    """

    def __init__(self, material: Hyperelastic) -> None:
        """Take over density and mass damping; the energy is zero."""
        super().__init__(
            lambda C, **parameters: ufl.zero(),
            rho=material.rho,
            mass_damping=material.mass_damping,
            one_point=(),
        )

    def stress(self, *strains: Any, **parameters: Any) -> Any:
        """Zero in the place of any stress, UFL (3, 3)."""
        return ufl.zero(3, 3)

    conserving_stress = linear_stress = stress


def poisson_ratio(material: Hyperelastic) -> float:
    """Poisson's ratio of small strains. Local.

    Args:
        material: The material.

    Returns:
        The ratio [-], of an anisotropic material that of the nearest isotropic one; NaN for
        energies with fields.
    """
    if np.isnan(material.least_modulus):
        return np.nan
    volume = np.einsum("aii->a", material.strain_basis())
    bulk = volume @ material.moduli @ volume / 9
    shear = (np.trace(material.moduli) - 3 * bulk) / 10
    return float((3 * bulk - 2 * shear) / (2 * (3 * bulk + shear)))
