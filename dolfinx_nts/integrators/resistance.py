"""How large the resistance of a relaxation is, from one pseudo-step to the next."""

__all__ = ["Resistance"]

# Resistance relative to the stiffness of nodes [-]: the first; the largest, with which bodies
# hardly move; and the least, beyond which it adds nothing to what holds bodies.
_FIRST, _LARGEST, _LEAST = 1e-2, 10.0, 1e-10
# Its change after a pseudo-step that succeeded, after some of them while bodies go along an
# unstable motion, and after one that failed [-].
_FALL, _SLOW_FALL, _RISE = 0.1, 0.5, 4.0
# Force that drives bodies relative to that in the last pseudo-step [-], below which they come to
# rest: way times resistance.
_CALMER = 0.5
# Number of pseudo-steps along an unstable motion after which it falls: in each of them the way
# grows by a factor.
_PATIENCE = 2


class Resistance:
    """Falls while pseudo-steps succeed, and rises where one fails. Local.

    It has to be larger than what drives bodies along a motion that is not stable, but ways are
    short with too much of it.

    Attributes:
        part: Resistance of the next pseudo-step relative to the stiffness of the nodes [-].
    """

    def __init__(self) -> None:
        self.part = _FIRST
        self._has_failed, self._drive, self._accepted = False, 0.0, 0

    def accept(self, way: float) -> None:
        """Count a pseudo-step that succeeded, with the largest way of a node in it [m]."""
        drive = self.part * way
        calms, self._drive = drive < _CALMER * self._drive, drive
        self._accepted += 1
        if calms or not self._has_failed:
            self.part, self._accepted = _FALL * self.part, 0
        elif self._accepted >= _PATIENCE:
            self.part, self._accepted = _SLOW_FALL * self.part, 0

    def fail(self) -> None:
        """Rise after a pseudo-step that failed."""
        self.part, self._has_failed, self._accepted = _RISE * self.part, True, 0

    @property
    def is_too_large(self) -> bool:
        """Whether it cannot rise any more."""
        return self.part > _LARGEST

    @property
    def is_gone(self) -> bool:
        """Whether it has become too small to matter."""
        return self.part < _LEAST
