r"""Viscous branches of a generalised Maxwell solid.

A branch is a spring in series with a dashpot, in parallel with the strain energy. With the strain
:math:`\Gamma` of the dashpot and the Green-Lagrange strain E it has the energy :math:`W = s/2\, (E
- \Gamma) : D : (E - \Gamma)` and the rate law :math:`\tau \dot\Gamma = E - \Gamma`. D are the
deviatoric moduli of the undeformed material: volumetric stress does not relax, as in rubber.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

from dolfinx_nts.common.arguments import positive

__all__ = ["Branch", "checked_branches"]


class Branch(NamedTuple):
    """A spring in series with a dashpot.

    Attributes:
        share: Shear modulus of the spring, relative to the shear modulus of the strain energy [-].
        relaxation_time: Time in which its stress falls to 1/e at constant strain [s].
    """

    share: float
    relaxation_time: float


def checked_branches(branches: Any) -> tuple[Branch, ...]:
    """Check branches given by a user. Local.

    Args:
        branches: Pairs of a share [-] and a relaxation time [s].

    Returns:
        The branches.

    Raises:
        TypeError: A branch is not a pair of real numbers.
        ValueError: A number is not positive and finite.
    """
    if not isinstance(branches, Iterable) or isinstance(branches, str):
        raise TypeError(
            f"expected branches as pairs (share, relaxation time [s]), given {branches!r}"
        )
    checked = []
    for branch in branches:
        if not isinstance(branch, Iterable) or len(pair := tuple(branch)) != 2:
            raise TypeError(
                f"expected a branch as a pair (share, relaxation time [s]), given {branch!r}"
            )
        for name, value in zip(("share", "relaxation time"), pair, strict=True):
            positive(f"the {name} of a branch", value)
        checked.append(Branch(*map(float, pair)))
    return tuple(checked)
