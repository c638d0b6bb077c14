"""Evaluation of mortar contact: nodal multipliers act on the surrounding quadrature points."""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.contact.friction.mortar_slip import NodalFrames, mean_slip
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.mortar.eliminated import EliminatedDofs
from dolfinx_nts.contact.implicit.pair_blocks import PairBlocks
from dolfinx_nts.contact.implicit.pairing import Pairing
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.search.candidates import contact_normals
from dolfinx_nts.search.mortar.facet_candidates import outside
from dolfinx_nts.search.mortar.mortar_points import MortarPoints, at_nodes
from dolfinx_nts.search.mortar.mortar_search import MortarCandidates

__all__ = ["MortarPairing", "PointBlocks"]

# Largest distance of a point from its segment, in coordinates of the reference segment [-].
_BEYOND = _kernels.OVERHANG
# Number of cached subsets of the points [-]. More: memory; fewer (1): each iteration selects points
# of the same nodes twice, which takes 15 % of a step of a ball on a plate.
_MOST_SUBSETS = 4


class MortarPairing(Pairing):
    """Evaluates pairs of mortar contact: nodes with the quadrature points around them.

    Args:
        candidates: Facets of the points, and their candidate segments.
        points: Contact points of all nodes of the surface.
        x_n: Positions at t_n, shape ``(l, 3)`` [m].
        x_chosen: Positions for which the points were chosen, of the same shape [m].

    Attributes:
        x_chosen: The argument.
    """

    follows = False

    def __init__(
        self,
        candidates: MortarCandidates,
        points: MortarPoints,
        x_n: Floats,
        x_chosen: Floats,
    ) -> None:
        self.x_chosen = x_chosen
        self.area = points.shares.area
        self.reached = np.concatenate(
            [candidates.facets.facet_nodes.ravel(), candidates.facet_nodes.ravel()]
        )
        self._candidates, self._points, self._x_n = candidates, points, x_n
        # Cached points of the nodes of the last calls of `gaps` and `kinematics`.
        self._subsets: dict[bytes, MortarPoints] = {}
        # Points and positions of the last evaluation, with positions of the points and their facets
        # at t_n and in that state.
        self._evaluated: MortarPoints | None = None
        nowhere: Floats = np.empty((0, 3))
        self._x, self._pairs_n, self._pairs = nowhere, nowhere, nowhere
        # Frames of the nodes, computed with the first slip.
        self._frames: NodalFrames | None = None

    def _of(self, node: Ints) -> MortarPoints:
        """Contact points of the given nodes."""
        if len(node) == len(self.area):
            return self._points
        key = node.tobytes()
        if key not in self._subsets:
            if len(self._subsets) == _MOST_SUBSETS:
                del self._subsets[next(iter(self._subsets))]
            self._subsets[key] = self._points.take(node)
        return self._subsets[key]

    def gaps(self, x: Floats, node: Ints, segment: Ints) -> Floats:
        points = self._of(node)
        gap = self._candidates.gap(points, x, points.segment) + points.offset
        return points.shares.mean(gap)

    def kinematics(
        self, scheme: str, x: Floats, node: Ints, segment: Ints, free: Floats | None
    ) -> PairKinematics:
        points, candidates = self._of(node), self._candidates
        ends = self._ends(points, x)
        contact = candidates.contact_between(scheme, *ends, points.segment)
        blocks = PointBlocks(points, candidates, free, contact.tangent)
        mean = _of_nodes(points, contact)
        unknown = None if free is None else free[points.lists].reshape(mean.force.shape)
        return PairKinematics(node, segment, unknown, mean, blocks)

    def exchanged(self, x: Floats) -> "MortarPairing":
        return MortarPairing(self._candidates, self._points, x, self.x_chosen)

    def slip(self, measure: str, x: Floats, node: Ints, segment: Ints) -> Slip:
        points = self._of(node)
        slip = self._candidates.slip_between(*self._ends(points, x), points.segment)
        if self._frames is None:
            self._frames = NodalFrames.of(points, slip)
        return mean_slip(points, slip, self._frames)

    def least_faced(self, values: Floats) -> Floats:
        """Minimum over the segments at the points of each node, see `LocalSearch`. Local."""
        points = self._points
        of_points = values[points.segment % max(len(values), 1)]
        return points.shares.reduced(np.minimum, of_points[points.shares.point], np.inf)

    def facing_normals(self) -> Floats:
        """Mean normals of contact at t_n over the points of each node, ``(n, 3)``. Local.

        The normal of one of their segments would depend on the numbering.
        """
        points = self._points
        normals = contact_normals(self._candidates, points, self._x_n, points.segment)
        means = np.column_stack([points.shares.mean(values) for values in normals.T])
        return _kernels.unit_vectors(np.nan_to_num(means))

    def _ends(self, points: MortarPoints, x: Floats) -> tuple[Floats, Floats]:
        """Positions of points and facets at t_n and at x, shapes ``(p, 1+n, 3)`` [m]."""
        pairs, segment = self._candidates.pairs, points.segment
        if points is not self._evaluated:
            self._evaluated, self._frames = points, None
            self._pairs_n = pairs(points, self._x_n, segment)
            self._pairs, self._x = self._pairs_n, self._x_n
        if x is not self._x:
            self._pairs, self._x = pairs(points, x, segment), x
        return self._pairs_n, self._pairs

    def on_nodes(self, pairs: PairKinematics, force: Floats) -> Floats:
        """Sum up the forces of all multipliers on the nodes of the facets."""
        facets, scatter = self._candidates.facets, self._candidates.scatter
        forces = force.reshape(*pairs.dofs.shape, 3) * ~self.on_segments(pairs)[:, :, None]
        total = np.zeros((scatter.index_map.size_local, 3))
        scatter.add(total, pairs.dofs, forces)
        return total[facets.nodes]

    def on_segments(self, pairs: PairKinematics) -> Flags:
        on_facet = np.zeros(self._candidates.scatter.num_local, dtype=bool)
        on_facet[self._candidates.facets.facet_nodes] = True
        return ~on_facet[pairs.dofs]

    def is_same(self, pairs: PairKinematics) -> Flags:
        """True for all nodes, since mortar contact assigns no segments to nodes."""
        return np.ones(len(pairs.node), dtype=bool)

    def num_beyond(self, x: Floats, node: Ints) -> int:
        now = self._outside(x, node)
        if not (now > _BEYOND).any():
            return 0
        # If facet and segment are not parallel, a point may initially be outside its segment.
        before = np.fmax(self._outside(self.x_chosen, node), 0.0)
        return int(np.count_nonzero(now > before + _BEYOND))

    def _outside(self, x: Floats, node: Ints) -> Floats:
        """Distances of the points of nodes from the reference segment, shape ``(p,)`` [-]."""
        points = self._of(node)
        return outside(self._candidates, points, x, points.segment)

    def places(self, x: Floats, node: Ints) -> Floats:
        """Convective coordinates of quadrature points on their segments, ``(p, 2)`` [-]."""
        points = self._of(node)
        xi, *_ = self._candidates.projections(points, x, points.segment)
        return xi


