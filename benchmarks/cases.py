"""Cases of each benchmark size; data only."""

from typing import Any

__all__ = ["ERRORS", "LAWS", "MESSAGES", "OUTPUT", "STEPS"]

Rows = list[dict[str, Any]]

IMPLICIT = (
    "EM elastic",
    "EM resolved",
    "EM plastic",
    "EM penalty",
    "midpoint",
    "generalised-alpha",
)
EXPLICIT = "central differences"
# Resolved impact beside that which it is compared with, by both methods of contact.
_RESOLVED = ("EM elastic", "EM resolved", "EM mortar", "EM resolved, mortar")

# In contact from t = 0.05 on; the steps before it are not measured.
_WINDOW = {"t_start": 0.05, "t_end": 0.2}
_SHORT = {"t_start": 0.05, "t_end": 0.11}
_HARD = {"t_start": 0.08, "t_end": 0.12}
_LONG = {"t_start": 0.05, "t_end": 0.5}
_LATE = {"t_start": 0.11, "t_end": 0.14}  # no node of the coarsest ball is at its pole
_CONTACT, _IMPACT = {"scene": "contact"}, {"scene": "impact", "t_end": 1.0}
# Central differences choose their step.
_EXPLICIT = {"scheme": EXPLICIT, "h": None}
_STIFF_STEP = {"h": 0.005, "E": 1e7}
_WIDE = {"model": "sliding block", "h": 1.0, "t_start": 4.0, "t_end": 7.0}
_FRICTION = {"n": 12, "friction": 0.3, **_WINDOW}

_PILE = {"h": 0.002, "t_start": 0.04, "t_end": 0.1}

# Each item is measured in its own process. The speed of machines varies, so cases to compare share
# a process with alternating steps; where that is impossible, processes alternate. Short steps, and
# ranks on a shared machine, are repeated, and the median counts. Ranks and repetitions of a process
# are those of its first case.
_DEFAULT: list[Rows] = [
    *(
        [{**_IMPACT, "scheme": scheme, "element": "default"}]
        for scheme in IMPLICIT
        if scheme not in _RESOLVED
    ),
    [{**_IMPACT, "scheme": scheme, "element": "default"} for scheme in _RESOLVED],
    [{**_IMPACT, **_EXPLICIT, "element": "default"}],
    [{**_IMPACT}],
    [{**_IMPACT, **_EXPLICIT}],
    *([{"scene": "first 20 steps", "n": n}] for n in (6, 12)),
    [{"scene": "E = 1e7", **_EXPLICIT, "E": 1e7}],
    [{"scene": "E = 1e5, same step", "h": 0.005}, {"scene": "E = 1e7", **_STIFF_STEP}],
    [
        {**_CONTACT, "n": 6, "runs": 3, **_WINDOW},
        {**_CONTACT, "n": 12, **_WINDOW},
        {"scene": "friction", **_FRICTION},
        {"scene": "friction, spring", "eps_T": 1e5, **_FRICTION},
    ],
    [
        {"scene": "beside nu = 0.499", "n": 12, **_HARD},
        {"scene": "nu = 0.499", "n": 12, "nu": 0.499, **_HARD},
        {"scene": "nu = 0.499, friction", "n": 12, "nu": 0.499, "friction": 0.3, **_HARD},
        {"scene": "nu = 0.49, default element", "n": 12, "nu": 0.49, "element": "default", **_HARD},
        {"scene": "thin wall", "n": 12, "wall": 0.02, **_HARD},
        {"scene": "neo-Hooke", "n": 12, "law": "NeoHookean", **_HARD},
    ],
    *(
        [
            {"scene": "beside mortar", "n": n, **_WINDOW},
            {"scene": "mortar", "scheme": "EM mortar", "n": n, **_WINDOW},
            {"scene": "beside mortar, friction", **_FRICTION, "n": n},
            {"scene": "mortar, friction", "scheme": "EM mortar", **_FRICTION, "n": n},
        ]
        for n in (6, 24)
    ),
    [{"scene": "pile, friction", "model": "pile", "n": 3, "friction": 0.3, **_PILE}],
    *(
        [
            {"scene": "wide contact", "scheme": scheme, "n": n, **_WIDE},
            {"scene": "wide friction", "scheme": scheme, "n": n, "friction": 0.3, **_WIDE},
        ]
        for scheme, n in (("statics", 20), ("statics", 44), ("statics, penalty", 14))
    ),
    [
        {**_CONTACT, "n": 24, "runs": 3, **_WINDOW},
        {"scene": "beside n = 24", "n": 6, **_WINDOW},
    ],
    [{**_CONTACT, "n": 24, "ranks": 2, "runs": 3, **_WINDOW}],
    [{**_CONTACT, "n": 36, **_SHORT}, {"scene": "beside n = 36", "n": 6, **_SHORT}],
    [
        {"scene": "rho = 1", "n": 24, "rho": 1.0, **_SHORT},
        {"scene": "rho = 1000", "n": 24, **_SHORT},
    ],
    *([{**_CONTACT, **_EXPLICIT, "n": n, "runs": 3, **_LONG}] for n in (6, 12)),
    *(
        [{**_CONTACT, **_EXPLICIT, "n": 24, "ranks": ranks, "runs": 3, **_WINDOW}]
        for ranks in (1, 2)
    ),
    [{**_CONTACT, **_EXPLICIT, "n": 36, **_WINDOW}],
]

