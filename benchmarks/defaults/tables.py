"""Tables of the page: a summary of the settings, and the errors in each scene."""

from collections.abc import Sequence

import numpy as np

from benchmarks.defaults.regret import Result, regrets
from benchmarks.defaults.scenes import SCENES

__all__ = ["markdown"]


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _head(names: Sequence[str]) -> list[str]:
    return [_row(names), "|---" * len(names) + "|"]


def summary(results: Sequence[Result], kinds: Sequence[str]) -> str:
    """Regrets of each setting over the scenes with some kinds of contact."""
    of, lines = (
        regrets(results),
        _head(
            ["setting", "error: median", "worst", "in", "cost: median", "worst", "failed, refused"]
        ),
    )
    for setting in dict.fromkeys(result.setting for result in results):
        own = [r for r in results if r.setting == setting and r.contact in kinds]
        ran = [r for r in own if not r.failure]
        if not ran:
            continue
        errors = np.array([of[r.scene, setting].error for r in ran])
        costs = np.array([of[r.scene, setting].cost for r in ran])
        lines.append(
            _row(
                [
                    setting,
                    f"{np.median(errors):.2f}",
                    f"{errors.max():.1f}",
                    ran[int(errors.argmax())].scene if errors.max() > 1 else "",
                    f"{np.median(costs):.2f}",
                    f"{costs.max():.1f}",
                    f"{len(own) - len(ran)} of {len(own)}",
                ]
            )
        )
    return "\n".join(lines)


def scene(results: Sequence[Result]) -> str:
    """Errors, costs and regrets of the settings in one scene."""
    name = results[0].scene
    of, kind = regrets(results), SCENES[name]
    lines = _head(
        [
            "setting",
            *(f"{quantity} (± {100 * t:g} %)" for quantity, t in kind.tolerances.items()),
            *(["energy"] if kind.conserves else []),
            *("Newton", "cost", "regret: error", "cost"),
        ]
    )
    failures = []
    for result in results:
        if result.failure:
            failures.append(f"- {result.setting}: {result.failure}")
            continue
        regret = of[name, result.setting]
        lines.append(
            _row(
                [
                    result.setting,
                    *(f"{100 * result.errors[quantity]:.2g} %" for quantity in kind.tolerances),
                    *([f"{result.energy:.0e}"] if kind.conserves else []),
                    *(f"{result.newton:.1f}", f"{result.cost:.2f}"),
                    *(f"{regret.error:.2f}", f"{regret.cost:.2f}"),
                ]
            )
        )
    title = f"{name} ({kind.contact}; {kind.reference}):"
    return "\n\n".join([title, "\n".join(lines), *(["\n".join(failures)] if failures else [])])


def markdown(results: Sequence[Result]) -> str:
    """All tables."""
    kinds = list(dict.fromkeys(kind.contact for kind in SCENES.values()))
    dynamic = [r for r in results if SCENES[r.scene].is_dynamic]
    parts = ["All scenes:", summary(results, kinds)]
    parts += ["Scenes with inertia:", summary(dynamic, kinds)]
    for contact in dict.fromkeys(result.contact for result in results):
        parts += [f"Contact of kind “{contact}”:", summary(results, [contact])]
    for name in SCENES:
        own = [result for result in results if result.scene == name]
        parts += [scene(own)] if own else []
    return "\n\n".join(parts) + "\n"
