"""How large the resistance of a relaxation is, from one pseudo-step to the next."""

__all__ = ["Resistance"]

# Resistance relative to the stiffness of nodes [-]: the first; the largest, with which bodies
# hardly move; and the least, beyond which it adds nothing to what holds bodies.
_FIRST, _LARGEST, _LEAST = 1e-2, 10.0, 1e-10
# Its change after a pseudo-step that succeeded, and after one that failed [-].
_FALL, _RISE = 0.1, 4.0
# Number of pseudo-steps after one that failed before it falls again: what moves bodies along an
# unstable mode grows by a factor in each.
_PATIENCE = 3


class Resistance:
    """Falls while pseudo-steps succeed, and rises where one fails. Local.

    Attributes:
        part: Resistance of the next pseudo-step relative to the stiffness of the nodes [-].
    """

    def __init__(self) -> None:
        """Begin with the first."""
        self.part, self._stays = _FIRST, 0

    def accept(self) -> None:
        """Count a pseudo-step that succeeded."""
        if self._stays:
            self._stays -= 1
        else:
            self.part *= _FALL

    def fail(self) -> None:
        """Rise after a pseudo-step that failed."""
        self.part, self._stays = _RISE * self.part, _PATIENCE

    @property
    def is_too_large(self) -> bool:
        """Whether it cannot rise any more."""
        return self.part > _LARGEST

    @property
    def is_gone(self) -> bool:
        """Whether it has become too small to matter."""
        return self.part < _LEAST
