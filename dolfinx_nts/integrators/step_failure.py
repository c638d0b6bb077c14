"""Error message of a failed implicit step: causes and remedies."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import GlobalInts
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.prescribed import prescribed_nodes
from dolfinx_nts.contact.joint_state import members
from dolfinx_nts.contact.method import MORTAR, NODES, default_method, may_be_smooth
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.vertices import VertexState
from dolfinx_nts.fem.node_numbering import listed, reference_positions
from dolfinx_nts.integrators.rigid import gives_rigid_nodes, redundant
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.moduli import least_modulus
from dolfinx_nts.model.segments import diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.solvers.newton_report import ConvergenceError, NewtonReport

__all__ = ["SHORTER_STEP_HELPS", "StepFailure"]

# Advice if no specific cause is known.
SHORTER_STEP_HELPS = "a smaller dt may help, which StepControl() uses after a failed step"

# Attempts by name: the starting guesses of `Rates.starts`, and the attempts of statics.
_STARTS = {
    "coasting": "the mean velocity of the last step",
    "ballistic": "the velocity at its start",
    "extrapolated": "the increment of the last step",
    "last": "the last state",
    "sticking": "the last state with all nodes sticking",
    "relaxed": "the last state against a viscous resistance",
}
# Phrases in the reasons of failure that indicate springs that are too soft.
_SUNK = "through a surface", "into a surface"
# Largest number of surface names in a message [-].
_MOST_NAMES = 3
# Ratio of the moduli of nodes and segments [-] above which the message mentions it.
_STIFFER = 10.0
# Ratio of the facet sizes of nodes and segments in contact [-] above which the message mentions it.
# With a ball of 6 facets per quarter circle on a block, 1.0 runs at all tested speeds, 1.39 fails.
_COARSER = 1.2
# Phrases in the reasons of failure that indicate single nodes that indent facets.
_PRESSED_IN = "into a surface", "do not project", "increments were longer"
# Phrase in the reasons of failure that indicates nodes in concave edges between facets.
_BETWEEN = "between two segments"


class StepFailure:
    """Diagnosis of a step that failed in all attempts.

    Args:
        attempts: Report of Newton's method from each starting guess, by its name.
        steps: Contact of the last attempt.
        states: Contact at the end of the last attempt, one for each of ``steps``.
        comm: Communicator of the mesh.
    """

    def __init__(
        self,
        attempts: Mapping[str, NewtonReport],
        steps: Sequence[ContactStep],
        states: Sequence[ContactContribution],
        comm: MPI.Comm,
    ) -> None:
        self._attempts, self._comm = attempts, comm
        self._steps = tuple(zip(steps, states, strict=True))

    def error(
        self,
        step: str,
        bodies: Sequence[Body],
        contacts: Sequence[PairState],
        yielding: Sequence[PairState],
        advice: str,
    ) -> ConvergenceError:
        """Error with all reasons. Collective.

        Args:
            step: Text that names the step.
            bodies: All bodies.
            contacts: States of all pairs.
            yielding: States of pairs whose springs are too soft at any step length.
            advice: Remedy if no specific cause is found.
        """
        reports = [replace(each, start=_STARTS[name]) for name, each in self._attempts.items()]
        reasons = "; ".join(each.reason for each in reports)
        # The reason why an attempt stopped is more useful than the number of its iterations.
        causes = [min((r.reason for r in reports), key=lambda reason: "no convergence" in reason)]
        weak = {type(b.material).__name__ for b in bodies if not b.material.resists_collapse}
        if "is inverted" in reasons and weak:
            causes.append(f"{' and '.join(sorted(weak))} cannot resist collapse, NeoHookean can")
        nodes = self._listed(each.state.nodes.node_ids[each.unsettled] for each, _ in self._steps)
        if nodes:
            causes.append(f"nodes that keep changing segment or state: {nodes}")
        sides = ""
        if nodes or any(words in reasons for words in _PRESSED_IN):
            sides = self._advice_on_stiffness(bodies) or self._advice_on_facet_sizes(bodies)
        if nodes or _BETWEEN in reasons:
            sides = sides or self._advice_on_smoothing()
        causes.append(sides)
        if names := redundant(bodies, [contact.pair for contact in contacts]):
            causes.append(
                "forces of simultaneous contacts of rigid bodies are not unique: springs, as "
                f"Penalty(eps_N=), between {names} make them unique"
            )
        springs: Sequence[PairState] = yielding
        if not yielding and (any(words in reasons for words in _SUNK) or "contact holds" in advice):
            springs = [c for c in contacts if isinstance(c.pair.enforcement, Penalty)]
        stiffer = [
            f"stiffer springs between {contact.pair.between} may help ({contact})"
            for contact in springs
        ]
        if yielding:  # nodes penetrate at any length of the step
            advice = "; ".join(stiffer)
        else:
            causes.extend(stiffer)
        cause = "; ".join(filter(None, causes))
        return ConvergenceError(
            f"{step} failed: {cause}; the state is that of the last accepted step: "
            f"{self._prescribed() or advice}",
            reports,
            cause,
        )

    def _pairs(self) -> Iterator[tuple[ContactPair, bool]]:
        """Pairs, and whether they have nodes that changed state repeatedly. Collective."""
        for step, _ in self._steps:
            ends, node = step.state.ends, step.unsettled
            counts = reductions.total(self._comm, np.diff(np.searchsorted(node, ends)))
            for each, count in zip(members(step.state), counts, strict=True):
                if not isinstance(each, VertexState):
                    yield each.pair, bool(count > 0)

    def _advice_on_stiffness(self, bodies: Sequence[Body]) -> str:
        """Advice for pairs whose unsettled nodes belong to the stiffer side, or "". Collective.

        Only few nodes of a stiff body can touch soft facets at the same time, and which ones
        depends on small details of the facets.
        """
        found = []
        for pair, is_unsettled in self._pairs():
            if is_unsettled and isinstance(pair.segments, Surface):
                nodes, segments = (
                    self._modulus(bodies, side) for side in (pair.nodes, pair.segments)
                )
                if _STIFFER * segments <= nodes < np.inf:
                    found.append((nodes / segments if segments else np.inf, pair))
        if not found:
            return ""
        ratio, pair = max(found, key=lambda each: each[0])
        return (
            f"{pair.nodes.name} provides the contact nodes and is {float(f'{ratio:.2g}'):g} "
            f"times stiffer than {pair.segments.name}: let the softer one provide them"
        )

    def _advice_on_facet_sizes(self, bodies: Sequence[Body]) -> str:
        """Advice for pairs with larger facets of nodes than of segments, or "". Collective.

        Single nodes then indent facets, and vertices penetrate between the nodes.
        """
        found = []
        for step, _ in self._steps:
            search = step.search
            touches = (step.normal.active | search.unsettled) & (search.segment >= 0)
            for each, start, end in zip(
                members(step.state), step.state.ends[:-1], step.state.ends[1:], strict=True
            ):
                pair, nodes = each.pair, each.pair.nodes
                if isinstance(each, VertexState) or pair.method != NODES:
                    continue
                if not isinstance(pair.segments, Surface) or pair.touches_itself:
                    continue
                touching = np.flatnonzero(touches[start:end])
                around = np.isin(nodes.segments, nodes.nodes[touching]).any(axis=1)
                own = diameters(reference_positions(nodes.V)[nodes.segments[around]])
                others = search.candidates.size[search.segment[start:end][touching]]
                sums = np.array([own.sum(), len(own), others.sum(), len(others)])
                size, number, other, count = reductions.total(self._comm, sums)
                if count and size / number >= _COARSER * other / count:
                    found.append((size / number / (other / count), pair))
        if not found:
            return ""
        ratio, pair = max(found, key=lambda each: each[0])
        may_be_mortar = default_method(pair) == MORTAR and not gives_rigid_nodes(pair, bodies)
        mortar = ', or use method="mortar"' if may_be_mortar else ""
        return (
            f"{pair.nodes.name} provides the contact nodes, and its facets are {ratio:.2g} times "
            f"as large as those of {pair.segments.name} where they touch: exchange both in the "
            f"ContactPair, so that the finer one provides the nodes{mortar}"
        )

    def _modulus(self, bodies: Sequence[Body], surface: Surface) -> float:
        """Smallest modulus of the bodies of a surface [Pa], infinite if rigid. Collective."""
        moduli = [least_modulus(body) for body in bodies]
        of_bodies = [
            modulus
            for modulus, body in zip(moduli, bodies, strict=True)
            if not set(body.nodes).isdisjoint(surface.nodes)
        ]
        return float(reductions.least(self._comm, min(of_bodies, default=np.inf)))

    def _advice_on_smoothing(self) -> str:
        """Advice to use smooth segments where nodes do not settle, or "". Collective.

        It concerns pairs with unsettled nodes, or all pairs if there are none.
        """
        names: list[dict[str, None]] = [{}, {}]
        for pair, is_unsettled in self._pairs():
            if may_be_smooth(pair):
                names[is_unsettled][pair.segments.name] = None
        found = list(names[1] or names[0])
        if not found:
            return ""
        more = len(found) - _MOST_NAMES
        chosen = " or ".join(found[:_MOST_NAMES]) + (f" or one of {more} more" if more > 0 else "")
        return (
            f"if {chosen} is curved, smooth=True of the surface may help: nodes do not settle at "
            "edges between flat facets"
        )

    def _prescribed(self) -> str:
        """Message on contact between prescribed nodes, or "". Collective."""
        advice = ""
        for step, state in self._steps:
            node = prescribed_nodes(step, state)
            ends = np.searchsorted(node, step.state.ends)
            for each, some in zip(members(step.state), np.split(node, ends[1:-1]), strict=True):
                if nodes := self._listed([step.state.nodes.node_ids[some]]):
                    advice = (
                        "bcs move nodes into a surface that is prescribed by bcs too, which no "
                        "contact force can prevent; change bcs at these nodes between "
                        f"{each.pair.between}: {nodes}"
                    )
        return advice

    def _listed(self, parts: Iterable[GlobalInts]) -> str:
        """Text with some node numbers of all ranks, or "". Collective."""
        mine = np.concatenate([np.empty(0, dtype=np.int64), *parts])
        return listed(np.unique(joined(self._comm, mine)))
