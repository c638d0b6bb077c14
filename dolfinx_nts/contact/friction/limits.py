"""Limits of tangential forces by a law of friction, and the slip of springs at the limit."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arguments import called_with_fixed, check_spelling, positive
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.friction.laws import SLIP_MEASURES, FrictionLaw, FrictionNodes
from dolfinx_nts.parallel import reductions

__all__ = ["Limits", "NodalLimit", "check_law", "coefficients_of", "round_off"]

# Negative values of a Function that count as zero, relative to its largest absolute value [-]:
# a zero of an interpolated expression has an error of a few times 1e-16. Larger: wrong signs would
# be accepted.
_ZERO = 1e-12

# Largest number of iterations for the slip of springs [-]; bisection alone needs 52.
_MOST_ITERATIONS = 60
# Admissible residual of the equation for the slip of a spring, relative to the trial traction [-]:
# a few digits above round-off. Larger: the energy ledger is not affected, but Newton's method is
# slower.
_ROUNDING = 1e-14
# Least slope of the sum of spring force and limit, relative to the spring stiffness [-]: it bounds
# the derivative of the traction if the slope of the limit is close to -eps_T.
_LEAST_SLOPE = 1e-3
# Check of derivatives: steps [s], normal forces [N] and slips [m] at which they are compared with
# differences, and number of nodes. At such numbers, which are not round, a law hardly has a kink.
_STEPS = (1.37e-3, 0.413)
_FORCES = 1.37 * 10.0 ** np.arange(-2, 7, 2)
_SLIPS = 1.37 * 10.0 ** np.arange(-8, 1)
_NUM_NODES = 4
# Relative step of the differences [-], and their admissible relative errors: of second order if
# one-sided differences enclose the derivative, and by round-off of the limit [-].
_PART, _DEVIATION, _ROUND_OFF = 1e-4, 1e-5, 1e-14
# Names of the results of a law.
_NAMES = "limit", "derivative with respect to p", "derivative with respect to slip"


class NodalLimit(NamedTuple):
    """Limits of tangential forces of ``m`` nodes.

    Attributes:
        force: Limit, shape ``(m,)`` [N]; where a node is pulled, its linear continuation.
        by_p: Derivative with respect to the normal force, shape ``(m,)`` [-].
        by_slip: Derivative with respect to the slip [N/m], or to the trial traction of a spring
            [-], shape ``(m,)``.
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
        negligible: See `round_off`; None to compute it here, collectively.

    Attributes:
        depends_on_slip: Whether limits depend on the slip.
        coefficients: Values of Functions and Constants at the nodes that the law has read.
    """

    def __init__(
        self,
        law: FrictionLaw,
        nodes: Any,
        dt: float,
        area: Callable[[], Floats],
        slipped: Floats,
        negligible: Mapping[Any, float] | None = None,
    ) -> None:
        self._negligible = round_off(law) if negligible is None else negligible
        self._law, self._nodes, self._dt = law, nodes, dt
        self._area, self._slipped = area, slipped
        self.coefficients: dict[Any, Floats] = {}
        self.depends_on_slip = law.depends_on_slip

    def at(self, node: Ints, p: Floats, slip: Floats | None = None) -> NodalLimit:
        """Limits of nodes for normal forces p [N] and slips [m] (None: no slip), ``(m,)``.

        Derivatives that are not finite at p = 0, such as the derivative of p^(2/3), count as 0
        there.

        Raises:
            ValueError: A limit is negative; a limit or a derivative is not finite at finite p > 0
                and slip; or a limit is not finite at p = 0.
        """
        pressed = np.maximum(p, 0.0)
        slip = np.zeros(len(p)) if slip is None else slip
        nodes = FrictionNodes(
            *(self._nodes, node, self._area(), self._slipped, self.coefficients, self._negligible)
        )
        force, *slopes = _arrays(self._law, p.shape, pressed, slip, self._dt, nodes)
        by_p, by_slip = (np.where((pressed > 0) | np.isfinite(x), x, 0.0) for x in slopes)
        given = np.isfinite(pressed) & np.isfinite(slip)
        for name, values in zip(_NAMES, (force, by_p, by_slip), strict=True):
            wrong = given & ~np.isfinite(values)
            if wrong.any():
                i = int(np.argmax(wrong))
                raise ValueError(
                    f"expected a finite {name} from {self._law!r}, given {values[i]} at "
                    f"p = {pressed[i]:.3g} N, slip = {slip[i]:.3g} m and dt = {self._dt:.3g} s: "
                    "correct the method limit"
                )
        if np.any(force < 0):
            raise ValueError(
                f"expected limits of friction >= 0 from {self._law!r}, given {np.min(force)} N"
            )
        return NodalLimit(force + by_p * np.minimum(p, 0.0), by_p, by_slip)

    def of_springs(
        self, node: Ints, p: Floats, trial: Floats, eps_T: Floats, slid: Flags
    ) -> tuple[NodalLimit, NodalLimit]:
        """Limits of nodes with tangential springs, for the stick test and for sliding nodes. Local.

        The law is evaluated at the plastic slip s, with eps_T s + limit(p, s) = trial. Newton's
        method converges from above to the largest solution. If the limit decreases with the slip, a
        node may be able to stick and to slide. It slides if it slid before, and sticks otherwise.

        Args:
            node: Indices among the nodes of the pair, shape ``(m,)``.
            p: Normal forces, shape ``(m,)`` [N].
            trial: Length of the trial traction, for sticking nodes, shape ``(m,)`` [N].
            eps_T: Stiffness of the springs, shape ``(m,)`` [N/m].
            slid: Whether a node slid before, shape ``(m,)``.

        Returns:
            Limits that decide on stick and slip, and limits of sliding nodes.
        """
        sticks = self.at(node, p)
        if not self.depends_on_slip:
            return sticks, sticks
        low: Floats = np.zeros(len(p))
        high: Floats = trial / eps_T
        slip, exists = high, np.ones(len(p), dtype=bool)
        is_below = np.maximum(sticks.force, 0.0) < trial  # then a solution exists
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


def round_off(law: FrictionLaw) -> dict[Any, float]:
    """Size of negative values of each Function of a law that count as zero. Collective."""
    functions = [each for each in _attributes(law) if isinstance(each, fem.Function)]
    own = [float(np.abs(each.x.array).max(initial=0.0)) for each in functions]
    comms = [each.function_space.mesh.comm for each in functions]
    return {
        each: _ZERO * reductions.largest(comm, value)
        for each, comm, value in zip(functions, comms, own, strict=True)
    }


def check_law(law: FrictionLaw, nodes: Any) -> None:
    """Evaluate a law at owned nodes of a surface, and check its derivatives by differences.

    Collective, as is the area of the nodes at its first use.

    Raises:
        AttributeError: An attribute is one of `FrictionLaw`, misspelt.
        TypeError: The method `FrictionLaw.limit` takes other arguments, or ``eps_T`` is not a
            number.
        ValueError: ``eps_T`` is not positive, or ``law`` is unknown; limits or derivatives are not
            finite or of another shape, or limits are negative; a derivative is not that of the
            limit; limits depend on the slip although ``depends_on_slip`` is False; or a second call
            with the same arguments returns other limits.
    """
    check_spelling(law, ("eps_T", "depends_on_slip"))
    if law.eps_T is not None:
        positive(f"the tangential stiffness eps_T of {law!r}", law.eps_T)
    if law.law not in SLIP_MEASURES:
        raise ValueError(
            f"expected the attribute law of {law!r}, the measure of slip, to be "
            f"{' or '.join(map(repr, SLIP_MEASURES))}, given {law.law!r}"
        )
    n, area, negligible = len(nodes.nodes), nodes.positive_area, round_off(law)
    if n == 0:
        return
    node, one = np.arange(n, dtype=np.int32), np.ones(n)
    Limits(law, nodes, 1.0, lambda: area, np.zeros(n), negligible).at(node, one, one)
    for dt in _STEPS:
        limits = Limits(law, nodes, dt, lambda: area, np.zeros(n), negligible)
        # Open and sticking nodes.
        for p in (0.0, *_FORCES):
            limits.at(node, p * one)
        for slip in _SLIPS:
            limits.at(node, 0 * one, slip * one)
        _check_derivatives(law, nodes, limits, dt)


def coefficients_of(law: FrictionLaw | None, nodes: Any) -> list[Any]:
    """Constants and Functions on which the limit of a law depends. Collective.

    Args:
        law: The law; None without friction.
        nodes: Nodes of the contact pair.

    Returns:
        Constants and Functions that the law reads by `FrictionNodes.value` or has as attributes,
        also those of a law that is an attribute; the same on all ranks.
    """
    if law is None:
        return []
    n, area = len(nodes.nodes), nodes.positive_area
    limits = Limits(law, nodes, 1.0, lambda: area, np.zeros(n))
    limits.at(np.arange(n, dtype=np.int32), np.ones(n))
    return list(dict.fromkeys([*limits.coefficients, *_attributes(law)]))


def _attributes(law: FrictionLaw) -> list[Any]:
    """Constants and Functions among the attributes of a law, and of laws in it. Local."""
    found = list[Any]()
    for value in vars(law).values():
        if isinstance(value, FrictionLaw):
            found += _attributes(value)
        elif isinstance(value, fem.Constant | fem.Function):
            found.append(value)
    return found


def _check_derivatives(law: FrictionLaw, nodes: Any, limits: Limits, dt: float) -> None:
    """Compare derivatives of a law in a step dt [s] with one-sided differences of the limit. Local.

    At a kink of the limit, such as at a cap, a derivative may have any value between both
    differences.
    """
    some = np.unique(np.linspace(0, len(nodes.nodes) - 1, _NUM_NODES, dtype=np.int32))
    grid = (each.ravel() for each in np.meshgrid(some, _FORCES, _SLIPS, indexing="ij"))
    node, p, slip = grid
    at = limits.at(node, p, slip)
    if np.any(at.force != limits.at(node, p, slip).force):
        raise ValueError(
            f"expected the same limits of {law!r} for the same arguments, given other ones in a "
            "second call: the only memory of a law is nodes.slipped"
        )
    if not law.depends_on_slip and np.any(at.force != limits.at(node, p).force):
        raise ValueError(
            f"expected limits of {law!r} that do not depend on the slip, as its depends_on_slip "
            "is False, given limits that do: leave out that attribute"
        )
    moved = {"p": (_PART * p, 0 * slip), "slip": (0 * p, _PART * slip)}
    for (name, (dp, ds)), given in zip(moved.items(), at[1:], strict=True):
        h = dp + ds
        sides = [
            (limits.at(node, p + s * dp, slip + s * ds).force - at.force) / (s * h) for s in (-1, 1)
        ]
        error = _DEVIATION * np.abs(sides).sum(axis=0) + _ROUND_OFF * at.force / h
        wrong = (given < np.minimum(*sides) - error) | (given > np.maximum(*sides) + error)
        if wrong.any():
            i = int(np.argmax(wrong))
            unit = "" if name == "p" else " N/m"
            raise ValueError(
                f"expected the derivative of the limit with respect to {name} from {law!r}, given "
                f"{given[i]:.6g}{unit} instead of {np.mean(sides, axis=0)[i]:.6g}{unit} from "
                f"differences of the limit, at p = {p[i]:.3g} N, slip = {slip[i]:.3g} m and "
                f"dt = {dt:.3g} s: correct the method limit"
            )


def _arrays(law: FrictionLaw, shape: tuple[int, ...], *arguments: Any) -> list[Floats]:
    """Limit and both derivatives of a law as arrays of a shape. Local."""
    call, advice = "limit(p, slip, dt, nodes)", "p = mu * p instead of p *= mu"
    with np.errstate(divide="ignore", invalid="ignore"):
        # Derivatives may be infinite at p = 0; all values are checked.
        found = called_with_fixed(law.limit, call, law, advice, *arguments)
    if isinstance(found, tuple | list) and len(found) == 3:
        try:
            values = [np.asarray(each, dtype=np.float64) for each in found]
            if values[0].shape == shape:
                return [np.broadcast_to(each, shape) for each in values]
        except (TypeError, ValueError):
            pass
    raise ValueError(
        f"expected the limit and its derivatives with respect to p and slip, each of shape "
        f"{shape}, from {law!r}, given {_described(found)}"
    )


def _described(found: Any) -> str:
    """Number and shapes of returned values, or the values themselves if they are not numeric."""
    if found is None:
        return "None"
    if not isinstance(found, tuple | list):
        found = (found,)
    try:
        shapes = [str(np.asarray(each, dtype=np.float64).shape) for each in found]
    except (TypeError, ValueError):
        return repr(found)
    return f"{len(found)} of the shapes {', '.join(shapes)}"
