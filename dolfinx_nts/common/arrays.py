"""Types of NumPy arrays by what they hold, for annotations throughout the package."""

from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "Flags", "Floats", "GlobalInts", "Ints"]

Array = npt.NDArray[Any]
Flags = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]
GlobalInts = npt.NDArray[np.int64]  # numbers that are the same on all ranks
Ints = npt.NDArray[np.int32]  # local indices, as DOLFINx counts
