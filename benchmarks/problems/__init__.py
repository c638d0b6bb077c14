"""Problems whose solution is known, in closed form or from a fine step."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

from benchmarks.problems import balls, bars, blocks
from benchmarks.scenes import Scene

__all__ = ["PROBLEMS", "Problem"]


class Problem(NamedTuple):
    """A scene of adjustable mesh size, with its reference values.

    Attributes:
        build: Makes the scene from a communicator, a key of `scenes.SCHEMES`, a step [s] (None:
            what central differences choose), and by name the number ``n`` of cells and the key
            ``element`` of `scenes.ELEMENTS`. Collective.
        exact: Known values by name; what is missing is compared with the run at the smallest
            step.
        conserves: Whether the energy is that of the start.
    """

    build: Callable[..., Scene]
    exact: Mapping[str, float]
    conserves: bool = True


PROBLEMS = {
    "ball": Problem(balls.ball, {}),
    "stiff ball": Problem(partial(balls.ball, E=1e7), {}),
    "tori": Problem(balls.tori, {}),
    "ball on wall": Problem(balls.ball_on_wall, {"greatest force": 1.0, "duration": 1.0}),
    "bar": Problem(bars.bar_on_wall, {"rebound": 1.0}),
    "two bars": Problem(partial(bars.bar_on_bar, ratio=1), {"velocity handed on": 1.0}),
    "striker on rod": Problem(partial(bars.bar_on_bar, ratio=2), {"velocity handed on": 1.0}),
    "block": Problem(blocks.pressed_block, {}, conserves=False),
    "braking block": Problem(blocks.braking_block, {"way": 1.0}, conserves=False),
    "paraboloid": Problem(blocks.paraboloid, {"pressure, rms error": 0.0}, conserves=False),
}
