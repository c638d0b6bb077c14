"""Forces of supports and of contact in objectives."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.fem.components import dimension, existing
from dolfinx_nts.integrators.implicit.implicit_stepper import StepEquations
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["ForceWeights", "StepForces"]


class ForceWeights(NamedTuple):
    """Derivatives of an objective with respect to the residual of a step, by its parts.

    Attributes:
        bulk: With respect to the residual of bodies and loads, shape ``(n, d)`` [1/N].
        contact: With respect to the contact forces in the residual, shape ``(n, d)`` [1/N].
    """

    bulk: Floats
    contact: Floats


class StepForces:
    """Forces of supports and of contact in the steps of a run. Collective, as are its methods.

    A reaction is the residual of a step at the dofs of a condition. The contact force on a surface
    is the negative of the contact forces in the residual, summed over its nodes.

    Args:
        given: Conditions in ``bcs``, and surfaces or bodies, ``f`` in number.
        equations: Equations of the steps.

    Attributes:
        constants: Vectors with the values of a step, see `set`, of shape ``(k,)`` [N], with k = 3,
            in the plane 2, axisymmetric 1.
        has_contact: Whether there is a contact force.

    Raises:
        TypeError: An item is of another kind.
        ValueError: It does not belong to the stepper.
    """

    def __init__(self, given: Sequence[Any], equations: StepEquations) -> None:
        V = equations.rates.u.function_space
        self._comm, self._axes = V.mesh.comm, existing(V)[0]
        self.shape = V.dofmap.index_map.size_local, dimension(V)
        # Number of each condition, -1 for contact, and flags of the dofs of each force.
        self._number: list[int] = []
        self._flags: list[Flags] = []
        for item in given:
            flags = np.zeros(self.shape, dtype=bool)
            if isinstance(item, fem.DirichletBC):
                self._number.append(_number_of(item, equations))
                flags.ravel()[equations.bulk.supports.dofs_of(self._number[-1])] = True
            elif isinstance(item, Surface | Body):
                _check_contact(item, equations)
                self._number.append(-1)
                flags[item.nodes[item.nodes < self.shape[0]]] = True
            else:
                raise TypeError(
                    "expected in forces a condition of bcs, or a Surface or Body for the contact "
                    f"force on it, given {kind_of(item)}"
                )
            self._flags.append(flags)
        size = len(range(3)[: self.shape[1]][self._axes])
        self.constants = [fem.Constant(V.mesh, np.zeros(size)) for _ in self._flags]
        self.has_contact = -1 in self._number

    def of(self, reactions: Sequence[Reaction], contact: Floats) -> list[Floats]:
        """Forces of supports and of contact in a step, each ``(k,)`` [N].

        Args:
            reactions: Reactions in the report of the step.
            contact: Contact forces in the residual, shape ``(n, d)`` [N].
        """
        return [
            -reductions.total(self._comm, contact.sum(axis=0, where=flags))[self._axes]
            if number < 0
            else np.array(reactions[number].force)
            for number, flags in zip(self._number, self._flags, strict=True)
        ]

    def set(self, values: Sequence[Floats]) -> None:
        """Set the constants to the forces of a step. Local."""
        for constant, value in zip(self.constants, values, strict=True):
            constant.value[:] = value

    def weights(self, slopes: Sequence[Floats | float]) -> ForceWeights | None:
        """Weights for derivatives of the objective with respect to the forces; None if 0. Local."""
        if not any(np.any(slope) for slope in slopes):
            return None
        weights = ForceWeights(np.zeros(self.shape), np.zeros(self.shape))
        for number, flags, slope in zip(self._number, self._flags, slopes, strict=True):
            vector = np.zeros(self.shape[1])
            vector[self._axes] = slope
            if number < 0:
                weights.contact[:] -= flags * vector
            else:
                for part in weights:
                    part += flags * vector
        return weights


def _number_of(bc: fem.DirichletBC, equations: StepEquations) -> int:
    """Number of a condition in the list ``bcs`` of the stepper. Local."""
    supports = equations.bulk.supports
    for number, each in enumerate(supports.conditions[: len(supports)]):
        if each is bc:
            return number
    raise ValueError("expected in forces conditions of bcs of the stepper, given one not in bcs")


def _check_contact(item: Surface | Body, equations: StepEquations) -> None:
    """Check that contact may act on a surface or body. Collective."""
    sides = [side for each in equations.contacts for side in (each.pair.nodes, each.pair.segments)]
    own = [side for side in sides if isinstance(side, Surface) and side.V == item.V]
    touches = any(bool(np.isin(item.nodes, side.nodes).any()) for side in own)
    if not reductions.anywhere(item.V.mesh.comm, touches):
        raise ValueError(
            "expected in forces surfaces or bodies with contact in the stepper, given "
            f"{item.name}: none of its nodes is on a side of a contact pair"
        )
