"""The loop over the steps of a run, which tells if nobody goes through it."""

import logging
from collections.abc import Iterator

from mpi4py import MPI

from dolfinx_nts.integrators.report import StepReport

__all__ = ["StepLoop"]

_logger = logging.getLogger("dolfinx_nts")


class StepLoop(Iterator[StepReport]):
    """Iterator over the reports of steps. Collective where it takes a step.

    Args:
        steps: Takes a step whenever it is asked for the next report.
        comm: Communicator, whose first rank warns.
    """

    def __init__(self, steps: Iterator[StepReport], comm: MPI.Comm) -> None:
        self._steps = steps
        self._is_silent = comm.rank > 0

    def __next__(self) -> StepReport:
        """Report of the next step, which is taken now."""
        self._is_silent = True
        return next(self._steps)

    def __del__(self) -> None:
        """Warn if no step was ever asked for."""
        if not self._is_silent:
            _logger.warning(
                "run() was called without a loop, so that no step was taken: write "
                '"for step in stepper.run(...)", or list(stepper.run(...))'
            )
