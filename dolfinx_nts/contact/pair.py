"""Contact pairs: declaration of nodes, segments and laws.

A `ContactPair` is a declaration and never changes. Each stepper creates a `PairState` from it,
which contains the state of contact.
"""

import logging
from copy import copy
from typing import Any, Protocol
from weakref import WeakSet

import numpy as np

from dolfinx_nts.common.arguments import as_call, kind_of, label
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.contact.friction.laws import FrictionLaw, friction_law
from dolfinx_nts.contact.friction.limits import check_law
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.method import (
    EDGES,
    KINDS,
    NODES,
    Method,
    check_dimension,
    check_method,
    check_smooth,
    check_tie,
    default_method,
)
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.surfaces import Surface, sharpest_corner
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.errors import agreed
from dolfinx_nts.search.edges.rigid_edge_search import num_sharp_edges

__all__ = ["AcceptedContact", "ContactPair", "is_in_use"]

_logger = logging.getLogger("dolfinx_nts")

# Sine of the angle at a corner of a segment [-] below which its normal is dominated by round-off.
_SHARP = 1e-8


class AcceptedContact(Protocol):
    """Results of a stepper that are accessible through the pair, see `PairState`."""

    @property
    def nodes(self) -> Surface:
        """Surface of the nodes, without facets between fastened bodies (`contact.seams`). Local."""

    @property
    def history(self) -> ContactHistory:
        """Contact of the last accepted step. Local."""

    @property
    def pressure(self) -> Floats:
        """Contact pressure at the nodes, shape ``(n,)`` [Pa]. Collective."""

    def gap(self, x: Floats, reach: float = np.inf) -> Floats:
        """Gap of every node [m], see `ContactPair.gap`. Collective."""


