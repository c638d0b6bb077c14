"""Wall time by phase of the computation."""

import time

__all__ = ["Timings"]


class Timings:
    """Accumulates the wall time of named phases. Local.

    Attributes:
        seconds: Time by phase [s], in the order of their first use.
    """

    def __init__(self) -> None:
        """Start without phases."""
        self.seconds: dict[str, float] = {}

    def phase(self, name: str) -> "_Phase":
        """Add the time spent in a ``with`` block, also if it raises, to ``name``."""
        return _Phase(self.seconds, name)


class _Phase:
    """A phase of some timings; a generator would take longer than some phases."""

    __slots__ = ("_name", "_seconds", "_start")

    def __init__(self, seconds: dict[str, float], name: str) -> None:
        self._seconds, self._name = seconds, name

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *error: object) -> None:
        spent = time.perf_counter() - self._start
        self._seconds[self._name] = self._seconds.get(self._name, 0.0) + spent
