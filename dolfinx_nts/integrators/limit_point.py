"""Loads beyond which statics has no equilibrium near the last one, found from the steps to them."""

__all__ = ["LimitPoint"]

# Least growth [-] of the rate of displacements for each cut that counts: with the time s left to
# a limit point displacements go as sqrt(s), and a cut at least halves s, so that rates grow by
# about sqrt(2); less where loads far from it still make a part of them.
_GROWTH = 1.2
# Number of such cuts from which on the limit point is taken for certain: steps have less than
# 1/32 of the usual length then.
_CERTAIN = 5


class LimitPoint:
    """Watches in statics whether steps close in on a time beyond which there are none. Local.

    At a limit load equilibria turn back: displacements grow ever faster towards it, and no step
    across it succeeds, however short. A step that is only too long succeeds when it is cut, and
    rates do not grow with every cut.
    """

    def __init__(self) -> None:
        """Begin far away from it."""
        self._rate, self._cuts = 0.0, 0

    def accept(self, rate: float, rejected: int) -> None:
        """Take a step that succeeded.

        Args:
            rate: Largest displacement of a node in it over its length [m/s].
            rejected: Number of longer steps that had failed.
        """
        closer = rejected > 0 and rate > _GROWTH**rejected * self._rate > 0
        self._rate, self._cuts = rate, self._cuts + rejected if closer else 0

    @property
    def is_near(self) -> bool:
        """Whether the next step that fails does so because of it."""
        return self._cuts >= _CERTAIN
