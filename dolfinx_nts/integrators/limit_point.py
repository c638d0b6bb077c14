"""Loads beyond which statics has no equilibrium near the last one, found from the steps to them."""

__all__ = ["LimitPoint"]

# Least growth [-] of the rate of displacements for each cut that counts: with the time s left to
# a limit point displacements go as sqrt(s), and a cut at least halves s, so that rates grow by
# about sqrt(2); less where loads far from it still make a part of them.
_GROWTH = 1.2
# Numbers of such cuts, and of steps that had them, from which on the limit point is taken for
# certain: steps have less than 1/32 of the usual length then, and one alone may be fast as
# surfaces meet in it.
_CERTAIN, _STEPS = 5, 2


class LimitPoint:
    """Watches in statics whether steps close in on a time beyond which there are none. Local.

    At a limit load equilibria turn back: displacements grow ever faster towards it, and no step
    across it succeeds, however short. A step that is only too long succeeds when it is cut, and
    rates do not grow with every cut.
    """

    def __init__(self) -> None:
        self._rate, self._cuts, self._steps = 0.0, 0, 0

    def accept(self, rate: float, rejected: int) -> None:
        """Take a step that succeeded.

        Args:
            rate: Largest displacement of a node in it over its length [m/s].
            rejected: Number of longer steps that had failed.
        """
        closer = rejected > 0 and rate > _GROWTH**rejected * self._rate > 0
        self._rate = rate
        self._cuts = self._cuts + rejected if closer else 0
        self._steps = self._steps + 1 if closer else 0

    @property
    def is_near(self) -> bool:
        """Whether the next step that fails does so because of it."""
        return self._cuts >= _CERTAIN and self._steps >= _STEPS

    @staticmethod
    def told(start: float, end: float, has_loads: bool) -> str:
        """Say between which times [s] it is, and what would help.

        Args:
            start: Time of the last equilibrium [s].
            end: Time to which there is none [s].
            has_loads: Whether there are loads; if not, displacements alone lead.
        """
        found = f"statics has no equilibrium beyond a time between t = {start:.6g} and {end:.6g}, "
        if has_loads:
            found += (
                "a limit load as in buckling, snapping or bursting: the closer to it, the faster "
                "bodies deform, and no step across it succeeds; EnergyMomentum follows what "
                "happens then, given displacements instead of loads may pass it, and "
            )
        else:
            found += (
                "though no loads act: what is led lets bodies snap, or surfaces in contact slip "
                "over edges of each other's facets to another state, faster and faster, and no "
                "step across it succeeds; EnergyMomentum follows what happens then, finer facets "
                "or friction may avoid it, and "
            )
        return found + "StepControl(smallest=) goes on to shorter steps"