STEPS: dict[str, list[Rows]] = {
    "tiny": [
        [
            {**_CONTACT, "n": 3, **_LATE},
            {**_CONTACT, **_EXPLICIT, "n": 3, **_LATE},
        ],
        [{**_CONTACT, "n": 3, "ranks": 2, **_LATE}],
    ],
    "default": _DEFAULT,
    "full": [
        *_DEFAULT,
        *([{**_IMPACT, "scheme": scheme, "n": 12, "element": "default"}] for scheme in IMPLICIT),
        [{**_IMPACT, **_EXPLICIT, "n": 12, "element": "default"}],
        [{"scene": "E = 1e7", "n": 12, **_STIFF_STEP}],
        [{**_CONTACT, "n": 36, "ranks": 2, **_SHORT}],
        [{**_CONTACT, "n": 48, **_SHORT}],
    ],
}

# Steps of central differences, as fractions of their default step.
_PARTS = (1.0, 0.5, 0.25)
_BALL = {"problem": "ball", "n": 6, "t_end": 1.0}
_STIFF = {"problem": "stiff ball", "n": 6, "t_end": 0.2}
_BLOCK = {"problem": "block", "n": 2, "t_end": 0.1}
_BAR = {"problem": "bar", "t_end": 25.0}
_TORI = {"problem": "tori", "n": 8, "t_end": 2.0}
_OTHERS = {"full": (6, 12), "degree 2": (3, 6), "tetrahedra": (6, 12)}
_OTHERS |= {"tetrahedra, degree 2": (3, 6)}
_FEW = ("EM elastic", "EM resolved", "midpoint", "generalised-alpha")

