"""Checks of a user-defined scheme."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arguments import called, is_of_package, kind_of
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.integrators.scheme import HINT, Scheme
from dolfinx_nts.integrators.state import State
from dolfinx_nts.materials.evaluation import Evaluation
from dolfinx_nts.materials.library import NeoHookean
from dolfinx_nts.model.bodies import Body

__all__ = ["check_stress", "make_rates"]

# Deformation gradient at which the stress of a scheme is checked [-]: a stretch with a rotation.
_SAMPLE = [[1.05, 0.20, 0.0], [-0.15, 0.95, 0.05], [0.0, 0.1, 1.02]]
# Factor of the parameters of an energy [-] with which the stress is evaluated again.
_OTHER = 0.75
# Relative error of a stress [-] above which it is not round-off.
_INCONSISTENT = 1e-6
# Relative change of the deformation for the measurement of ``stress_share`` by differences [-], and
# admissible error of the weight [-].
_CHANGE, _WRONG_SHARE = 1e-4, 1e-2


def make_rates(scheme: Scheme, state: State, dt: fem.Constant, bodies: Sequence[Body]) -> Rates:
    """Create the rates of a stepper. Collective.

    Raises:
        TypeError: ``scheme.rates`` takes other arguments, or returns no `Rates`.
        ValueError: The time of stress, loads or contact differs between rates and scheme.
    """
    call = f"rates(state, dt, bodies) of the Scheme ({HINT})"
    found = called(scheme.rates, call, state, dt, bodies)
    if not isinstance(found, Rates):
        raise TypeError(
            f"expected rates of the Scheme that return Rates, given {kind_of(found)}: {HINT}"
        )
    if (time := found.force_time) is not None:
        if scheme.contact != "static" and not np.isclose(time, 0.5, rtol=0, atol=_INCONSISTENT):
            raise ValueError(
                f"expected contact 'static' of the Scheme, at the end of a step, given "
                f"{scheme.contact!r}, at the mean state: with rates whose forces act at the time "
                f"{time:g} of a step the scheme is of first order"
            )
        given = {"stress_share": scheme.stress_share, "load_point": scheme.load_point}
        for name, value in given.items():
            if not np.isclose(value, time, rtol=0, atol=_INCONSISTENT):
                raise ValueError(
                    f"expected {name} of the Scheme to be {time:g}, the time of the forces in its "
                    f"rates (1 - alpha_f of Newmark, 1/2 of the midpoint rule), given {value:g}: "
                    "with another value the scheme is of first order"
                )
    return found


def check_stress(scheme: Scheme, bodies: Sequence[Body]) -> None:
    """Check that the stress of a step without deformation is the stress of the material. Local.

    Any consistent scheme has the stress P = F S(F^T F) if F is the same at both ends, for any
    parameters of the energy. The stress is evaluated for the first deformable body whose stress
    depends on the deformation alone, and for a neo-Hookean material if there is none. The weight of
    the end of the step is checked by a difference for a small change of F. Schemes of the package
    are not checked here, as this takes up to half a second.

    Raises:
        TypeError: ``scheme.stress`` takes other arguments.
        ValueError: The result is not a tensor, is another stress, or does not depend on the
            parameters; or the weight of the end of the step in it is not ``scheme.stress_share``.
    """
    if is_of_package(scheme.stress):
        return
    own = (body.material for body in bodies if not body.is_rigid)
    plain = [each for each in own if not (each.remembers or each.has_fields)]
    for material in [*plain, NeoHookean(E=1.0, nu=0.3, rho=1.0)]:
        F = ufl.as_matrix(_SAMPLE)
        call = "stress(material, parameters, F_n, F) of the Scheme"
        parameters = dict(material.parameters)
        P = called(scheme.stress, call, material, parameters, F, F)
        shape = getattr(P, "ufl_shape", None)
        if shape != (3, 3):
            raise ValueError(
                "expected the first Piola-Kirchhoff stress from stress of the Scheme, a UFL tensor "
                f"of shape (3, 3), given {kind_of(P) if shape is None else shape}"
            )
        try:
            values = _numbers(P)
        except (ArithmeticError, TypeError, ValueError):
            return
        exact = _numbers(F * material.stress(F.T * F))
        if not np.abs(values - exact).max() <= _INCONSISTENT * np.abs(exact).max():
            raise ValueError(
                "expected the first Piola-Kirchhoff stress F S(F^T F) from stress of the Scheme if "
                f"F_n = F, given another tensor: for {material!r} and F = {_SAMPLE} its entries 11 "
                f"and 12 are {values[0, 0]:.4g} and {values[0, 1]:.4g} Pa instead of "
                f"{exact[0, 0]:.4g} and {exact[0, 1]:.4g} Pa"
            )
        # Parts of an energy are integrated apart by parameters that are 0, see `Hyperelastic`.
        other = {name: _OTHER * value for name, value in parameters.items()}
        try:
            values_of_other = _numbers(scheme.stress(material, other, F, F))
            exact_of_other = _numbers(F * material.stress(F.T * F, **other))
        except (ArithmeticError, TypeError, ValueError):
            return
        error = np.abs(values_of_other - exact_of_other).max()
        if not error <= _INCONSISTENT * np.abs(exact_of_other).max():
            raise ValueError(
                "expected a stress of the Scheme that depends on its argument parameters, given "
                f"another tensor than F S(F^T F) for {material!r} with {other}: write "
                "material.stress(C, **parameters)"
            )
        near = ufl.as_matrix(np.array(_SAMPLE) + _CHANGE * np.array(_SAMPLE).T)
        at_end, at_both = (
            _numbers(scheme.stress(material, parameters, F_n, near)) - values for F_n in (F, near)
        )
        share = float(np.vdot(at_end, at_both) / np.vdot(at_both, at_both))
        if abs(share - scheme.stress_share) > _WRONG_SHARE:
            raise ValueError(
                "expected stress_share of the Scheme to be the weight of the end of the step in "
                f"its stress, which is {share:.3f}, given {scheme.stress_share:g}"
            )
        return


def _numbers(tensor: Any) -> Any:
    """Entries of a UFL tensor of numbers, shape ``(3, 3)``."""
    axes = range(3)
    entries = [[expand_derivatives(tensor[i, j]) for j in axes] for i in axes]
    return np.array([[Evaluation(entry).value({}) for entry in row] for row in entries])
