r"""Soft tissue and rubber with families of fibres, which act in tension only.

The conserving stress of a family is the tensor :math:`\bar D I_4` times the difference quotient of
its energy. The quotient has a closed form without 0/0, also in steps in which fibres become taut.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl

from dolfinx_nts.common.arguments import positive, real
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.volume_increment import VolumeIncrement

__all__ = ["HolzapfelGasserOgden"]

# Square of d [-] below which sinh(d)/d is evaluated as a series, and number of its terms; the next
# one is round-off.
_SERIES, _TERMS = 0.01, 6


class HolzapfelGasserOgden(Hyperelastic):
    r"""Holzapfel-Gasser-Ogden material: a neo-Hookean matrix with families of fibres. Local.

    :math:`\psi = \mu/2\, (\bar I_1 - 3) + \kappa/2\, (J - 1)^2 + k_1/(2 k_2) \sum_a (\exp(k_2
    \langle \bar E_a \rangle^2) - 1)` with :math:`\bar E_a = d\, (\bar I_1 - 3) + (1 - 3 d)(\bar
    I_{4a} - 1)` and :math:`\bar I_{4a} = J^{-2/3}\, a \cdot C a` (Gasser, Ogden and Holzapfel
    2006). Fibres are slack where :math:`\bar E_a \le 0`. They do not contribute to the moduli of
    the undeformed material, on which damping and viscous branches are based.

    Args:
        mu: Shear modulus of the matrix [Pa].
        kappa: Bulk modulus [Pa].
        k1: Stiffness of the fibres [Pa].
        k2: Exponent of the stiffening [-].
        rho: Reference density [kg/m^3].
        fibres: Directions of the families in the undeformed body, each three numbers, or a UFL
            vector, such as a Function, of three components or, in the plane, two. Their length
            does not matter, but must not be zero.
        dispersion: Dispersion d of the directions of a family, from 0, none, to 1/3, isotropic [-].
        **options: Damping, quadrature and branches, as for `Hyperelastic`.

    Attributes:
        fibres: Directions as given, a tuple.

    Raises:
        TypeError: A value is not a number, or ``fibres`` is not a sequence of vectors.
        ValueError: A modulus, the exponent or ``rho`` is not positive, ``dispersion`` is not in
            [0, 1/3], or a direction is not finite, is zero or has the wrong shape.

    Example:
        >>> law = nts.HolzapfelGasserOgden(
        ...     mu=3.0e3, kappa=1.0e5, k1=2.0e3, k2=5.0, rho=1.0e3, fibres=[(1.0, 1.0, 0.0)]
        ... )
        >>> round(law.poisson_ratio, 3)
        0.485
    """

    def __init__(
        self,
        mu: float,
        kappa: float,
        k1: float,
        k2: float,
        rho: float,
        fibres: Sequence[Any],
        dispersion: float = 0.0,
        **options: Any,
    ) -> None:
        numbers = {"mu": mu, "kappa": kappa, "k1": k1, "k2": k2}
        for name, value in numbers.items():
            positive(name, value)
        if not 0 <= real("dispersion", dispersion) <= 1 / 3:
            raise ValueError(f"expected a dispersion in [0, 1/3], given {dispersion}")
        self.fibres, directions = _checked(fibres)
        numbers |= {"dispersion": dispersion}
        super().__init__(self._energy, rho=rho, **(numbers | directions | options))

    def _described(self) -> dict[str, Any]:
        names = ("mu", "kappa", "k1", "k2", "dispersion")
        return {name: self.parameters[name] for name in names} | {"fibres": self.fibres}

    def _volumetric_parameters(self) -> frozenset[str]:
        return frozenset(["kappa"])

    def check(self) -> None:
        """Do nothing: the energy has no stress at C = 1, and moduli that may be discontinuous."""

    @property
    def least_modulus(self) -> float:
        """Twice the shear modulus of the matrix [Pa]."""
        return 2 * self.parameters["mu"]

    @property
    def _is_stable(self) -> bool:
        """True, as all moduli are positive."""
        return True

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio of the matrix [-]."""
        mu, kappa = self.parameters["mu"], self.parameters["kappa"]
        return (3 * kappa - 2 * mu) / (2 * (3 * kappa + mu))

    @property
    def resists_collapse(self) -> bool:
        """False, as the energy of a vanishing volume is finite."""
        return False

    def linear_stress(self, E_GL: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        pressure = numbers["kappa"] * ufl.tr(E_GL) * ufl.Identity(3)
        return pressure + 2 * numbers["mu"] * ufl.dev(E_GL)

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        volume, mean = VolumeIncrement(C_n, C), (C_n + C) / 2
        a_n, a = volume.roots

        def tensor(M: Any) -> Any:
            """Discrete gradient of J^(-2/3) M : C."""
            return (a_n + a) / 2 * M + volume.root * ufl.inner(M, mean) * volume.gradient

        S = numbers["mu"] / 2 * tensor(ufl.Identity(3))
        S += numbers["kappa"] / 2 * (1 - 2 / volume.sum) * volume.gradient
        for M in self._structures(numbers):
            x_n, x = (root * ufl.inner(M, G) - 1 for root, G in ((a_n, C_n), (a, C)))
            S += _quotient(numbers["k1"], numbers["k2"], x_n, x) * tensor(M)
        return 2 * S

    def _energy(self, C: Any, **numbers: Any) -> Any:
        J2 = ufl.det(C)
        root = J2 ** (-1 / 3)
        psi = numbers["mu"] / 2 * (root * ufl.tr(C) - 3)
        psi += numbers["kappa"] / 2 * (ufl.sqrt(J2) - 1) ** 2
        k1, k2 = numbers["k1"], numbers["k2"]
        for M in self._structures(numbers):
            taut = _taut(root * ufl.inner(M, C) - 1)
            psi += k1 / (2 * k2) * (ufl.exp(k2 * taut**2) - 1)
        return psi

    def _structures(self, numbers: Any) -> list[Any]:
        """Tensors M with the strain J^(-2/3) M : C - 1 of each family, UFL (3, 3)."""
        # Without the terms of the fibres.
        if isinstance(numbers["k1"], float) and numbers["k1"] == 0.0:
            return []
        d, structures = numbers["dispersion"], []
        for number, fibre in enumerate(self.fibres, start=1):
            if not isinstance(fibre, ufl.core.expr.Expr):
                fibre = ufl.as_vector([numbers[name] for name in _names(number)])
            elif len(fibre) == 2:
                fibre = ufl.as_vector([fibre[0], fibre[1], 0])
            along = ufl.outer(fibre, fibre) / ufl.inner(fibre, fibre)
            structures.append(d * ufl.Identity(3) + (1 - 3 * d) * along)
        return structures


def _names(number: int) -> list[str]:
    """Names of the parameters that hold the components of a direction."""
    return [f"fibre_{number}_{axis}" for axis in "xyz"]


def _checked(fibres: Any) -> tuple[tuple[Any, ...], dict[str, float]]:
    """Directions as given, and the components of numerical directions by name."""
    if isinstance(fibres, str) or not isinstance(fibres, Sequence) or not len(fibres):
        raise TypeError(f"expected fibres as a sequence of directions, given {fibres!r}")
    components: dict[str, float] = {}
    kept: list[Any] = []
    for number, fibre in enumerate(fibres, start=1):
        if isinstance(fibre, ufl.core.expr.Expr):
            if fibre.ufl_shape not in ((2,), (3,)):
                raise ValueError(
                    "expected directions of fibres of shape (3,), in the plane (2,), given "
                    f"{fibre.ufl_shape}"
                )
            kept.append(fibre)
            continue
        values = np.asarray(fibre)
        if values.dtype.kind not in "if":
            raise TypeError(
                "expected fibres as a sequence of directions, each three numbers or a UFL "
                f"vector, given {fibres!r}"
            )
        length = float(np.linalg.norm(values))
        if values.shape != (3,) or not np.isfinite(length) or length == 0.0:
            raise ValueError(
                "expected a direction of fibres of three numbers, not all 0, as in "
                f"fibres=[(1, 0, 0)], given {fibre!r}"
            )
        kept.append(tuple(map(float, values)))
        components |= dict(zip(_names(number), map(float, values / length), strict=True))
    return tuple(kept), components


def _taut(x: Any) -> Any:
    """Strain of fibres, zero where they are slack, UFL."""
    return ufl.conditional(ufl.gt(x, 0), x, 0)


def _quotient(k1: Any, k2: Any, x_n: Any, x: Any) -> Any:
    r"""Difference quotient of the energy of fibres with respect to their strain, UFL.

    With :math:`p = \langle x \rangle` and :math:`d = k_2 (p^2 - p_n^2)/2` it is :math:`k_1/2\,
    \exp(k_2 (p^2 + p_n^2)/2)\, \sinh(d)/d\, (p + p_n)\, (p - p_n)/(x - x_n)`.
    """
    p_n, p = _taut(x_n), _taut(x)
    d = k2 * (p - p_n) * (p + p_n) / 2
    square, series = d * d, 1.0
    for k in reversed(range(1, _TERMS)):
        series = 1 + square / (2 * k * (2 * k + 1)) * series
    is_small = ufl.lt(square, _SERIES)
    safe = ufl.conditional(is_small, 1.0, d)
    sinh = ufl.conditional(is_small, series, (ufl.exp(safe) - ufl.exp(-safe)) / (2 * safe))
    # First case: fibres taut at both ends; second: at one end, so that strains have opposite signs.
    crosses = ufl.lt(x * x_n, 0)
    width = ufl.conditional(crosses, x - x_n, 1.0)
    part = ufl.conditional(crosses, (p - p_n) / width, 1.0)
    return k1 / 2 * ufl.exp(k2 * (p * p + p_n * p_n) / 2) * sinh * (p + p_n) * part
