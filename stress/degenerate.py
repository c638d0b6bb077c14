"""Bad meshes: needles, slivers, warped, doubled and inverted facets."""

from dataclasses import replace
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np

from stress.meetings import cube, falls, plate
from stress.parts import RUBBER, Part, ball, box, box_blocks, from_blocks
from stress.rows import Case, Setup
from stress.world import Touch, World

__all__ = ["CASES"]

# Message on facets with edges of zero length.
SHARP = "angle of sine"


def needles(aspect: int) -> Part:
    """Plate whose facets are long and thin."""
    return box((2, 2 * 40 / aspect, 0.3), (1, 40, 1)).at(-1, -40 / aspect, -0.3)


def slivers(angle: float) -> Part:
    """Plate 2 m wide whose facets, 0.1 m wide, are rhombi of an angle [degrees]."""
    alpha = np.deg2rad(angle)
    length = 0.1 / np.sin(alpha)
    part = box((6, 20, 0.3), (6, 20, 1)).at(-3, -10, -0.3)
    return part.moved(lambda x: (length * (x[0] + np.cos(alpha) * x[1]), 0.1 * x[1], x[2]))


def warped(height: float) -> Part:
    """Plate whose quadrangles are far from flat."""

    def move(x: Any) -> Any:
        sign = np.where((np.round(3 * (x[0] + 1)) + np.round(3 * (x[1] + 1))) % 2 > 0, 1.0, -1.0)
        return x[0], x[1], x[2] + height * sign * (x[2] > -0.1)

    return plate(2.0, 6).moved(move)


def collapsed(length: float) -> Part:
    """Plate with one edge of its top scaled by ``length`` [-]."""
    part = plate(2.0, 4)
    X = part.X.copy()
    top = np.flatnonzero(X[:, 2] > -1e-9)
    distance = np.linalg.norm(X[top], axis=1)
    middle = top[distance.argmin()]
    other = top[np.argsort(distance)[1]]
    X[other] = X[middle] + length * (X[other] - X[middle])
    return replace(part, X=X)


def mirrored() -> Part:
    """Plate whose cells are left-handed, so that normals point inwards."""
    part = plate()
    order = np.array([1, 0, 3, 2, 5, 4, 7, 6])
    return replace(part, cells=part.cells[:, order])


def islands(gap: float, size: float = 1.0) -> Part:
    """Two halves of a plate, left and right of a slot; with a slot of 0 nodes are doubled."""
    blocks = [np.add(box_blocks((size, 2, 0.3), (2, 4, 1)), (x, -1, -0.3)) for x in (-size, gap)]
    # Two parts, as blocks are joined where their nodes coincide.
    left, right = (from_blocks([block]) for block in blocks)
    first = len(left.X)
    facets = np.vstack([left.sides["all"], first + right.sides["all"]])
    X = np.vstack([left.X, right.X])
    x, z = X[facets][:, :, 0], X[facets][:, :, 2]
    of_left = np.arange(len(facets)) < len(left.sides["all"])
    sides = {"all": facets, "top": facets[(z > -1e-9).all(axis=1)]}
    sides["left"] = facets[of_left & (x > -1e-9).all(axis=1)]
    sides["right"] = facets[~of_left & (x < gap + 1e-9).all(axis=1)]
    return Part(X, np.vstack([left.cells, first + right.cells]), sides, RUBBER)


def in_a_slot(comm: MPI.Comm, gap: float) -> Setup:
    """Ball that falls on the slot between two halves of a plate. Collective."""
    parts = {
        "ball": ball(0.4, 0.2, cells=4).at(gap / 2 + 0.01, 0.02, 0.42).flying(0, 0, -1),
        "plate": islands(gap),
    }
    # Without the second pair the halves overlap, and a node lies in one and on the other.
    touches = [Touch("ball.outer", "plate.all"), Touch("plate.left", "plate.right")]
    return Setup(World(comm, parts).stepper(touches, 0.01), 0.6)


def _on(scene: str, parameter: str, value: Any, lower: Part, **how: Any) -> Case:
    upper = how.pop("upper", cube(0.5, 2).at(0.03, 0.02, 0.04))
    warns = how.pop("warns", "")
    build = partial(falls, upper=upper, lower=lower, **how)
    return Case(scene, parameter, value, build, warns=warns)


CASES = [
    *(_on("needles", "aspect", a, needles(a)) for a in (40, 200, 1000)),
    *(
        _on(f"slivers, {cell}", "angle", a, slivers(a), cell=cell)
        for cell in ("hexahedron", "tetrahedron")
        for a in (10, 3, 1, 0.1)
    ),
    *(
        _on("warped facets", "height", h, warped(h), upper=cube(0.5, 2).at(0.03, 0.02, 0.04 + h))
        for h in (0.03, 0.1)
    ),
    *(
        _on("collapsed edge", "rest", r, collapsed(r), warns=w)
        for r, w in ((1e-3, ""), (1e-9, ""), (0.0, SHARP))
    ),
    *(
        _on("facets from inside", "cells", c, mirrored(), cell=c)
        for c in ("hexahedron", "tetrahedron")
    ),
    # Nodes that slide over a step between touching halves penetrate the higher one.
    Case("disconnected surface", "slot", 0.0, partial(in_a_slot, gap=0.0)),
    *(Case("disconnected surface", "slot", g, partial(in_a_slot, gap=g)) for g in (0.1, 0.5)),
    *(
        _on(
            "tetrahedra",
            "stands on",
            pose,
            plate(),
            cell="tetrahedron",
            upper=cube(0.5, 2, pose).at(0.0, 0.0, 0.04),
        )
        for pose in ("corner", "edge", "face")
    ),
]
