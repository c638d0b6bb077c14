"""Check for impacts that last only a few steps."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.model.bodies import Body, body_of_nodes
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["ShortContacts"]

_logger = logging.getLogger("dolfinx_nts")

# Number of steps up to which an impact is too short, and number of steps without contact after
# which it has ended [-]. Two pendulums with soft rims leave an impact of 2, 6 and 18 steps with a
# speed that is 43, 8 and 0.4 % too small. Larger: with 8, accurate impacts on corners are reported;
# smaller: impacts of 3 or 4 steps are not.
_FEW = 4
# Steps in an impact that the message asks for [-], as in the last of these impacts.
_ENOUGH = 20
# Energy of a free body with the impulse of an impact, relative to the kinetic energy [-], above
# which the impact counts. Larger: severe impacts are not reported; smaller: those that hardly
# change the motion are.
_PART = 0.1


@dataclass
class _Impact:
    """Contact of a pair since it began.

    Attributes:
        kinetic: Kinetic energy before it [J].
        start: Time at its start [s].
        end: Time at the end of its last step [s].
        num_steps: Number of steps up to that time.
        num_since: Number of steps without contact since then.
        impulse: Impulse on the nodes, shape ``(3,)`` [N s].
    """

    kinetic: float
    start: float
    end: float = 0.0
    num_steps: int = 0
    num_since: int = 0
    impulse: Floats = field(default_factory=lambda: np.zeros(3))


class ShortContacts:
    """Check for impacts of deformable bodies that last only a few steps. Collective.

    Such steps do not resolve how bodies are compressed and expand again. Energy is conserved, but
    much of it remains in vibrations, so that bodies rebound too slowly. Each pair is reported once.

    Args:
        bodies: Bodies of a stepper.
        contacts: Contact of all pairs.
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].
    """

    def __init__(self, bodies: Sequence[Body], contacts: Sequence[PairState], mass: Floats) -> None:
        self._comm = comm = bodies[0].V.mesh.comm
        self._impacts: dict[PairState, _Impact] = {}
        number = body_of_nodes(bodies)
        own = np.bincount(number[: len(mass)], mass, len(bodies))
        mass_of_bodies = reductions.total(comm, own)
        deforms = np.array([not body.is_rigid for body in bodies])
        # Mass of the lighter side of each pair [kg].
        self._watched: dict[PairState, float] = {}
        for contact in contacts:
            sides = contact.pair.nodes, contact.pair.segments
            nodes = [side.nodes for side in sides if isinstance(side, Surface)]
            has_nodes = [np.bincount(number[own], minlength=len(bodies)) > 0 for own in nodes]
            is_on = reductions.anywhere(comm, np.array(has_nodes))
            if (is_on & deforms).any():
                self._watched[contact] = float((is_on @ mass_of_bodies).min())

    def check(self, kinetic: float, t: float, dt: float) -> None:
        """Check the pairs after a step.

        Args:
            kinetic: Kinetic energy before the step [J].
            t: Time at its end [s].
            dt: Its length [s].
        """
        sums = np.zeros((len(self._watched), 4))
        for row, contact in zip(sums, self._watched, strict=True):
            history = contact.history
            row[:3] = history.force[history.active].sum(axis=0)
            row[3] = np.count_nonzero(history.active)
        sums = reductions.total(self._comm, sums) if len(sums) else sums
        for contact, (*force, num_active) in zip(tuple(self._watched), sums, strict=True):
            if num_active:
                impact = self._impacts.setdefault(contact, _Impact(kinetic, t - dt))
                impact.num_steps += 1 + impact.num_since
                impact.num_since, impact.end = 0, t
                impact.impulse += dt * np.array(force)
            elif contact in self._impacts:
                impact = self._impacts[contact]
                impact.num_since += 1
                if impact.num_since >= _FEW:
                    self._end(contact, self._impacts.pop(contact))

    def _end(self, contact: PairState, impact: _Impact) -> None:
        energy = impact.impulse @ impact.impulse / (2 * self._watched[contact])
        if impact.num_steps > _FEW or not energy > _PART * impact.kinetic:
            return
        del self._watched[contact]
        if self._comm.rank == 0:
            _logger.warning(
                "the impact of %s from t = %g to %g s has lasted %d steps only, which do not "
                "resolve the deformation of the bodies: they rebound too slowly; use steps of "
                "%.2g s or shorter, or a RigidBody where deformation does not matter",
                *(contact.pair.between, impact.start, impact.end, impact.num_steps),
                (impact.end - impact.start) / _ENOUGH,
            )