class ContactPair(Declaration):
    """Contact between nodes of a surface and segments of another, or a rigid obstacle. Collective.

    In the literature nodes are also called slave or secondary, and segments master or primary.

    For self contact, give the same surface twice; in a surface of several bodies, nodes of each
    also touch the other bodies. In self contact a node touches neither its neighbours on the mesh
    nor the opposite face of a thin wall (``cpp/nts/search/self_contact.h``). It must not move by
    more than one cell of the wall in a step. Springs act at the nodes of both sides. Multipliers
    act at a subset of the nodes: none of them is a vertex of a segment that another one touches.

    Several steppers may use the same pair independently: each of them keeps its state of the pair
    in ``stepper.contacts``. While only one stepper uses the pair, `history`, `pressure`, `gap` and
    ``str`` of the pair refer to that stepper. ``str`` gives the laws and, after the first step,
    the range of the stiffness of springs.

    Args:
        nodes: Surface whose nodes may touch.
        segments: Surface whose segments they may touch, or a rigid obstacle.
        enforcement: Law of normal contact. None for springs (`Penalty`) in implicit and explicit
            dynamics, and for Lagrange multipliers in statics.
        friction: Law of friction, such as `Coulomb`, `Stribeck`, `SlipWeakening` or `Tresca`, or a
            custom `FrictionLaw`; a number is the coefficient of Coulomb's law. None for contact
            without friction.
        method: ``"node-to-segment"``: nodes must not penetrate segments. ``"mortar"``:
            surface-to-surface contact. Each node constrains the mean gap of the facets around it,
            weighted with a dual shape function (Wohlmuth 2000); a uniform pressure is transmitted
            exactly on any meshes. At degree 2 only vertices carry multipliers.
            ``"edge-to-edge"``: edges of the first surface must not cross edges of the second one,
            or of a `RigidSurface`, if both edges are convex and turn by 30 degrees or more. Use
            it in addition to a pair of the same surfaces with one of the other methods, for edges
            that touch at once, see ``exchange``. None for mortar contact between two surfaces.
            With obstacles, smooth segments, ties, self contact, convective friction, or nodes of
            rigid bodies, and in explicit steps, None means node-to-segment contact.
        name: Name in columns and legends; empty for the names of the two sides.
        exchange: Whether vertices on convex edges and corners also have contact: vertices of the
            segments, and with mortar contact or in statics those of the nodes. A vertex
            that penetrates a face deeply has contact with this face, with the same laws as a node.
            Deeply means by more than a hundredth of a facet, and by more than the compression
            of the springs there. In space, edges that cross as deeply have contact, also those of a
            `RigidSurface`. False is the method of Franke, Hesch and Betsch (2011).

    Attributes:
        nodes, segments, name, exchange: The arguments.
        enforcement, method: The arguments, or the defaults of dynamics.
        friction: Law of friction; None if its coefficient is 0.
        touches_itself: Whether nodes and segments are the same surface.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: The surfaces belong to different spaces, or share some of their nodes;
            convective friction does not fit the other arguments; a law of friction has no finite
            limits; ``method`` is unknown or does not fit the other arguments, such as
            edge-to-edge contact without sharp edges.

    Example:
        >>> pair = nts.ContactPair(nodes=bottom, segments=top)
        >>> stepper = nts.EnergyMomentum([body, other], [pair], dt=0.01)
        >>> round(float(np.nanmin(pair.gap(stepper.x))), 3)  # m
        0.01
    """

    def __init__(
        self,
        nodes: Surface,
        segments: Surface | Obstacle,
        enforcement: LagrangeMultiplier | Penalty | None = None,
        friction: FrictionLaw | float | None = None,
        method: Method | None = None,
        *,
        name: str = "",
        exchange: bool = True,
    ) -> None:
        if not isinstance(nodes, Surface):
            raise TypeError(
                f"expected a Surface as nodes, such as boundary_of(body), given {kind_of(nodes)}"
            )
        if not isinstance(segments, Surface | Obstacle):
            raise TypeError(
                "expected a Surface, such as boundary_of(body), or an obstacle as segments, given "
                f"{kind_of(segments)}"
            )
        is_open = enforcement is None
        if enforcement is None:
            enforcement = Penalty()
        if not isinstance(enforcement, LagrangeMultiplier | Penalty):
            raise TypeError(
                "expected LagrangeMultiplier or Penalty as enforcement, "
                f"given {kind_of(enforcement)}"
            )
        rubs = None if friction is None else friction_law(friction)
        convective = rubs is not None and rubs.law == "convective"
        if convective and not (isinstance(enforcement, Penalty) and isinstance(segments, Surface)):
            raise ValueError(
                "expected Penalty and a Surface as segments with convective friction, given "
                f"{type(enforcement).__name__} and {type(segments).__name__}"
            )
        self.nodes, self.segments, self.enforcement = nodes, segments, enforcement
        # Friction with mu = 0 is omitted.
        self.friction = rubs if rubs is not None and rubs.acts else None
        self.touches_itself = isinstance(segments, Surface) and _check_surfaces(nodes, segments)
        if not isinstance(exchange, bool):
            raise TypeError(f"expected exchange=True or False, given {exchange!r}")
        self.name, self.exchange = label(name), exchange
        self.method: Method = default_method(self) if method is None else method
        # Only springs measure slip in convective coordinates.
        self._law_is_open = is_open and not convective
        self._method_is_open = method is None
        self._declared: ContactPair | None = None
        check_method(self)
        check_tie(self)
        check_dimension(self)
        check_smooth(self)
        if method == EDGES:
            _check_edges(nodes, self.segments)
        if self.friction is not None:
            with agreed(nodes.V.mesh.comm, "evaluate friction"):
                check_law(self.friction, nodes)
        self._states: WeakSet[AcceptedContact] = WeakSet()

    def with_defaults(
        self, enforcement: LagrangeMultiplier | Penalty, *, nodal: bool = False
    ) -> "ContactPair":
        """Copy of the pair with the defaults of a stepper for laws that were not given. Local.

        Args:
            enforcement: Law of normal contact.
            nodal: Whether the default method is node-to-segment contact.

        Returns:
            A pair that shares the states of this pair; the pair itself if all laws were given.
        """
        method = NODES if nodal and self._method_is_open else self.method
        enforcement = enforcement if self._law_is_open else self.enforcement
        if method == self.method and enforcement is self.enforcement:
            return self
        pair = copy(self)
        # The copy shares the list of states with the declaration.
        vars(pair).update(enforcement=enforcement, method=method, _declared=self.declared)
        return pair

    @property
    def has_defaults(self) -> bool:
        """Whether the law or the method was left to the stepper. Local."""
        return self._law_is_open or self._method_is_open

    @property
    def declared(self) -> "ContactPair":
        """Pair that was given to the stepper, of which this may be a copy. Local."""
        return self._declared or self

    def attach(self, state: AcceptedContact) -> None:
        """Attach the state of a stepper, as long as it exists. Local."""
        self._states.add(state)

    @property
    def history(self) -> ContactHistory:
        """Contact of the last step of the stepper that uses the pair. Local.

        Raises:
            ValueError: No stepper uses the pair, or several do; also for `pressure` and `gap`.
        """
        state = self._only()
        history, place = state.history, self._places(state)
        if place is None:
            return history
        return history.at(len(self.nodes.nodes), place, **vars(history))

    @property
    def pressure(self) -> Floats:
        """Contact pressure of the last step at the nodes, shape ``(n,)`` [Pa, >= 0].

        If the stepper also has the opposite pair, as with `two_half_passes`, it is the sum over
        both pairs. Collective, see `history` and `Surface.per_area`.
        """
        state = self._only()
        return self._at_nodes(state, state.pressure, 0.0)

    def gap(self, x: Floats, reach: float = np.inf) -> Floats:
        """Gap of every node, NaN without a segment. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and ghost, shape ``(l, 3)`` [m].
            reach: Largest distance of segments [m].

        Returns:
            Gap, shape ``(n,)`` [m], > 0 open.

        Raises:
            ValueError: See `history`.
        """
        state = self._only()
        return self._at_nodes(state, state.gap(x, reach), np.nan)

    def _places(self, state: AcceptedContact) -> Ints | None:
        """Indices of the nodes of a state in this pair; None for all nodes. Local."""
        own, nodes = self.nodes.nodes, state.nodes.nodes
        return None if len(own) == len(nodes) else np.searchsorted(own, nodes).astype(np.int32)

    def _at_nodes(self, state: AcceptedContact, values: Floats, otherwise: float) -> Floats:
        """Values of a state at all nodes, ``(n,)``; ``otherwise`` at nodes that are not in it."""
        if (place := self._places(state)) is None:
            return values
        of_all = np.full(len(self.nodes.nodes), otherwise)
        of_all[place] = values
        return of_all

    def _only(self) -> AcceptedContact:
        """State of the pair in the only stepper that uses it."""
        if len(self._states) != 1:
            raise ValueError(
                f"expected a contact pair of one stepper, given one of {len(self._states)} "
                "steppers: use the item of stepper.contacts for this pair, as long as the stepper "
                "exists"
            )
        state: AcceptedContact = next(iter(self._states))
        return state

    @property
    def segment_size(self) -> float:
        """Longest segment [m]; with an obstacle, longest facet of the nodal surface. Local."""
        return (self.segments if isinstance(self.segments, Surface) else self.nodes).size

    @property
    def between(self) -> str:
        """Names of the two sides and of the pair, for messages. Local."""
        other = "itself" if self.touches_itself else self.segments.name
        sides = f"{self.nodes.name} and {other}"
        # A name that only repeats words of the sides is omitted.
        says_more = not set(self.name.split()) <= set(sides.split())
        return f"{sides} (pair {self.name!r})" if says_more else sides

    @property
    def has_slip_spring(self) -> bool:
        """Whether friction has tangential springs. Local."""
        return self.friction is not None and (
            self.friction.eps_T is not None or isinstance(self.enforcement, Penalty)
        )

    @property
    def is_convective(self) -> bool:
        """Whether slip is measured in convective coordinates. Local."""
        return self.friction is not None and self.friction.law == "convective"

    def __repr__(self) -> str:
        """Arguments; a law and a method only if they are known. Local."""
        is_open = {
            "enforcement": self._law_is_open and self._declared is None,
            "method": self._method_is_open and self._declared is None,
        }
        names = ("nodes", "segments", "enforcement", "friction", "method")
        known = {name: getattr(self, name) for name in names if not is_open.get(name)}
        given: dict[str, Any] = {"name": self.name} if self.name else {}
        given |= {} if self.exchange else {"exchange": False}
        return as_call(self, **known, **given)

    def __str__(self) -> str:
        """Laws and, while one stepper uses the pair, the stiffness of springs. Local."""
        if len(self._states) == 1:
            return str(self._only())
        return self.describe()

    def describe(self) -> str:
        """Laws of contact and friction in words. Local."""
        law = type(self.enforcement).__name__
        if self.method == EDGES and self._law_is_open and self._declared is None:
            law = "the default of the stepper"
        text = f"{KINDS[self.method]} by {law}"
        if self.friction is not None:
            text += f", {self.friction.describe()}"
        return text


