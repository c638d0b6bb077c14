"""Regret: how much worse a setting is than the best one of a scene."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

__all__ = ["Regret", "Result", "regrets"]


class Result(NamedTuple):
    """A setting in a scene.

    Attributes:
        scene, setting: Their names.
        contact: Kind of contact of the scene.
        errors: Errors by quantity [-]; empty if the run was refused or has failed.
        error: Largest error relative to its tolerance [-].
        energy: Largest relative change of the energy where it is constant, otherwise 0 [-].
        cost: CPU time relative to the base setting in the same process [-].
        newton: Newton iterations of a step.
        failure: Why there is no result, or "".
    """

    scene: str
    setting: str
    contact: str
    errors: Mapping[str, float]
    error: float = np.inf
    energy: float = 0.0
    cost: float = np.nan
    newton: float = np.nan
    failure: str = ""


class Regret(NamedTuple):
    """Regret of a setting in a scene.

    Attributes:
        error: Error over that of the best setting, both at least 1, which is the tolerance [-].
        cost: Cost over that of the cheapest setting whose error is no larger [-].
    """

    error: float
    cost: float


def regrets(results: Sequence[Result]) -> dict[tuple[str, str], Regret]:
    """Regrets by scene and setting; infinite where there is no result.

    Args:
        results: All settings in all scenes.
    """
    found = {}
    for scene in dict.fromkeys(result.scene for result in results):
        own = [result for result in results if result.scene == scene]
        error = {result.setting: max(result.error, 1.0) for result in own}
        best = min(error.values())
        for result in own:
            mine = error[result.setting]
            # Settings with an error within 5 % of the best one.
            cheapest = min(r.cost for r in own if error[r.setting] <= 1.05 * mine)
            regret = Regret(mine / best, result.cost / cheapest)
            failed = Regret(np.inf, np.inf)
            found[scene, result.setting] = failed if result.failure else regret
    return found
