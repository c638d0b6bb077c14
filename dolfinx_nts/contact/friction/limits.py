"""Limits of tangential forces by a law of friction, and the slip of springs at the limit."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.friction.laws import FrictionLaw, FrictionNodes

__all__ = ["Limits", "NodalLimit", "check_law"]

# Largest number of iterations for the slip of springs [-]; bisection alone needs 52.
_MOST_ITERATIONS = 60
# Force, relative to the trial traction [-], by which the slip of a spring may miss its limit: a few
# digits above round-off. A larger one does not affect the energy ledger, but slows Newton's method.
_ROUNDING = 1e-14
# Least slope of spring and limit together, relative to the spring [-]: it bounds the derivative of
# a traction if the limit decreases as steeply as the spring is stiff.
_LEAST_SLOPE = 1e-3


class NodalLimit(NamedTuple):
    """Limits of tangential forces of ``m`` nodes.

    Attributes:
        force: Limit, shape ``(m,)`` [N]; where a node is pulled, its linear continuation.
        by_p: Derivative by the normal force, shape ``(m,)`` [-].
        by_slip: Derivative by the slip [N/m], or by the trial traction of a spring [-], ``(m,)``.
    """

    force: Floats
    by_p: Floats
    by_slip: Floats


class Limits:
    """Limits of tangential forces in one attempt at a step. Local.

    Args:
        law: The law.
        nodes: Nodes of the contact pair, ``n`` in number.
        dt: Length of the step [s].
        area: Returns the reference areas of the nodes, shape ``(n,)`` [m^2].
        slipped: Accumulated slip of the nodes at the start, shape ``(n,)`` [m].

    Attributes:
        depends_on_slip: Whether limits depend on the slip.
    """

    def __init__(
        self,
        law: FrictionLaw,
        nodes: Any,
        dt: float,
        area: Callable[[], Floats],
        slipped: Floats,
    ) -> None:
        self._law, self._nodes, self._dt = law, nodes, dt
        self._area, self._slipped = area, slipped
        self._known: dict[Any, Floats] = {}
        self.depends_on_slip = law.depends_on_slip

    def at(self, node: Ints, p: Floats, slip: Floats | None = None) -> NodalLimit:
        """Limits of nodes, ``(m,)``, that are pressed by p [N] and slip, None: stick [m]."""
        pressed = np.maximum(p, 0.0)
        slip = np.zeros(len(p)) if slip is None else slip
        nodes = FrictionNodes(self._nodes, node, self._area(), self._slipped, self._known)
        found = self._law.limit(pressed, slip, self._dt, nodes)
        if len(found) != 3 or np.shape(found[0]) != p.shape:
            raise ValueError(
                "expected a limit of friction at each node and two derivatives, shape "
                f"{p.shape}, from {self._law!r}, given {found}"
            )
        force, by_p, by_slip = found
        if np.any(force < 0):
            raise ValueError(
                f"expected limits of friction >= 0 from {self._law!r}, given {np.min(force)} N"
            )
        force = force + by_p * np.minimum(p, 0.0)
        return NodalLimit(
            np.asarray(force), *(np.broadcast_to(each, p.shape) for each in (by_p, by_slip))
        )

    def of_springs(
        self, node: Ints, p: Floats, trial: Floats, eps_T: Floats, slid: Flags
    ) -> tuple[NodalLimit, NodalLimit]:
        """Limits of nodes with tangential springs, and whether the nodes slide. Local.

        The law is evaluated at the plastic slip s, with eps_T s + limit(p, s) = trial. Newton's
        method comes from above, to the largest solution. If the limit decreases with the slip, a
        sticking node may have such a solution, too. Only nodes that slid before take it, and
        continue to slide.

        Args:
            node: Positions of the nodes, shape ``(m,)``.
            p: Normal forces, shape ``(m,)`` [N].
            trial: Length of the traction if they stuck, shape ``(m,)`` [N].
            eps_T: Stiffness of the springs, shape ``(m,)`` [N/m].
            slid: Whether a node slid last, shape ``(m,)``.

        Returns:
            Limits that decide on stick and slip, and limits of sliding nodes.
        """
        sticks = self.at(node, p)
        if not self.depends_on_slip:
            return sticks, sticks
        low: Floats = np.zeros(len(p))
        high: Floats = trial / eps_T
        slip, exists = high, np.ones(len(p), dtype=bool)
        is_below = np.maximum(sticks.force, 0.0) < trial  # so that there is a solution
        for _ in range(_MOST_ITERATIONS):
            limit = self.at(node, p, slip)
            error = np.where(exists, eps_T * slip + limit.force - trial, 0.0)
            if not np.any(np.abs(error) > _ROUNDING * trial):
                break
            is_below |= error < 0
            low, high = np.where(error < 0, slip, low), np.where(error > 0, slip, high)
            slope = eps_T + limit.by_slip
            newton = slip - error / np.where(slope > 0, slope, eps_T)
            inside = (slope > 0) & (newton > low) & (newton < high)
            exists &= inside | is_below | (error == 0)
            slip = np.where(inside | (error == 0), newton, (low + high) / 2) * exists
        slope = np.maximum(eps_T + limit.by_slip, _LEAST_SLOPE * eps_T)
        slides = NodalLimit(limit.force, limit.by_p * eps_T / slope, limit.by_slip / slope)
        exists &= slid & (slip > 0)
        return sticks._replace(force=np.where(exists, limit.force, sticks.force)), slides


def check_law(law: FrictionLaw, nodes: Any) -> None:
    """Evaluate a law once at all owned nodes of a surface. Local, if the area is known.

    Raises:
        ValueError: Limits or their derivatives are not finite, of another shape or negative.
    """
    n = len(nodes.nodes)
    node, one = np.arange(n, dtype=np.int32), np.ones(n)
    found = Limits(law, nodes, 1.0, lambda: nodes.area, np.zeros(n)).at(node, one, one)
    for name, values in zip(("limit", "derivative by p", "derivative by slip"), found, strict=True):
        if not np.all(np.isfinite(values)):
            raise ValueError(
                f"expected a finite {name} from {law!r} at 1 N, 1 m and 1 s, given {values}"
            )