class PointBlocks(PairBlocks):
    """Blocks of the points of one facet on one segment, which couple neighbouring multipliers.

    Args:
        points: Contact points of the pairs' nodes.
        candidates: Facets of the points, and segments.
        free: 1 where the displacement of a node is unknown, otherwise 0, shape ``(l, 3)``; None if
            all are unknown.
        tangent: Derivative of the forces of the points, shape ``(p, 3 (1+k), 3 (1+k))`` [1/m].

    Attributes:
        eliminated: Eliminated displacements of the nodes.
    """

    may_overlap = True

    def __init__(
        self,
        points: MortarPoints,
        candidates: MortarCandidates,
        free: Floats | None,
        tangent: Floats,
    ) -> None:
        self._points, self._tangent = points, tangent
        self._scatter, self._free = candidates.scatter, free
        self.dofs, self.nodes = points.lists, points.patch_nodes
        self.eliminated = EliminatedDofs(candidates, free, self.dofs)

    def tangent(self, lambda_N: Floats) -> Floats:
        force = self._points.shares.spread(lambda_N, len(self._tangent))
        return self._points.blocks(force, self._tangent)

    def of(self, active: Flags) -> Ints:
        shares = self._points.shares
        return np.unique(self._points.patch[shares.point[active[shares.node]]])

    def restrict(self, force: Floats, tangent: Floats) -> Floats:
        if self._free is None:
            return force
        free = self._free[self.nodes].reshape(tangent.shape[:2])
        tangent *= free[:, :, None] * free[:, None, :]
        return force * self._free[self.dofs].reshape(force.shape)

    def gathered(self, force: Floats) -> Floats:
        return self.eliminated.gather(force)

    def balance(
        self,
        normal: Floats,
        force: Floats,
        columns: Floats,
        rank: Ints,
        friction: tuple[Floats, Floats] | None,
    ) -> Floats:
        if friction is not None:
            known, direction = friction
            tractions = np.einsum("mi,mid->md", known, columns[:, 1:])
            total = np.zeros((self._scatter.index_map.size_local, 3))
            self._scatter.add(total, self.dofs, tractions.reshape(*self.dofs.shape, 3))
            force = force + self.gathered(total)
            columns = _kernels.with_friction(columns, direction)
        system = self.eliminated.system(rank, columns, normal, transposed=True)
        solution = system.solve(-np.einsum("mi,mci->mc", force, system.directions))
        multipliers = np.zeros((len(rank), 3))
        # If this system is singular, the global linear system determines the multipliers.
        multipliers[:, : solution.shape[1]] = np.where(np.isfinite(solution), solution, 0.0)
        return multipliers

    def close_gaps(
        self,
        normal: Floats,
        gradients: Floats,
        gap: Floats,
        moves: Flags,
        farthest: Floats,
        u: Floats,
    ) -> None:
        rank = moves.astype(np.int32)
        system = self.eliminated.system(rank, gradients, normal)
        distance = system.solve(gap[:, None])[:, 0]
        # A singular system has no finite solution: such nodes do not move.
        near = moves & (np.where(np.isnan(distance), np.inf, np.abs(distance)) <= farthest)
        increment = -np.where(near, distance, 0.0)[:, None] * normal
        self.eliminated.move(increment[:, : u.shape[1]], u)


def _of_nodes(points: MortarPoints, contact: ContactKinematics) -> ContactKinematics:
    """Kinematics of nodes as sums over their points; tangents stay separate for each point."""
    gap_n, gap, force, gradient, turn = at_nodes(points, contact)
    return ContactKinematics(gap_n, gap, force, gradient, contact.tangent, turn)
