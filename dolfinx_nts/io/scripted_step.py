"""Length of steps that a script asks for, also where it resumes a run."""

import math

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.integrators.stepper import Stepper

__all__ = ["ScriptedStep"]

# Relative difference of lengths [-] that is round-off: explicit steppers estimate theirs, with
# an error that depends on the partition.
_ROUND_OFF = 1e-9


class ScriptedStep:
    """Length of steps at the start of a recording, which a resumed run compares with its own.

    A script that is started again unchanged goes on with the steps of the checkpoint, which the
    run may have changed. A script with another ``dt`` goes on with this.

    Args:
        stepper: Stepper of the run, before it is brought into the state of a checkpoint.
    """

    def __init__(self, stepper: Stepper) -> None:
        self._stepper, self._dt = stepper, stepper.dt

    def serialize(self, archive: Archive) -> None:
        """Serialize the length; restore that of the script if it is another one. Collective.

        Raises:
            ValueError: The stepper refuses the length, as it is not stable.
        """
        before = archive.same("scripted_dt", self._dt)
        if not math.isclose(self._dt, before, rel_tol=_ROUND_OFF):
            self._stepper.dt = self._dt
