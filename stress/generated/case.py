"""A generated case, its run and its verdict."""

import signal
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import dolfinx_nts as nts

__all__ = ["KINDS_OF_ENDS", "Case", "Verdict", "run"]

# Outcomes of a case: correct; refused with an explanation; accepted but wrong; another error; no
# end within the time limit.
KINDS_OF_ENDS = ("right", "refused", "silent", "raw error", "hang")
# CPU time limit of a case [s]: ten times the time of the slowest one.
_LONGEST = 40.0
# A refusal must be a full sentence: a shorter text contains neither position nor remedy.
_SHORTEST_MESSAGE = 40


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        kind: Kind of the case, a row of the table.
        name: Unique name.
        judge: Builds the scene, runs and judges it with random numbers; returns "" or an
            explanation of the error.
        may_refuse_setup: Whether a refusal of the package before the first step is right.
    """

    kind: str
    name: str
    judge: Callable[[np.random.Generator], str]
    may_refuse_setup: bool = False


@dataclass(frozen=True)
class Verdict:
    """Outcome of a case.

    Attributes:
        end: One of `KINDS_OF_ENDS`.
        message: Error or explanation.
        seconds: CPU time [s].
    """

    end: str
    message: str
    seconds: float


class _TooLongError(BaseException):
    """The time limit of a case is exceeded; no handler of `Exception` catches it."""


def _stop(*_: Any) -> None:
    raise _TooLongError


def run(case: Case, seed: int = 0) -> Verdict:
    """Run a case; its random numbers follow from the seed and its name."""
    rng = np.random.default_rng([seed, zlib.crc32(case.name.encode())])
    start = time.process_time()
    former = signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, _LONGEST)
    try:
        message = case.judge(rng)
        end = "silent" if message else "right"
    except (nts.ConvergenceError, ValueError) as error:
        message = str(error)
        is_refused = isinstance(error, nts.ConvergenceError)
        if case.may_refuse_setup:
            is_refused |= "expected" in message and "given" in message
        end = "refused" if is_refused and len(message) >= _SHORTEST_MESSAGE else "raw error"
    except _TooLongError:
        end, message = "hang", f"no end within {_LONGEST:.0f} s of CPU time"
    except Exception as error:
        end, message = "raw error", f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, former)
    return Verdict(end, message, time.process_time() - start)