_DEFAULT_ERRORS: Rows = [
    *(
        {**_BALL, "scheme": s, "h": (0.04, 0.02, 0.01, 0.005), "h_reference": 0.00125}
        for s in IMPLICIT
    ),
    {**_BALL, "scheme": EXPLICIT, "h": _PARTS, "h_reference": 0.0625},
    *(
        {**_STIFF, "scheme": s, "h": (0.01, 0.005, 0.0025, 0.00125), "h_reference": 0.0003125}
        for s in ("EM elastic", "EM resolved", "EM penalty", "generalised-alpha")
    ),
    {**_STIFF, "scheme": EXPLICIT, "h": _PARTS, "h_reference": 0.125},
    *(
        {**_BLOCK, "scheme": s, "h": (4e-3, 2e-3, 1e-3, 5e-4), "h_reference": 6.25e-5}
        for s in IMPLICIT
        if s != "EM resolved"  # the block has two layers of cells only
    ),
    # Waves cross a cell in two steps.
    *({**_BAR, "scheme": s, "n": n, "h": (5.0 / n,)} for s in IMPLICIT for n in (25, 50, 100)),
    *({**_BAR, "scheme": EXPLICIT, "n": n, "h": (1.0,)} for n in (25, 50, 100)),
    *(
        {"problem": problem, "scheme": s, "n": n, "h": (5.0 / n,), "t_end": t_end}
        for problem, t_end in (("two bars", 25.0), ("striker on rod", 25.0))
        for s in _FEW
        for n in (25, 50)
    ),
    *(
        {"problem": problem, "scheme": EXPLICIT, "n": n, "h": (1.0,), "t_end": 25.0}
        for problem in ("two bars", "striker on rod")
        for n in (25, 50)
    ),
    *(
        {"problem": "ball on wall", "scheme": s, "n": n, "h": (h,), "element": "tetrahedra"}
        for s in ("EM elastic", "midpoint", "generalised-alpha")
        for n, h in ((3, 1.0 / 40), (5, 1.0 / 60))
    ),
    *(
        {
            "problem": "ball on wall",
            "scheme": EXPLICIT,
            "n": n,
            "h": (1.0,),
            "element": "tetrahedra",
        }
        for n in (3, 5)
    ),
    *(
        {"problem": "braking block", "scheme": s, "n": 4, "h": (0.02, 0.01, 0.005)}
        for s in IMPLICIT
        if s != "EM resolved"  # it has no friction
    ),
    {"problem": "braking block", "scheme": EXPLICIT, "n": 4, "h": (1.0,)},
    *(
        {"problem": "paraboloid", "scheme": s, "n": n, "h": (h,)}
        # Springs on the finest mesh fail with a step of 0.25.
        for s, h in (("statics", 0.25), ("statics, mortar", 0.25), ("statics, penalty", 0.125))
        for n in (8, 12, 16)
    ),
    *(
        {**_TORI, "scheme": s, "h": (0.1, 0.05, 0.025), "h_reference": 0.00625}
        for s in ("EM elastic",)
    ),
    *(
        {**_TORI, "scheme": s, "h": (0.1, 0.05, 0.025)}
        for s in ("midpoint", "generalised-alpha", "EM penalty")
    ),
    {**_TORI, "scheme": EXPLICIT, "h": (1.0, 0.5), "h_reference": 0.125},
    # Meshes of the ball: central differences are the cheapest way to the reference.
    {**_BALL, "scheme": "EM elastic", "n": 12, "h": (0.02, 0.01)},
    *({**_BALL, "scheme": EXPLICIT, "n": n, "h": (1.0,)} for n in (12, 24)),
    # Other elements; elements of degree 2 have the nodes of 2 n cells.
    *(
        {**_BALL, "scheme": "EM elastic", "n": n, "h": (0.02,), "element": element}
        for element, meshes in _OTHERS.items()
        for n in meshes
    ),
    *(
        {**_BALL, "scheme": EXPLICIT, "n": 6, "h": (1.0,), "element": element}
        for element in _OTHERS
    ),
    *(
        {**_BAR, "scheme": "EM elastic", "n": n, "h": (5.0 / n,), "element": "degree 2"}
        for n in (12, 25, 50)
    ),
    *(
        {**_BAR, "scheme": EXPLICIT, "n": n, "h": (1.0,), "element": "degree 2"}
        for n in (12, 25, 50)
    ),
]

ERRORS: dict[str, Rows] = {
    "tiny": [
        {**_BLOCK, "n": 1, "t_end": 0.02, "scheme": s, "h": (2e-3, 1e-3), "h_reference": 1.25e-4}
        for s in ("EM elastic", "EM plastic")
    ],
    "default": _DEFAULT_ERRORS,
    "full": [
        *_DEFAULT_ERRORS,
        *(
            {**_BALL, "scheme": s, "h": (0.0025, 0.00125), "h_reference": 0.0003125}
            for s in IMPLICIT
        ),
        *({**_BALL, "scheme": EXPLICIT, "n": 12, "h": (1.0,), "element": e} for e in _OTHERS),
        {**_BALL, "scheme": "EM elastic", "n": 24, "h": (0.02,)},
        {**_BALL, "scheme": EXPLICIT, "n": 48, "h": (1.0,)},
    ],
}

MESSAGES: dict[str, Rows] = {
    "tiny": [{"n": 3, "h": 0.01, "skip": 11, "steps": 3, "ranks": 2}],
    "default": [
        {"n": n, "h": 0.01, "skip": 5, "steps": 10, "ranks": ranks}
        for n in (6, 12)
        for ranks in (2, 3, 4)
    ],
}
MESSAGES["full"] = MESSAGES["default"]

# Materials whose first step is timed: laws of the package, and a user's energy.
LAWS = {"tiny": ("psi",), "default": ("SaintVenantKirchhoff", "NeoHookean", "psi")}
LAWS["full"] = LAWS["default"]

OUTPUT: dict[str, Rows] = {
    "tiny": [{"scheme": "EM elastic", "n": 3}],
    "default": [
        {"scheme": scheme, "n": n} for scheme in ("EM elastic", EXPLICIT) for n in (6, 12, 24)
    ],
}
OUTPUT["full"] = OUTPUT["default"]
