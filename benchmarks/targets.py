"""Targets of the benchmark: aims, and gates that must hold."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Results", "Rows", "Target", "measured"]

Rows = Sequence[Mapping[str, Any]]

_EM, _EXPLICIT = "EM elastic", "central differences"
_CPU, _RESIDUALS = "cpu_seconds_per_step", "residuals_per_step"


class Results(NamedTuple):
    """Rows of the files of a run, by their names."""

    steps: Rows
    errors: Rows
    messages: Rows
    start: Rows
    output: Rows


class Target(NamedTuple):
    """A target with its bounds.

    Attributes:
        name: What is measured.
        value: Takes it from the results; KeyError where they do not have it.
        aim: What is aimed at.
        gate: What must hold.
        is_least: Whether these are lower bounds.
    """

    name: str
    value: Callable[[Results], float]
    aim: float
    gate: float
    is_least: bool = False

    @property
    def sign(self) -> str:
        """Relation of the value to the bounds, as a sign."""
        return "≥" if self.is_least else "≤"

    def verdict(self, value: float) -> str:
        """Text on whether a value is within the bounds."""

        def holds(bound: float) -> bool:
            return value >= bound if self.is_least else value <= bound

        return "met" if holds(self.aim) else "within the gate" if holds(self.gate) else "**missed**"


def measured(results: Results) -> Iterator[tuple[Target, float]]:
    """Targets whose rows exist, with the measured values."""
    for target in _TARGETS:
        try:
            yield target, float(target.value(results))
        except KeyError:
            continue


def _first(rows: Rows, **values: Any) -> Mapping[str, Any]:
    """First row with these values."""
    for row in rows:
        if all(row[name] == value for name, value in values.items()):
            return row
    raise KeyError(str(values))


def _step(results: Results, scene: str, **values: Any) -> Mapping[str, Any]:
    """Row of ``steps.csv``."""
    where = {"scheme": _EM, "element": "full", "ranks": 1} | values
    return _first(results.steps, scene=scene, **where)


def _value(results: Results, scene: str, name: str, **values: Any) -> float:
    return float(_step(results, scene, **values)[name])


def _percent(results: Results, scene: str, name: str, **values: Any) -> float:
    return 100 * _value(results, scene, name, **values)


_share = partial(_percent, name="contact_share")  # part of contact in a step [%]


def _checks(results: Results, scheme: str, n: int) -> float:
    """Part of the checks of accepted steps in a step [%]."""
    row = _step(results, "contact", scheme=scheme, n=n)
    return 100 * sum(float(row.get(f"share: {name}", 0.0)) for name in ("passage", "overlap"))


def _ratio(
    results: Results, name: str, scene: Mapping[str, Any], other: Mapping[str, Any]
) -> float:
    return float(_step(results, **scene)[name] / _step(results, **other)[name])


def _hard(results: Results, name: str, scene: str, element: str = "full") -> float:
    """Cost of a hard scene relative to the easy scene whose steps alternated with it."""
    here, easy = {"scene": scene, "element": element}, {"scene": "beside nu = 0.499"}
    return _ratio(results, name, here, easy)


def _mortar(results: Results, name: str, scene: str, n: int) -> float:
    """Cost of surface-to-surface contact relative to node-to-segment contact."""
    mortar = {"scene": scene, "scheme": "EM mortar", "n": n}
    return _ratio(results, name, mortar, {"scene": f"beside {scene}", "n": n})


def _exponent(results: Results, n: int) -> float:
    """Exponent of the growth of cost between two meshes whose steps alternated."""
    a, b = _step(results, f"beside n = {n}"), _step(results, "contact", n=n)
    return float(np.log(b[_CPU] / a[_CPU]) / np.log(b["dofs"] / a["dofs"]))


def _explicit_in_residuals(results: Results, n: int) -> float:
    step = _value(results, "contact", _CPU, scheme=_EXPLICIT, n=n)
    return step / _value(results, "contact", "residual_seconds", n=n)


def _wide(results: Results, n: int) -> float:
    """Ratio of Krylov iterations of a wide contact with and without friction."""
    scenes = ({"scene": f"wide {s}", "scheme": "statics", "n": n} for s in ("friction", "contact"))
    return _ratio(results, "krylov_iterations", *scenes)


def _speedup(results: Results, name: str) -> float:
    one, two = ({"scene": "contact", "n": 24, "ranks": ranks} for ranks in (1, 2))
    return _ratio(results, name, one, two)


def _difference(results: Results) -> float:
    """Largest relative difference of results on one and two ranks."""
    one, two = (_step(results, "contact", n=24, ranks=ranks) for ranks in (1, 2))
    return max(abs(one[name] / two[name] - 1) for name in ("v_y", "v_z", "strain_energy"))


def _seconds(results: Results, law: str, state: str) -> float:
    return float(_first(results.start, law=law, state=state)["cpu_seconds"])


def _writing(results: Results, scheme: str, n: int) -> float:
    """CPU time of writing a row and the fields, relative to a step [%]."""
    return 100 * float(_first(results.output, scheme=scheme, n=n)["row_and_fields_in_steps"])


_SVK, _SIZES = "SaintVenantKirchhoff", (6, 12, 24, 36)
_STIFF = {"scene": "E = 1e7", "n": 6}
_TARGETS = (
    Target(
        "2 688 unknowns, 100 steps [CPU s]",
        partial(_value, scene="impact", name="cpu_seconds", n=6),
        2,
        2,
    ),
    Target(
        "16 959 unknowns, first 20 steps [CPU s]",
        partial(_value, scene="first 20 steps", name="cpu_seconds", n=12),
        2.5,
        2.5,
    ),
    Target(
        "E = 1e7 against 1e5, cost of a step",
        partial(_ratio, name=_CPU, scene=_STIFF, other={"scene": "E = 1e5, same step", "n": 6}),
        1.5,
        1.5,
    ),
    Target("E = 1e7, energy drift", partial(_value, name="energy_drift", **_STIFF), 1e-10, 1e-10),
    *(
        Target(
            f"step in contact in residuals by kernels of FFCx, n = {n}",
            partial(_value, scene="contact", name="ffcx_residuals_per_step", n=n),
            aim,
            gate,
        )
        for n, aim, gate in ((6, 25, 25), (24, 25, 34), (36, 30, 30))
    ),
    Target(
        "118 581 unknowns, step in residual evaluations",
        partial(_value, scene="contact", name=_RESIDUALS, n=24),
        60,
        60,
    ),
    Target(
        "118 581 unknowns, peak memory [MB]",
        partial(_value, scene="contact", name="peak_mb", n=24),
        2500,
        2500,
    ),
    *(
        Target(f"time ~ dofs^p, n = 6 to {n}", partial(_exponent, n=n), 1.02, 1.05)
        for n in (24, 36)
    ),
    *(
        Target(
            f"part of contact in a step, n = {n} [%]", partial(_share, scene="contact", n=n), 25, 25
        )
        for n in _SIZES
    ),
    Target(
        "part of contact in a step, pile of 27 balls with friction [%]",
        partial(_share, scene="pile, friction"),
        25,
        35,
    ),
    Target(
        "the same without contact's part in the linear solver [%]",
        partial(_percent, scene="pile, friction", name="share: search and projection"),
        25,
        35,
    ),
    *(
        Target(
            f"checks of accepted steps, {scheme}, n = {n} [% of a step]",
            partial(_checks, scheme=scheme, n=n),
            most,
            most,
        )
        for scheme, most in ((_EM, 3), (_EXPLICIT, 5))
        for n in (6, 12, 24)
    ),
    *(
        Target(
            f"central differences, step in residuals of EM elastic, n = {n}",
            partial(_explicit_in_residuals, n=n),
            1.5,
            1.5,
        )
        for n in _SIZES
    ),
    Target(
        "rho = 1 against 1000, n = 24, cost of a step",
        partial(_ratio, name=_CPU, scene={"scene": "rho = 1"}, other={"scene": "rho = 1000"}),
        5,
        5,
    ),
    *(
        Target(
            f"{name}, cost of a step",
            partial(_ratio, name=_CPU, scene={"scene": scene}, other={"scene": "contact", "n": 12}),
            2,
            2,
        )
        for name, scene in (
            ("exact friction", "friction"),
            ("friction with a spring", "friction, spring"),
        )
    ),
    *(
        Target(
            f"{name} against 0.4, cost of a step",
            partial(_hard, name=_CPU, scene=scene, element=element),
            aim,
            gate,
        )
        for name, scene, element, aim, gate in (
            ("nu = 0.499", "nu = 0.499", "full", 8, 20),
            ("nu = 0.499, friction,", "nu = 0.499, friction", "full", 15, 40),
            ("nu = 0.49, default element,", "nu = 0.49, default element", "default", 3, 5),
        )
    ),
    Target(
        "thin wall against thick, step in residuals",
        partial(_hard, name=_RESIDUALS, scene="thin wall"),
        2,
        3,
    ),
    Target(
        "neo-Hooke against St. Venant-Kirchhoff, cost of a step",
        partial(_hard, name=_CPU, scene="neo-Hooke"),
        1.3,
        1.5,
    ),
    *(
        Target(
            f"{scene} against nodes and segments, n = {n}, {what}",
            partial(_mortar, name=name, scene=scene, n=n),
            most,
            most,
        )
        for scene in ("mortar", "mortar, friction")
        for n, cost in ((6, 2), (24, 1.3))
        for what, name, most in (
            ("cost of a step", _CPU, cost),
            ("Krylov iterations", "krylov_iterations", 1.3),
        )
    ),
    *(
        Target(
            f"{scheme} against {other}, cost of a step",
            partial(
                _ratio,
                name=_CPU,
                scene={"scene": "impact", "scheme": scheme, "element": "default"},
                other={"scene": "impact", "scheme": other, "element": "default"},
            ),
            1.5,
            1.5,
        )
        for scheme, other in (("EM resolved", _EM), ("EM resolved, mortar", "EM mortar"))
    ),
    *(
        Target(
            f"{(n + 1) ** 2} nodes slide, Krylov iterations with friction against none",
            partial(_wide, n=n),
            2,
            3,
        )
        for n in (20, 44)
    ),
    Target(
        "2 025 nodes slide, 66 675 unknowns [CPU s / step]",
        partial(_value, scene="wide friction", name=_CPU, scheme="statics", n=44),
        2,
        3,
    ),
    Target("first step, nothing compiled [CPU s]", partial(_seconds, law=_SVK, state="cold"), 2, 3),
    Target(
        "the same, an energy of the user [CPU s]", partial(_seconds, law="psi", state="cold"), 5, 5
    ),
    Target("first step, all compiled [CPU s]", partial(_seconds, law=_SVK, state="warm"), 0.8, 1),
    *(
        Target(
            f"row and fields in every step, {scheme}, n = {n} [% of a step]",
            partial(_writing, scheme=scheme, n=n),
            aim,
            gate,
        )
        for scheme, aim, gate in ((_EM, 10, 15), (_EXPLICIT, 100, 100))
        for n in (6, 12, 24)
    ),
    *(
        Target(f"2 ranks against 1, n = 24, {what}", partial(_speedup, name=name), 1.7, 1.6, True)
        for what, name in (("wall time", "wall_seconds"), ("CPU time of the slower", "cpu_seconds"))
    ),
    Target("2 ranks against 1, difference of results", _difference, 1e-9, 1e-9),
)
