"""Contact forces, areas and gaps of the pairs of a stepper."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import contact_sums
from dolfinx_nts.diagnostics.body_forces import BodyForces
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.diagnostics.names import ByName, flat, pair_names, part_names
from dolfinx_nts.fem.components import bounds, existing, in_space, nodal
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.collective_calls import collective
from dolfinx_nts.search.overlap.overlaps import Overlap

__all__ = ["ContactDiagnostics", "ObstacleBalance", "PairBalance"]


@dataclass(frozen=True)
class PairBalance:
    """Contact of one pair in the last step, the same on all ranks.

    Attributes:
        force: Resultant on the nodes, shape ``(3,)``, in the plane ``(2,)``, axisymmetric ``(1,)``,
            along y [N].
        torque: Torque about the origin on the nodes, shape ``(3,)``, in the plane ``(1,)``, about
            z, axisymmetric ``(0,)`` [N m].
        contact_area: Reference area of the nodes that transmit or receive force [m^2].
        largest_pressure: Largest contact pressure of a node [Pa].

    Example:
        >>> steps = list(stepper.run(until=0.02))
        >>> pair = nts.Diagnostics(stepper).pairs()["upper_bottom_lower_top"]
        >>> print(pair.force[2] > 0, pair.contact_area > 0, pair.largest_pressure > 0)
        True True True
    """

    force: Floats
    torque: Floats
    contact_area: float
    largest_pressure: float

    def columns(self, prefix: str) -> dict[str, float]:
        """All quantities by name, with a prefix. Local."""
        return flat(prefix, vars(self))


@dataclass(frozen=True)
class ObstacleBalance:
    """Contact of a rigid obstacle in the last step, the same on all ranks.

    With `EnergyMomentum` the work of a moving obstacle on the bodies has two terms: minus force
    times displacement of the centre of its motion, and minus torque times 2 tan(angle/2) about the
    axis of its rotation in the step.

    Attributes:
        force: Resultant on the obstacle by all pairs with it, shape ``(3,)``, in the plane
            ``(2,)``, axisymmetric ``(1,)``, along y [N].
        torque: Torque on it, shape ``(3,)``, in the plane ``(1,)``, about z, axisymmetric ``(0,)``
            [N m]: about the centre of the motion at the midpoint of the step, or about the origin
            if the obstacle does not move.

    Example:
        >>> down = nts.Motion(translation=lambda t: (0.0, 0.0, -t))
        >>> lid = nts.RigidPlane(point=(0, 0, 2.2), normal=(0, 0, -1)).moving(down)
        >>> lid.name
        'a moving RigidPlane'
    """

    force: Floats
    torque: Floats

    def columns(self, prefix: str) -> dict[str, float]:
        """All quantities by name, with a prefix. Local."""
        return flat(prefix, vars(self))


@collective
class ContactDiagnostics:
    """Evaluates the contact of a stepper's last step. Collective, as are all its methods.

    Args:
        stepper: The stepper.

    Attributes:
        stepper: The argument.
    """

    def __init__(self, stepper: Stepper) -> None:
        self.stepper = stepper
        self._V = stepper.u.function_space
        # Ranges of the components of vectors and moments in the space.
        self._axes = existing(self._V)
        self._comm: MPI.Comm = self._V.mesh.comm
        self._pair_names = pair_names(stepper.pairs)
        self._has_obstacles = any(isinstance(pair.segments, Obstacle) for pair in stepper.pairs)
        self._body_forces = BodyForces(stepper)
        names = part_names("body", (body.name for body in stepper.bodies))
        self._between = [f"{names[a]}_{names[b]}" for a, b in self._body_forces.pairs]
        self._shared: CurrentState | None = None

    @contextmanager
    def one_state(self) -> Iterator[CurrentState]:
        """Share intermediate results between several methods while the state does not change.

        After a step within the context the methods evaluate the new state.

        Returns:
            Context of the current state.

        Example:
            >>> diagnostics = nts.Diagnostics(stepper)
            >>> with diagnostics.one_state():
            ...     balance, pairs = diagnostics.balance(), diagnostics.pairs()
        """
        self._shared = CurrentState(self.stepper)
        try:
            yield self._shared
        finally:
            self._shared = None

    def _now(self) -> CurrentState:
        """Cache of the current state."""
        if self._shared is None or self._shared.step != self.stepper.step:
            return CurrentState(self.stepper)
        return self._shared

    def contact_energy(self) -> float:
        """Energy of penalty and friction springs [J]."""
        return float(self._of_pairs()[:, 0].sum())

    def contact_force(self) -> Floats:
        """Resultant of the last step on the nodes of all pairs, as in a `Balance` [N]."""
        force: Floats = self._of_pairs()[:, 3:6].sum(axis=0)[self._axes[0]]
        return force

    def pair_resultants(self) -> Floats:
        """Force [N] and torque [N m] of the last step on the nodes of each pair, ``(p, 2, 3)``.

        They have three components also in the plane. The torque is about the origin, with the
        positions at which the forces of the scheme act: at the midpoint of the step, or at its end
        in `QuasiStatic`, `CentralDifference` and `GeneralizedAlpha`.
        """
        return self._of_pairs()[:, 3:].reshape(-1, 2, 3)

    def pairs(self) -> dict[str, PairBalance]:
        """Contact of each pair in the last step, by the names of its two sides."""
        areas = self._of_pairs()[:, 2]
        pressures = np.array([p.max(initial=0.0) for p in self._now().pressures])
        # Inactive nodes next to vertices of the other side receive forces, too.
        further = np.array([area.sum() for area in self._now().further_areas])
        largest = reductions.largest(self._comm, np.array([pressures, further]))
        if largest[1].any():
            areas = areas + self._sum(further)
        vectors = [self._parts(pair) for pair in self.pair_resultants()]
        of_pairs = zip(vectors, map(float, areas), map(float, largest[0]), strict=True)
        balances = (PairBalance(*parts, *scalars) for parts, *scalars in of_pairs)
        return ByName("pair", self._pair_names, balances)

    def obstacles(self) -> dict[str, ObstacleBalance]:
        """Contact of each rigid obstacle in the last step, by its name."""
        stepper, totals = self.stepper, dict[Obstacle, Floats]()
        if not self._has_obstacles:
            return {}
        by_pair = self.pair_resultants()
        for number, pair in enumerate(stepper.pairs):
            obstacle = pair.segments
            if isinstance(obstacle, Obstacle):
                force, torque = by_pair[number]
                centre = obstacle.motion.frame(stepper.t_n, stepper.t, obstacle.dim).centre
                on_nodes = np.array([force, torque - np.cross(centre, force)])
                totals[obstacle] = totals.get(obstacle, 0.0) - on_nodes
        names = part_names("obstacle", (obstacle.name for obstacle in totals))
        balances = (ObstacleBalance(*self._parts(total)) for total in totals.values())
        return ByName("obstacle", names, balances)

    def between(self) -> dict[str, Floats]:
        """Contact forces between any two bodies in the last step, by their names [N].

        The key ``left_ball`` has the force on ``left`` by ``ball``, summed over all pairs of
        surfaces. Bodies are in the order in which the stepper has them, so that neither key nor
        sign depends on how pairs divide them into nodes and segments. Vectors have the components
        that exist in the space. A force is NaN where edge-to-edge contact of several bodies on
        one side does not show which of them touch.
        """
        forces = self._all_sums()[1][:, self._axes[0]]
        return ByName("force between bodies", self._between, forces)

    def active_nodes(self) -> int:
        """Number of nodes that transmit force, on all ranks."""
        return int(self._of_pairs()[:, 1].sum())

    def min_gap(self) -> float:
        """Smallest gap of all pairs [m]; NaN if no node has a candidate segment.

        If the last step has found penetrated nodes, their gaps are reused. Otherwise the search is
        limited to the smallest gap so far plus one facet, and pairs whose bounding boxes are
        farther apart are skipped. The limit is lifted if no node finds a segment.
        """
        now, pairs, least = self._now(), self.stepper.contacts, np.inf
        if now.has_gaps:
            least = min(map(_smallest_gap, now.gaps()), default=np.inf)
            least = reductions.least(self._comm, least)
            return least if least < np.inf else np.nan
        if (known := self.stepper.known_gaps()) is not None:
            least = reductions.least(self._comm, min(map(_smallest_gap, known), default=np.inf))
            if least < 0:  # all other gaps are >= 0
                return float(least)
            least = np.inf
        x = now.x
        nearest, farthest = self._distances(x)
        for i in np.argsort(nearest, kind="stable"):
            pair, size = pairs[i], pairs[i].pair.segment_size
            # The closest point may be outside of the facet by up to its size.
            limit = min(least, farthest[i]) + size
            # The radius is small at first, since nodes without a candidate test all segments within
            # it.
            reach = limit if nearest[i] < 0 else min(nearest[i] + size, limit)
            while nearest[i] <= limit:
                gap = pair.gap(x, reach)
                own = reductions.least(self._comm, _smallest_gap(gap))
                enough = min(own + size, limit)
                if reach >= enough:
                    least = min(least, own)
                    break
                # In an unlimited search, nodes without a candidate are excluded quickly.
                reach = enough if own < np.inf else np.inf
        return least if least < np.inf else np.nan

    def overlaps(self) -> list[Overlap]:
        """Find bodies that overlap each other, themselves or obstacles, with or without pairs.

        Bodies that share nodes count as one. In self overlaps only nodes and midpoints of facets
        are tested, not crossing edges. Quadrilateral facets are split into two triangles. The
        overlap with a `RigidSurface` is searched to a depth of half a facet.

        Returns:
            One `Overlap` for any two bodies that overlap; empty if bodies only touch.
        """
        return self.stepper.watch.overlaps.search.find(self.stepper.x, t=self.stepper.t)[0]

    def _distances(self, x: Floats) -> tuple[Floats, Floats]:
        """Smallest and largest distances between nodes and segments of the pairs, ``(p,)`` [m].

        They are distances of bounding boxes. For obstacles they are negative, so that these pairs
        are evaluated first: their gaps need no search.
        """
        pairs = self.stepper.contacts
        # Smallest coordinates of nodes and segments, and smallest negated coordinates.
        least: Any = np.empty((len(pairs), 2, 2, 3))
        least[:, :, 0], least[:, :, 1] = np.inf, -np.inf
        for box, pair in zip(least, pairs, strict=True):
            for part, surface in zip(box, (pair.nodes, pair.segments), strict=True):
                if isinstance(surface, Surface):
                    part[:] = bounds(x, surface.nodes)
        least[:, :, 1] *= -1
        least = reductions.least(self._comm, least)
        lower, upper = least[:, :, 0], -least[:, :, 1]
        has_box = np.isfinite(least).all(axis=(1, 2, 3))
        lower, upper = (np.where(has_box[:, None, None], ends, 0.0) for ends in (lower, upper))
        apart = np.maximum(lower, lower[:, ::-1]) - np.minimum(upper, upper[:, ::-1])
        nearest = np.linalg.norm(np.maximum(apart[:, 0], 0.0), axis=1)
        farthest = np.linalg.norm(upper.max(axis=1) - lower.min(axis=1), axis=1)
        return np.where(has_box, nearest, -1.0), np.where(has_box, farthest, np.inf)

    def _of_pairs(self) -> Floats:
        return self._all_sums()[0]

    def _all_sums(self) -> tuple[Floats, Floats]:
        """Sums over all nodes, see `CurrentState.contact_sums`."""
        now = self._now()
        if now.contact_sums is None:
            now.contact_sums = self._sums_by_pair(self._sum(self._of_own_nodes()))
        return now.contact_sums

    def _sums_by_pair(self, sums: Floats) -> tuple[Floats, Floats]:
        """Sums of the pairs, shape ``(p, 9)``, and forces between bodies, ``(b, 3)`` [N]."""
        size = 9 * len(self.stepper.contacts)
        return sums[:size].reshape(-1, 9), sums[size:].reshape(-1, 3)

    def _of_own_nodes(self) -> Floats:
        """Sums over the nodes of this rank, see `_sums_by_pair`. Collective."""
        stepper, x = self.stepper, self._now().x
        if stepper.scheme.contact != "static":
            x = x - in_space(nodal(stepper.u) - nodal(stepper.u_n)) / 2
        sums: Any = np.empty((len(stepper.contacts), 9))
        for numbers, contact in zip(sums, stepper.contacts, strict=True):
            numbers[:] = contact_sums(contact.history, x, contact.nodes.nodes, contact.area)
            for vertices in contact.vertices:
                nodes = vertices.nodes.nodes
                other = contact_sums(vertices.history, x, nodes, np.zeros(len(nodes)))
                other[3:] *= -1 if vertices.is_reverse else 1  # forces on the nodes of the pair
                numbers += other
        return np.concatenate([sums.ravel(), self._body_forces.of_own_nodes().ravel()])

    def _parts(self, vectors: Floats) -> tuple[Floats, Floats]:
        """Components of force and torque, shape ``(2, 3)``, that exist in the space."""
        force, torque = vectors
        return force[self._axes[0]], torque[self._axes[1]]

    def _sum(self, values: Any) -> Any:
        return reductions.total(self._comm, values)


def _smallest_gap(gap: Floats) -> float:
    """Smallest gap of this rank's nodes [m], infinite if there is none."""
    return float(np.fmin.reduce(gap, initial=np.inf))
