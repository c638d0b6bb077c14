"""Trajectories of points below a surface within a step (pass-through check)."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints

__all__ = ["Trajectories", "passages"]

# Depth relative to a segment [-] up to which a path may cut a corner of a body without contact.
_CORNER = 0.1
# Displacements relative to the size of a segment, and to the thickness behind it [-], up to which
# the local search still finds a point.
_SHORT, _THIN = 0.25, 0.5


def passages(size: Floats, thickness: Floats) -> Floats:
    """Relative displacement below which no point passes through a segment, ``(s,)`` [m]. Local.

    Args:
        size: Diameters of the segments, shape ``(s,)`` [m].
        thickness: Thickness of the body behind each segment, shape ``(s,)`` [m].
    """
    return np.minimum(_SHORT * size, _THIN * thickness)


class Trajectories(NamedTuple):
    """Longest part of the path of each of ``m`` points that is below a surface.

    Points and vertices move straight in the step. Times are step fractions. See
    `cpp/nts/search/trajectory.h`.

    Attributes:
        entered: Segment through which the point enters, or -1, shape ``(m,)``.
        leaves: Whether the point leaves the body again, shape ``(m,)``.
        begin: Time of entry, -1 if it starts inside, shape ``(m,)`` [-].
        length: Length of the path below the surface, shape ``(m,)`` [m].
        cosine: Cosine between the normals at entry and at exit or end, shape ``(m,)`` [-].
        gap: Gap at the end to the plane of entry, shape ``(m,)`` [m].
    """

    entered: Ints
    leaves: Flags
    begin: Floats
    length: Floats
    cosine: Floats
    gap: Floats

    def take(self, points: Ints) -> "Trajectories":
        """Select points by their indices."""
        return Trajectories(*(values[points] for values in self))  # type: ignore[arg-type]

    @classmethod
    def along(
        cls,
        ends: Sequence[Floats],
        follow: Callable[[Floats, Floats, Ints], "Trajectories"],
        inside: Ints,
    ) -> "Trajectories":
        """Trajectories along polygonal paths. Local.

        Args:
            ends: Positions at the ends of ``s`` straight parts of equal duration, ``s + 1`` arrays
                of shape ``(m, 3)`` [m].
            follow: Returns the trajectories of one straight part from its ends and the segments
                behind which points are at its start, or -1, shape ``(m,)``.
            inside: These segments at the start of the path.

        Returns:
            The trajectories; gaps are at the end of the part in which a trajectory ends.
        """
        num_parts = len(ends) - 1
        longest = last = follow(ends[0], ends[1], inside)
        for k in range(1, num_parts):
            behind = np.where((last.entered >= 0) & ~last.leaves, last.entered, -1)
            part = follow(ends[k], ends[k + 1], behind.astype(np.int32))
            goes_on = part.begin < 0
            last = part._replace(
                begin=np.where(goes_on, last.begin, k + part.begin),
                length=part.length + np.where(goes_on, last.length, 0.0),
            )
            is_longer = (last.entered >= 0) & (last.length >= longest.length)
            longest = cls(*map(np.where, [is_longer] * len(last), last, longest))
        begin = np.where(longest.begin < 0, -1.0, longest.begin / num_parts)
        return longest._replace(begin=begin)

    def passes(self, sizes: Floats) -> Flags:
        """Whether points leave the body on another side, or would be pushed out there by contact.

        Args:
            sizes: Diameters of the segments, shape ``(s,)`` [m].

        Returns:
            Flags, shape ``(m,)``; false for points that only cut off a corner.
        """
        size = np.append(sizes, np.inf)[self.entered]
        # Depth at the middle of the path below the edge between the planes of entry and exit.
        depth = (
            self.length
            / 2
            * np.sqrt(np.fmax(1 - self.cosine, 0.0) / np.fmax(1 + self.cosine, 1e-9))
        )
        through = (self.cosine < -_kernels.WALL) | (depth > _CORNER * size)
        flags: Flags = (self.entered >= 0) & np.where(self.leaves, through, self.cosine < 0)
        return flags
