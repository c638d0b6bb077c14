r"""Hyperelastic materials: stress of a strain energy psi(C), and a stress that conserves it.

Everything is UFL. ``C`` is the right Cauchy-Green tensor and ``psi`` the strain energy per
reference volume; bodies turn both into forms. Parameters are constants of the forms, so a change of
values needs no compilation. Named materials are in `library`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import signature
from typing import Any, ClassVar

import numpy as np
import ufl

from dolfinx_nts.common.arguments import as_call, finite, positive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.materials.branches import checked_branches
from dolfinx_nts.materials.energy_curve import GENERIC_STRAIN
from dolfinx_nts.materials.strain_energy import StrainEnergy, are_pressures

__all__ = ["Hyperelastic", "hexahedra_lock", "right_cauchy_green"]

# Gauss points and weights of the average over [0, 1] [-]: three points are exact up to degree 5.
_POINTS = 0.5 + 0.5 * np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18
# |dC| [-] above which the error of the average exceeds round-off and is corrected. Below, the
# correction would be dominated by round-off divided by |dC|.
_SMALL_STRAIN_INCREMENT = 1e-2
# Strain [-] at which an energy is compared with the sum of its parts, large enough for terms of all
# orders to be visible.
_LARGE_STRAIN = 0.1
# Relative round-off of energies [-].
_ROUND_OFF = 1e-10
# Poisson's ratios of small strains [-]: one above which volumetric locking of hexahedra is
# relevant, and the limit at which the shear modulus vanishes.
_LOCKS, _FLUID = 0.3 - 1e-9, 0.5 - 1e-9


def right_cauchy_green(F: Any) -> Any:
    """C = F^T F of a deformation gradient F, both UFL (3, 3)."""
    return F.T * F


def hexahedra_lock(poisson_ratio: Floats | float) -> Flags:
    """Whether hexahedra of degree 1 with all quadrature points lock; False for NaN. Local."""
    return (np.asarray(poisson_ratio) >= _LOCKS) & (np.asarray(poisson_ratio) < _FLUID)


class Hyperelastic(StrainEnergy):
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
        one_point: Terms with one quadrature point per cell, at the mean deformation gradient of the
            cell (reduced integration). ``"volumetric"``: the volumetric terms in hexahedra and
            quadrilaterals of degree 1, which prevents volumetric locking. A list of names: the
            terms of ``psi`` with these parameters, in which ``psi`` must be linear. ``()``: none,
            as in Franke, Hesch and Betsch (2011). None: ``"volumetric"`` for a Poisson's ratio of
            at least 0.3 (with Functions in ``psi``, in any cell), otherwise none; also none if
            fibres resist a uniform change of volume. Every choice conserves energy, because each
            point has its own energy and conserving stress.
        branches: Pairs of a share [-] and a relaxation time [s], each a spring in series with a
            dashpot, in parallel with the energy. After a sudden change of shape the stress is that
            of ``psi`` times 1 plus the sum of the shares, and relaxes to the stress of ``psi``.
        **parameters: Keyword arguments of ``psi``, numbers.

    Attributes:
        rho, mass_damping, stiffness_damping: As given.
        branches: A tuple of named tuples with ``share`` [-] and ``relaxation_time`` [s].
        is_sheet: Whether the stress along z vanishes, see `PlaneStress`.
        one_point: Names as given, a frozen set, or the names of the volumetric terms.
        splits_volume: Whether the volumetric terms have one point. If ``one_point`` is then empty,
            these are the energy of an isotropic change of volume, psi(J^(2/3) 1).
        has_default_rule: Whether ``one_point`` was left out.
        parameters: Numbers by name, read-only.

    Raises:
        TypeError: ``psi`` cannot be called, is a function of F, or converts its arguments to Python
            numbers; or a branch is not a pair of numbers.
        ValueError: A number is not finite or has the wrong sign. ``psi`` is not a scalar, or
            without fields is not twice differentiable, has no minimum at C = 1, or has no bulk
            modulus. ``one_point`` names no parameter or all of them, or ``psi`` is not the sum of
            both parts. With ``"volumetric"``, an isotropic change of volume has a stress that is
            not a pressure.

    Example:
        >>> def psi(C, mu, kappa):
        ...     J2 = ufl.det(C)
        ...     return mu / 2 * (ufl.tr(C) - 3 - ufl.ln(J2)) + kappa / 8 * ufl.ln(J2) ** 2
        >>> nts.Hyperelastic(psi, rho=1.0e3, mu=3.0e4, kappa=1.0e5)  # kg/m^3, Pa
        Hyperelastic(psi=psi, mu=30000, kappa=100000, rho=1000)
    """

    is_sheet: ClassVar[bool] = False

    def __init__(
        self,
        psi: Callable[..., Any],
        *,
        rho: float,
        mass_damping: float = 0.0,
        stiffness_damping: float = 0.0,
        one_point: str | Sequence[str] | None = None,
        branches: Iterable[tuple[float, float]] = (),
        **parameters: float,
    ) -> None:
        if not callable(psi):
            raise TypeError(f"expected a function psi(C), given {type(psi).__name__}")
        _check_parameters(psi, parameters)
        damping = {"mass_damping": mass_damping, "stiffness_damping": stiffness_damping}
        for name, value in {"rho": rho, **damping, **parameters}.items():
            finite(name, value)
        positive("a density rho", rho)
        for name, value in damping.items():
            if value < 0:
                raise ValueError(f"expected {name} >= 0, given {value}")
        self.rho = float(rho)
        self.mass_damping, self.stiffness_damping = float(mass_damping), float(stiffness_damping)
        self.branches = checked_branches(branches)
        super().__init__(psi, parameters)
        self.check()
        self.has_default_rule = one_point is None
        self.splits_volume, self.one_point = self._rule(one_point)
        if self.one_point and not self.one_point < parameters.keys():
            raise ValueError(
                f"expected one_point 'volumetric', or some but not all of {sorted(parameters)}, "
                f"given {one_point!r}"
            )
        self._check_parts()

    def __repr__(self) -> str:
        names = tuple(sorted(self.one_point))
        damping = {"mass_damping": self.mass_damping, "stiffness_damping": self.stiffness_damping}
        options: dict[str, Any] = {name: value for name, value in damping.items() if value}
        if not self.has_default_rule:
            options["one_point"] = "volumetric" if self.splits_volume else names
        if self.branches:
            options["branches"] = [tuple(branch) for branch in self.branches]
        return as_call(self, **self._described(), rho=self.rho, **options)

    def _described(self) -> dict[str, Any]:
        """Arguments of the energy in ``repr``, by name."""
        return {"psi": self._psi, **self.parameters}

    @property
    def is_damped(self) -> bool:
        """Whether the material has damping of either kind."""
        return self.mass_damping > 0 or self.stiffness_damping > 0

    @property
    def remembers(self) -> bool:
        """Whether material points have history variables, such as viscous strains."""
        return bool(self.branches)

    def stress(self, C: Any, **parameters: Any) -> Any:
        """Second Piola-Kirchhoff stress S = 2 d psi/d C.

        Args:
            C: Right Cauchy-Green tensor, UFL (3, 3).
            **parameters: Parameters of the energy by name, in place of those of the material.

        Returns:
            Stress [Pa], UFL (3, 3).
        """
        C = ufl.variable(C)
        # Symmetrised, as the UFL derivative is not symmetric if psi uses entries of C.
        return 2 * ufl.sym(ufl.diff(self.psi(C, **parameters), C))

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        r"""Stress whose work in a step is exactly the change of the strain energy.

        :math:`S : (C_{n+1} - C_n)/2 = \psi_{n+1} - \psi_n`. It is the average of the stress on the
        straight path between the states, by three Gauss points. The correction along dC of Gonzalez
        (2000) is added if dC is large enough for the average to need it. There is no 0/0 for
        constant C.

        Args:
            C_n: Right Cauchy-Green tensor at t_n, UFL (3, 3).
            C: Right Cauchy-Green tensor at t_{n+1}, UFL (3, 3).
            **parameters: Values of parameters of the energy, by name; the others keep their values.

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
        r"""Stress of a strain with the moduli at C = 1, :math:`4 \psi''(1) : E`.

        Args:
            E_GL: Green-Lagrange strain, or its rate, UFL (3, 3).
            **parameters: Values of parameters of the energy, by name; the others keep their values.

        Returns:
            Stress [Pa], or its rate [Pa/s], UFL (3, 3).
        """
        C = ufl.variable(ufl.Identity(3))
        moduli = 2 * ufl.diff(self.stress(C, **parameters), C)
        i, j, m, n = ufl.indices(4)
        return ufl.as_tensor(moduli[i, j, m, n] * E_GL[m, n], (i, j))

    def shape_stress(self, E_GL: Any, **parameters: Any) -> Any:
        """Deviatoric `linear_stress` of the deviatoric part of a strain, for viscous branches."""
        return ufl.dev(self.linear_stress(ufl.dev(E_GL), **parameters))

    def free_thickness(self, C: Any, **parameters: Any) -> Any:
        """Square of the stretch along z of a sheet without stress there, see `PlaneStress`.

        Args:
            C: Right Cauchy-Green tensor, UFL (3, 3); only its part in the plane is used.
            **parameters: Parameters of the energy by name, in place of those of the material.

        Returns:
            UFL scalar; None where there is no closed form.
        """
        return None

    def thickness_stretch(self, C: Any, **parameters: Any) -> Any:
        """Stretch along z divided by sqrt(C_33), UFL; 1 except in `PlaneStress`."""
        return 1

    def _check_parts(self) -> None:
        """Raise unless the energy is the sum of its parts for `one_point`."""
        if not self.one_point or self.has_fields:
            return
        C = ufl.as_matrix((np.eye(3) + _LARGE_STRAIN * GENERIC_STRAIN).tolist())
        names = self.parameters.keys()
        parts = [self.value(C, without) for without in (self.one_point, names - self.one_point)]
        total = self.value(C)
        if not abs(total - sum(parts)) <= _ROUND_OFF * (abs(total) + np.abs(parts).sum()):
            raise ValueError(
                "expected an energy that is linear in its parameters for one_point, "
                f"given {total:g} J/m^3 instead of the sum of its parts {parts}"
            )

    def _rule(self, one_point: str | Sequence[str] | None) -> tuple[bool, frozenset[str]]:
        """`splits_volume` and `one_point` from the argument."""
        if one_point is None:
            splits = bool(hexahedra_lock(self.poisson_ratio))
        else:
            splits = one_point == "volumetric"
        if not splits:
            return False, frozenset(one_point or ())
        names = self._volumetric_parameters()
        if names or self.has_fields or are_pressures(self.moduli):
            return True, names
        if one_point is None:
            return False, frozenset()
        raise ValueError(
            "expected, for one_point='volumetric', an energy whose stress is a pressure if only "
            "the volume changes, given one with another stress, as of fibres: some deformations "
            "would release energy; use one_point=(), or an energy of fibres that depends on "
            "(det C)^(-1/3) C only"
        )

    def _volumetric_parameters(self) -> frozenset[str]:
        """Names of parameters whose terms of the energy depend on det C only.

        The energy must be linear in its parameters, and have no fields.
        """
        if self.has_fields:
            return frozenset()
        names = self.parameters.keys()
        C = np.eye(3) + _LARGE_STRAIN * GENERIC_STRAIN
        equally_large = np.linalg.det(C) ** (1 / 3) * np.eye(3)
        shape, as_large = (ufl.as_matrix(each.tolist()) for each in (C, equally_large))
        try:
            terms = {n: [self.value(C, names - {n}) for C in (shape, as_large)] for n in names}
            total = self.value(shape)
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


def _check_parameters(psi: Callable[..., Any], parameters: Mapping[str, float]) -> None:
    """Raise an error unless an energy takes the tensor C, and exactly the given parameters."""
    first = next(iter(signature(psi).parameters), "")
    if first == "F":
        raise TypeError(
            "expected an energy of the right Cauchy-Green tensor C = F^T F, given one of F: write "
            "psi(C, ...) with, for instance, tr(C) for F : F and sqrt(det(C)) for det(F)"
        )
    try:
        signature(psi).bind(None, **parameters)
    except TypeError as error:
        _, *names = signature(psi).parameters
        raise TypeError(
            f"expected numbers for the parameters {names} of the energy, and no options but "
            "mass_damping, stiffness_damping, one_point and branches, given "
            f"{list(parameters)}: {error}"
        ) from None
