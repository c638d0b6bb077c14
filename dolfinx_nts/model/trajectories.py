"""Where points pass through a surface within a step."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints

__all__ = ["Trajectories", "passages"]

# Depth, relative to a segment [-], to which a point may cut off a corner of a body.
_CORNER = 0.1
# Motion relative to the size of a segment and to the thickness behind it [-] below which the
# local search finds a point again.
_SHORT, _THIN = 0.25, 0.5


def passages(size: Floats, thickness: Floats) -> Floats:
    """Relative motion below which no point passes each segment, shape ``(s,)`` [m]. Local.

    Args:
        size: Diameters of the segments, shape ``(s,)`` [m].
        thickness: Of the body behind each segment, shape ``(s,)`` [m].
    """
    return np.minimum(_SHORT * size, _THIN * thickness)


class Trajectories(NamedTuple):
    """Longest way of each of ``m`` points below a surface that it enters.

    Points and vertices move straight from one state to the other. Times are parts of the step.
    See `cpp/nts/search/trajectory.h`.

    Attributes:
        entered: Segment that is entered, -1 without, shape ``(m,)``.
        leaves: Whether the point comes out again, shape ``(m,)``.
        begin: Time when it enters, -1 if it starts inside, shape ``(m,)`` [-].
        way: Its way below the surface, shape ``(m,)`` [m].
        cosine: Between the normals where it enters and where it leaves or ends, ``(m,)`` [-].
        gap: Gap at the end to the plane in which it enters, shape ``(m,)`` [m].
    """

    entered: Ints
    leaves: Flags
    begin: Floats
    way: Floats
    cosine: Floats
    gap: Floats

    def take(self, points: Ints) -> "Trajectories":
        """Select some of the points, by their numbers."""
        return Trajectories(*(values[points] for values in self))  # type: ignore[arg-type]

    @classmethod
    def along(
        cls,
        ends: Sequence[Floats],
        follow: Callable[[Floats, Floats, Ints], "Trajectories"],
        inside: Ints,
    ) -> "Trajectories":
        """Follow points from place to place. Local.

        Args:
            ends: Positions at which ``s`` straight parts of ways end, which take equal times, and
                at the start, ``s + 1`` of shape ``(m, 3)`` [m].
            follow: Follows straight ways from one of them to the next, given segments behind
                which points are there or -1, shape ``(m,)``.
            inside: Those at the start.

        Returns:
            The ways; gaps are those at the end of the part in which a way ends.
        """
        num_parts = len(ends) - 1
        longest = last = follow(ends[0], ends[1], inside)
        for k in range(1, num_parts):
            behind = np.where((last.entered >= 0) & ~last.leaves, last.entered, -1)
            part = follow(ends[k], ends[k + 1], behind.astype(np.int32))
            goes_on = part.begin < 0
            last = part._replace(
                begin=np.where(goes_on, last.begin, k + part.begin),
                way=part.way + np.where(goes_on, last.way, 0.0),
            )
            is_longer = (last.entered >= 0) & (last.way >= longest.way)
            longest = cls(*map(np.where, [is_longer] * len(last), last, longest))
        begin = np.where(longest.begin < 0, -1.0, longest.begin / num_parts)
        return longest._replace(begin=begin)

    def passes(self, sizes: Floats) -> Flags:
        """Whether points come out on another side, or would be pushed out there, ``(m,)``.

        ``sizes`` are those of the segments, shape ``(s,)`` [m]. Points that cut off a corner of
        a body do not pass.
        """
        size = np.append(sizes, np.inf)[self.entered]
        # Depth of the edge in which the planes of entry and exit meet, in the middle of the way.
        depth = (
            self.way / 2 * np.sqrt(np.fmax(1 - self.cosine, 0.0) / np.fmax(1 + self.cosine, 1e-9))
        )
        through = (self.cosine < -_kernels.WALL) | (depth > _CORNER * size)
        flags: Flags = (self.entered >= 0) & np.where(self.leaves, through, self.cosine < 0)
        return flags
