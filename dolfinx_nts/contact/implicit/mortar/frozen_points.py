"""Quadrature points of mortar contact, fixed within a step.

The points and their segments are chosen at the trial positions without contact, and are kept in
the step. The force of each multiplier is then a sum of discrete gradients with constant weights,
and does no work while the mean gap is constant.
"""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.contact.enforcement import TOUCHES
from dolfinx_nts.contact.implicit.local_search import LATE, Approach, LocalSearch, penetrated_nodes
from dolfinx_nts.contact.implicit.mortar.mortar_pairing import MortarPairing
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.mortar.facet_points import FacetPoints
from dolfinx_nts.search.mortar.mortar_points import MortarPoints
from dolfinx_nts.search.mortar.mortar_search import MortarCandidates

__all__ = ["FrozenPoints", "SettlingPoints", "TiedPoints"]

# Displacement of points between their choice and equilibrium, in coordinates of the reference
# segment [-], that counts as zero in statics.
_SETTLED = 1e-6
# Change of the fraction of dual functions [-] between two choices of points that counts as zero.
# Larger: inaccurate mean gaps of loaded nodes; smaller: statics takes more iterations.
_SETTLED_FRACTION = 0.05


class FrozenPoints(LocalSearch):
    """Quadrature points of a mortar pair.

    Attributes as for `LocalSearch`, with mean gaps of nodes and one representative segment of the
    points of each node.

    Args:
        state, x_n, x_trial: As for `LocalSearch`.
        x_points: Positions at which the points are chosen, shape ``(l, 3)`` [m].
    """

    candidates: MortarCandidates
    pairing: MortarPairing
    # Largest number of times that points are chosen again in a step [-]. More: steps that fail take
    # longer; fewer (2): points have slid off their segments in some impacts on corners.
    _most_renewals = 6
    # Whether facets opposite kinks of the segments have linear instead of dual functions.
    _has_kinks = True
    # Whether points may slide over several segments in a step. With inertia, forces keep the gap at
    # t_n, and gaps to the extension of bent segments would drift (by 0.16 segments in 16 steps of
    # 3 segments each).
    _slides_far = False
    # Whether inactive nodes that have points must not penetrate. In an impact they may penetrate in
    # the step in which they touch.
    _is_static = False
    # Gap relative to the size of a segment [-] above which the position of points is irrelevant
    # at nodes without force.
    _nearby = 0.01

    def __init__(
        self, state: PairState | JointState, x_n: Floats, x_trial: Floats, x_points: Floats
    ) -> None:
        super().__init__(state, x_n, x_trial)
        self._V, old = state.nodes.V, state.history
        # Nodes that transmit force or are inside, and fractions of dual functions in the last step.
        self._is_held: Flags = old.active | (old.gap < np.fmax(old.offset, 0.0))
        self._last_fraction: Floats = old.dual_fraction
        self._comm: MPI.Comm = state.nodes.V.mesh.comm
        self._every = np.arange(len(state.nodes.nodes), dtype=np.int32)
        self._renewals = 0
        # Largest fraction of dual functions around each node [-].
        self._dual_fraction: Floats = np.ones(len(self._every))
        self._slack = TOUCHES * state.pair.nodes.size
        self._is_resolved, self._is_stiff = is_resolved(state.pair), state.eps_N is None
        self._choose(self.candidates.scatter.forward(state.search.frame.at_end(x_points)))

    @staticmethod
    def _additional_reach(pair: ContactPair) -> float:
        # Facets extend beyond their owned nodes, also when they are stretched.
        return 2 * pair.nodes.size

    def _choose(self, x: Floats) -> None:
        """Choose points at positions with ghosts, shape ``(l, 3)`` [m]."""
        self._take(self.x_n, x)

    def _take(self, x_n: Floats, x: Floats) -> None:
        ends = x_n, x
        kinks = self._has_kinks and not self._is_resolved
        found = FacetPoints.choose(
            *(self.candidates.facets, self.candidates, *ends, self._open_reach),
            kinks=kinks,
            slides_far=self._slides_far,
        )
        fraction = self._dual_fractions(found, x_n, x)
        if self._renewals > 1:
            # Fractions converge sooner if they cannot increase again.
            fraction = np.where(self._must_be_reduced(fraction), fraction, self._dual_fraction)
        self._found, self._dual_fraction = found, fraction
        points = self._points(found, fraction, x)
        self.pairing = MortarPairing(self.candidates, points, self.x_n, x.copy())
        # The segment with the lowest number represents the segments of the points of a node.
        self.segment = points.shares.first(points.segment % len(self.candidates.segments))
        every, trial = self._every, self.approach.x
        gap_n, gap_trial = (
            self.pairing.gaps(end, every, self.segment) for end in (self.x_n, trial)
        )
        self.approach = Approach(self.segment, gap_n, gap_trial, trial)
        self.gap = gap_n.copy()

    @property
    def dual_fraction(self) -> Floats:
        return self._dual_fraction

    def _facing_normals(self) -> Floats:
        return self.pairing.facing_normals()

    def _dual_fractions(self, found: FacetPoints, x_n: Floats, x: Floats) -> Floats:
        """Largest fractions of dual functions in the shape functions of nodes, shape ``(n,)``.

        In resolved impact they do not depend on gaps: fractions that change between steps reduce
        the order of convergence in time from 2.7 to 0.6. Around loaded nodes fractions do not
        increase: mean gaps would decrease without motion, and resting bodies, whose springs follow
        their gaps, would penetrate further in each step. Gaps at x, without contact forces, are
        ignored there.
        """
        if self._is_resolved:
            return np.ones(len(self._every))
        at_n, at_x = (found.largest_dual_fractions((each,), self._slack) for each in (x_n, x))
        held = found.on_facets_of(self._is_held)
        fraction: Floats = np.fmin(at_n, np.where(held, self._last_fraction, at_x))
        return fraction

    def _points(self, found: FacetPoints, fraction: Floats, x: Floats) -> MortarPoints:
        """Points with shares of the nodes, chosen at x.

        At kinks their weights depend on gaps at t_n, since gaps at x, without contact forces, do
        not indicate which facet presses.
        """
        return found.points(fraction, self.x_n, self._slack, is_stiff=self._is_stiff)

    def _must_be_reduced(self, fraction: Floats) -> Flags:
        """Whether the fractions of dual functions have to be reduced, shape ``(n,)``."""
        flags: Flags = fraction < self._dual_fraction - _SETTLED_FRACTION
        return flags

    def least_faced(self, values: Floats) -> Floats:
        return self.pairing.least_faced(values)

    def find(self, x: Floats, node: Ints, iteration: int) -> tuple[Ints, Flags]:
        # The points are kept; their gaps are not computed here.
        return self.segment[node], np.zeros(len(node), dtype=bool)

    def reproject(self, x: Floats, node: Ints, active: Flags, converged: bool) -> tuple[int, bool]:
        near = self._near(node, active)
        is_due = self._is_due(x, near, converged) or (converged and self._loses(x, node, active))
        if not reductions.anywhere(self._comm, is_due):
            return 0, False
        self._renewals += 1
        self._choose(x)
        return len(node), True

    def _is_due(self, x: Floats, near: Ints, converged: bool) -> bool:
        """Whether points of the nodes of `_near` must be chosen again after motion. Local."""
        may_move = self._renewals < self._most_renewals
        return may_move and self.pairing.num_beyond(x, near) > 0

    def _loses(self, x: Floats, node: Ints, active: Flags) -> bool:
        """Whether a node is inside without force, and would get other points at x. Local.

        Arguments as for `reproject`.
        """
        has_moved = _kernels.farthest(x, self.pairing.x_chosen) > self._slack
        if not (has_moved and self._renewals < self._most_renewals):
            return False
        flags = np.zeros(len(self._every), dtype=bool)
        flags[node[active]] = True
        return len(self.unheld(x, node, flags)[0]) > 0

    def unheld(self, x: Floats, node: Ints, active: Flags) -> tuple[Ints, Ints, Floats]:
        free = self.segment < 0
        free[node] = self._is_static & ~active[node]
        free &= self.candidates.facets.area > 0  # mid-nodes have no multipliers
        return penetrated_nodes(self, x, indices(free), LATE)

    def _near(self, node: Ints, active: Flags) -> Ints:
        """Select the nodes for which the position of the points matters. Local.

        They transmit force, flags ``active`` of shape ``(m,)``, or have a small gap.
        """
        size = self.candidates.size
        size = size.take(self.segment[node], mode="wrap") if len(size) else np.ones(len(node))
        near: Ints = node[active | (self.gap[node] < self._nearby * size)]
        return near


