"""Messages and bytes that the ranks send in a step, by phase.

Run with ``count_messages.c`` preloaded; prints a row of ``messages.csv`` as
JSON. Counted are calls of MPI, whoever makes them: DOLFINx, PETSc, mpi4py.
"""

import ctypes
import functools
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI

import numpy as np

from benchmarks.profile import CONTACT, Profile
from benchmarks.scenes import ball_on_plate, row_of_balls

__all__ = ["count"]


class Counter(Profile):
    """Message counters of the phases, instead of their times.

    Attributes:
        counts: By phase: messages, their bytes, collectives, their bytes.
    """

    def __init__(self) -> None:
        """Find the counters that are preloaded."""
        super().__init__()
        self._read = ctypes.CDLL(None).nts_counts
        self.counts: dict[str, np.ndarray[Any, Any]] = {}

    def now(self) -> Any:
        """Counts of this rank so far."""
        values = np.zeros(4)
        self._read(values.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))
        return values

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Count messages of a ``with`` block, without those of nested phases."""
        start, inner = self.now(), sum(self.counts.values(), np.zeros(4))
        try:
            with super().phase(name):
                yield
        finally:
            name = self.label(name)
            within = sum(self.counts.values(), np.zeros(4)) - inner
            own = self.now() - start - within
            self.counts[name] = self.counts.get(name, np.zeros(4)) + own

    def _watched(self, function: Callable[..., Any], phase: str) -> Callable[..., Any]:
        @functools.wraps(function, updated=())
        def call(*args: Any, **kwargs: Any) -> Any:
            with self.phase(phase):
                return function(*args, **kwargs)

        return call


def count(
    n: int, h: float, skip: int, steps: int, comm: MPI.Comm, *, in_a_row: bool = False
) -> dict[str, Any]:
    """Row of ``messages.csv``: the rank that sends most. Collective.

    Args:
        n: Cells along an edge of the ball.
        h: Step [s].
        skip: Steps before those that count.
        steps: Steps that count.
        comm: Communicator.
        in_a_row: Whether there are as many balls beside each other as ranks.
    """
    counter = Counter()
    if in_a_row:
        stepper = row_of_balls(comm, "EM elastic", h, n=n, number=comm.size).stepper
    else:
        stepper = ball_on_plate(comm, "EM elastic", h, n=n).stepper
    stepper.timings = counter
    start, newton, krylov = counter.now(), 0, 0
    for step in range(skip + steps):
        if step == skip:
            counter.counts.clear()
            start, newton, krylov = counter.now(), 0, stepper.statistics.solver.num_iterations
            exchanges = stepper.contacts[0].search.num_searches
        newton += stepper.advance().newton_iterations
    total = counter.now() - start
    contact = sum((counter.counts.get(name, np.zeros(4)) for name in CONTACT), np.zeros(4))
    krylov = stepper.statistics.solver.num_iterations - krylov
    exchanges = stepper.contacts[0].search.num_searches - exchanges
    index_map = stepper.u.function_space.dofmap.index_map
    row = {
        "n": n,
        "dofs": 3 * index_map.size_global,
        "ranks": comm.size,
        "steps": steps,
        "newton_per_step": newton / steps,
        "krylov_per_step": krylov / steps,
        "searches": exchanges,
        "ghosts": comm.allreduce(index_map.num_ghosts, op=MPI.MAX),
    }
    names = ("messages", "message_bytes", "collectives", "collective_bytes")
    for prefix, values in (("", total), ("contact_", contact)):
        for name, value in zip(names, values, strict=True):
            row[f"{prefix}{name}_per_step"] = comm.allreduce(value, op=MPI.MAX) / steps
    return row


if __name__ == "__main__":
    result = count(**json.loads(sys.argv[1]), comm=MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print("ROW", json.dumps(result))
