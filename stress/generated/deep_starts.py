"""Bodies with initial overlap, from a fraction of a facet to several facets."""

from functools import partial
from itertools import product

import numpy as np

import dolfinx_nts as nts
from stress.generated.case import Case
from stress.generated.checks import Touching
from stress.generated.judge import column_force
from stress.generated.scene import Scene, grid

__all__ = ["CASES"]

_E = 1e6  # Pa
_METHODS = ("node-to-segment", "mortar", "all pairs")
# Overlap relative to a facet [-].
_RATIOS = (0.2, 0.45, 0.6, 1.0, 1.4, 2.0, 3.0)
# Cells in the height of 1 m.
_CELLS = (4, 8)
# Error of the force: node-to-segment contact transmits uniform pressure inexactly.
TOLERANCE = 0.02


def _press(
    rng: np.random.Generator, dim: int, cells: int, ratio: float, method: str, simplices: bool
) -> str:
    """Two stacked columns between two walls whose distance is less than the sum of both heights."""
    h = 1 / cells
    overlap = ratio * h * rng.uniform(0.97, 1.03)
    flat = (0.0,) * (dim - 1)
    low = grid((*flat, 0), (*(2 * h for _ in flat), 1), (*(2 for _ in flat), cells))
    up = grid((*flat, 1 - overlap), (*(2 * h for _ in flat), 1), (*(2 for _ in flat), cells))
    # Nodes of the columns do not coincide, except at the corners.
    skew = rng.uniform(-0.3, 0.3)
    up = up.moved(lambda *x: (*(s + skew * s * (2 * h - s) / h for s in x[:-1]), x[-1]))
    scene = Scene({"low": low, "up": up}, nts.NeoHookean(E=_E, nu=0.0, rho=1e3), simplices)
    bodies = list(scene.bodies.values())
    if method == "all pairs":
        pairs = nts.all_pairs(
            bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )
    else:
        nodes = scene.surface("up", lambda x: np.isclose(x[-1], 1 - overlap))
        segments = scene.surface("low", lambda x: np.isclose(x[-1], 1))
        pairs = [
            nts.ContactPair(nodes, segments, method=method, enforcement=nts.LagrangeMultiplier())
        ]
    held = [
        scene.held("low", lambda x: np.isclose(x[-1], 0)),
        scene.held("up", lambda x: np.isclose(x[-1], 2 - overlap)),
        # Columns without lateral supports may buckle.
        *(scene.guided(name, axis) for name in scene.bodies for axis in range(dim - 1)),
    ]
    stepper = nts.QuasiStatic(bodies, pairs, dt=1.0, bcs=held)
    before = scene.positions(stepper)
    step = stepper.advance()
    force = -step.reactions[0].force[-1], step.reactions[1].force[-1]
    expected = -column_force(1 - overlap / 2, _E, (2 * h) ** (dim - 1))
    for some in force:
        if abs(abs(some) - expected) > TOLERANCE * expected:
            return f"force {abs(some):.5g} N, {expected:.5g} N expected"
    # `all_pairs` chooses the body that gives the nodes.
    is_low = bool(np.isin(pairs[0].nodes.nodes, scene.cells_of("low")).all())
    sides = [scene.boundary(name) for name in (("low", "up") if is_low else ("up", "low"))]
    touching = Touching(*sides, h, _E, method == "mortar")
    return touching.wrong(before, scene.positions(stepper))


CASES = [
    Case(
        f"deep start, {method}",
        f"deep-{dim}d{'-simplices' if simplices else ''}-{method.replace(' ', '-')}"
        f"-n{cells}-ratio{ratio}",
        partial(_press, dim=dim, cells=cells, ratio=ratio, method=method, simplices=simplices),
        may_refuse_setup=True,
    )
    for method, dim, simplices, cells, ratio in product(
        _METHODS, (2, 3), (False, True), _CELLS, _RATIOS
    )
    # Up to half of the thickness, beyond which a refusal is right.
    if ratio / cells < 0.48 and (not simplices or dim == 3)
]
