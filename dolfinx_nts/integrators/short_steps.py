"""Runs that crawl: many steps after each other that are much shorter than the usual one."""

__all__ = ["ShortSteps"]

# Halvings from which on a step is short, and number of short steps after each other that are told:
# they have done less than two usual ones. An impact needs some short steps, not so many.
_SHORT, _MANY = 4, 30


class ShortSteps:
    """Tells that a run begins to crawl, and why longer steps fail. Local."""

    def __init__(self) -> None:
        self._reason, self._number = "", 0

    def fail(self, reason: str) -> None:
        """Keep why a step failed."""
        self._reason = reason

    def accept(self, cuts: int) -> str:
        """Take a step that succeeded, with the number of its halvings.

        Returns:
            What to tell, "" if there is nothing new.
        """
        self._number = self._number + 1 if cuts >= _SHORT else 0
        if self._number != _MANY:
            return ""
        return (
            f"the last {_MANY} steps had to be at least {2**_SHORT} times shorter than dt, and "
            f"the run goes on like that; the last longer one failed: {self._reason}"
        )
