"""Wall time by phase of the computation."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["Timings"]


class Timings:
    """Accumulates the wall time of named phases. Local.

    Attributes:
        seconds: Time by phase [s], in the order of their first use.
    """

    def __init__(self) -> None:
        """Start without phases."""
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time spent in the block, also if it raises, to ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