def is_in_use(pair: ContactPair) -> bool:
    """Whether a stepper uses a pair. Local."""
    return len(pair._states) > 0


def _check_edges(*surfaces: Surface | Obstacle) -> None:
    """Check that both surfaces have sharp edges. Collective."""
    for surface in surfaces:
        if not num_sharp_edges(surface):
            raise ValueError(
                "expected surfaces with convex edges of 30 degrees or more with method "
                f"{EDGES!r}, given {surface.name} without any: facets on both sides of an edge "
                "must belong to the surface, as in boundary_of, or to the RigidSurface"
            )


def _check_surfaces(nodes: Surface, segments: Surface) -> bool:
    """Check the surfaces of a pair; returns whether they are the same. Collective.

    Segments with degenerate corners are logged.
    """
    if nodes.V != segments.V:
        raise ValueError("expected nodes and segments in one function space, given two")
    comm = nodes.V.mesh.comm
    shared = reductions.total(comm, len(np.intersect1d(nodes.nodes, segments.nodes)))
    same = np.array_equal(nodes.segments, segments.segments)
    same = reductions.everywhere(comm, same)
    if shared and not same:
        raise ValueError(
            "expected surfaces without common nodes in a contact pair, or the same surface "
            f"twice, given {shared} nodes on both sides, where bodies are bonded: leave the facets "
            "with these nodes out of one surface, as boundary_of(body, where=...) does"
        )
    sine = sharpest_corner(segments)
    if sine < _SHARP and comm.rank == 0:
        _logger.warning(
            "segments of %s have a corner with an angle of sine %.2g, where the normal is "
            "undefined: harmless if no node comes to that corner, otherwise repair the mesh (an "
            "edge of length zero?)",
            segments.name,
            sine,
        )
    return same
