"""Checks of the arguments of pictures. Local."""

from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_nts.common.arguments import kind_of, real_array
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.obstacles.motion import vector

__all__ = ["check_stepper", "check_view", "columns", "numbered_pair"]


def check_stepper(stepper: Any) -> None:
    """Check the stepper of a picture.

    Raises:
        TypeError: The argument is not a stepper.
    """
    if not isinstance(stepper, Stepper):
        raise TypeError(f"expected a stepper, whose state is drawn, given {kind_of(stepper)}")


def check_view(limits: Any, camera: Any, cut: Any = None) -> None:
    """Check the range of the colours, and directions.

    Raises:
        TypeError: A range or direction does not consist of numbers.
        ValueError: The range is not two ascending numbers, or a direction not three numbers that
            are not all zero.
    """
    if limits is not None:
        pair = real_array("limits", limits)
        if pair.shape != (2,) or not pair[0] < pair[1]:
            raise ValueError(f"expected limits (low, high) with low < high, given {limits!r}")
    if camera is not None and np.shape(camera) == (3, 3):
        for name, value in zip(("position", "focus", "upward direction"), camera, strict=True):
            vector(f"the {name} of the camera", value, 3)
        camera = None
    for name, direction in (("camera", camera), ("cut", cut)):
        if direction is not None and not vector(name, direction, 3).any():
            raise ValueError(f"expected a direction for {name}, given {direction!r}")


def numbered_pair(stepper: Stepper, pair: Any) -> PairState:
    """State of a contact pair by its number.

    Raises:
        IndexError: There is no such pair.
        TypeError: The number is not an integer.
    """
    if not isinstance(pair, int):
        raise TypeError(
            f"expected the number of a pair, from 0 as in stepper.pairs, given {kind_of(pair)}"
        )
    if not 0 <= pair < len(stepper.contacts):
        raise IndexError(
            f"expected the number of one of {len(stepper.contacts)} pairs, from 0, given {pair}"
        )
    return stepper.contacts[pair]


def columns(table: Any) -> Any:
    """Columns of the table of a run by name.

    Raises:
        OSError: The file cannot be read.
        TypeError: The table is not a path.
        ValueError: The file is not the table of a `Recorder`, or has no rows.
    """
    if not isinstance(table, str | Path):
        raise TypeError(
            f"expected the CSV file of a Recorder, such as 'run.csv', given {kind_of(table)}"
        )
    with Path(table).open(encoding="utf-8", errors="replace") as file:
        names, row = file.readline().split(","), file.readline()
    if names != [""] and "total_energy" not in names:
        raise ValueError(
            f"expected the CSV file of a Recorder, given {table}, which has no column total_energy"
        )
    if not row:
        raise ValueError(f"expected a table with rows, given {table}, which has none yet")
    return np.genfromtxt(table, delimiter=",", names=True)