class TiedPoints(FrozenPoints):
    """Quadrature points of tied contact, fixed in the reference configuration."""

    _most_renewals = 0
    _has_kinks = False

    def unheld(self, x: Floats, node: Ints, active: Flags) -> tuple[Ints, Ints, Floats]:
        # Ties do not keep bodies apart.
        return LocalSearch.unheld(self, x, node, active)

    def _choose(self, x: Floats) -> None:
        # Points of ties are chosen at the reference positions.
        X = self.candidates.scatter.forward(reference_positions(self._V))
        self._take(X, X)

    def _points(self, found: FacetPoints, fraction: Floats, x: Floats) -> MortarPoints:
        """Points with dual functions only, as tied nodes have gaps of either sign."""
        return found.points()


class SettlingPoints(FrozenPoints):
    """Quadrature points of statics, renewed until they are consistent with the equilibrium."""

    _slides_far = _is_static = True
    _nearby = 0.1

    @property
    def chosen_at(self) -> Floats:
        return self.pairing.x_chosen

    def _dual_fractions(self, found: FacetPoints, x_n: Floats, x: Floats) -> Floats:
        """Fractions of dual functions at the equilibrium; statics ignores the gaps at t_n."""
        return found.largest_dual_fractions((x,), self._slack)

    def _points(self, found: FacetPoints, fraction: Floats, x: Floats) -> MortarPoints:
        """Points with weights computed in equilibrium."""
        return found.points(fraction, x, self._slack, is_stiff=self._is_stiff)

    def _is_due(self, x: Floats, near: Ints, converged: bool) -> bool:
        moved = self.pairing.places(x, near) - self.pairing.places(self.pairing.x_chosen, near)
        may_move = self._renewals < self._most_renewals
        if may_move and np.abs(moved).max(initial=0.0) > _SETTLED:
            return True
        # Before equilibrium the gaps of the points still differ.
        fraction = self._dual_fractions(self._found, x, x) if converged else self._dual_fraction
        return bool(self._must_be_reduced(fraction)[near].any())
