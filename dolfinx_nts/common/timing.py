"""Wall time of a run by phase of the computation."""

import time

__all__ = ["Timings"]


class Timings:
    """Accumulates the wall time of named phases. Local.

    Attributes:
        seconds: Time by name of the phase [s], in the order of first use.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def phase(self, name: str) -> "_Phase":
        """Context that adds the time spent in it to a phase, also if it raises.

        Args:
            name: Name of the phase.

        Returns:
            The context, for a ``with`` statement.
        """
        return _Phase(self.seconds, name)


class _Phase:
    """Context of one phase; a generator would be slower than some phases."""

    __slots__ = ("_name", "_seconds", "_start")

    def __init__(self, seconds: dict[str, float], name: str) -> None:
        self._seconds, self._name = seconds, name

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *error: object) -> None:
        spent = time.perf_counter() - self._start
        self._seconds[self._name] = self._seconds.get(self._name, 0.0) + spent
