"""Bars with E = rho = c = 1 and Poisson's ratio 0, against wave theory.

They are so slow that linear theory holds.
"""

from typing import Any

from mpi4py import MPI

from dolfinx import fem

import dolfinx_nts as nts
from benchmarks.scenes import ELEMENTS, SCHEMES, Scene
from dolfinx_nts.meshing.parts import add_box

__all__ = ["LENGTH", "SPEED", "bar_on_bar", "bar_on_wall"]

# Length of a bar, edge of its section, speed: SI units.
LENGTH, _SIDE, SPEED = 10.0, 1.0, 1e-3
_MATERIAL = {"E": 1.0, "nu": 0.0, "rho": 1.0}


def bar_on_wall(comm: MPI.Comm, scheme: str, h: float | None, *, n: int, element: str) -> Scene:
    """Bar that strikes a rigid wall.

    From the touch at t = 0 on the mean velocity grows linearly, from -v to v, in 2 L/c.
    Collective.
    """

    def build(model: Any) -> None:
        _add(model, "bar", 0.0, LENGTH, n, element)

    mesh, tags, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", ELEMENTS[element].degree, (3,)))
    bar = nts.Body(V, tags, tag["bar"], nts.SaintVenantKirchhoff(**_MATERIAL))
    wall = nts.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    pair = SCHEMES[scheme].pair(nts.Surface(V, facets, tag["bar_bottom"]), wall)
    stepper = SCHEMES[scheme].integrator([bar], [pair], dt=h)
    stepper.set_velocity(bar, (0.0, 0.0, -SPEED))
    diagnostics = nts.Diagnostics(stepper)
    return Scene(
        stepper, bar, lambda: {"rebound": float(diagnostics.body_velocity(bar)[2] / SPEED)}
    )


def bar_on_bar(
    comm: MPI.Comm, scheme: str, h: float | None, *, n: int, element: str, ratio: int
) -> Scene:
    """Bar that strikes a resting bar ``ratio`` times as long.

    After release the first bar is at rest and the second one has its momentum. Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step [s]; None: what central differences choose.
        n: Cells along the striking bar.
        element: Key of `ELEMENTS`.
        ratio: Length of the struck bar relative to that of the striking one.
    """

    def build(model: Any) -> None:
        _add(model, "struck", -ratio * LENGTH, ratio * LENGTH, ratio * n, element)
        _add(model, "striker", 0.0, LENGTH, n, element)

    mesh, tags, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", ELEMENTS[element].degree, (3,)))
    material = nts.SaintVenantKirchhoff(**_MATERIAL)
    striker, struck = (nts.Body(V, tags, tag[name], material) for name in ("striker", "struck"))
    sides = (nts.Surface(V, facets, tag[name]) for name in ("striker_bottom", "struck_top"))
    stepper = SCHEMES[scheme].integrator([striker, struck], [SCHEMES[scheme].pair(*sides)], dt=h)
    stepper.set_velocity(striker, (0.0, 0.0, -SPEED))
    diagnostics = nts.Diagnostics(stepper)

    def judge() -> dict[str, float]:
        mean = diagnostics.body_velocity(struck)[2]
        return {"velocity handed on": float(-ratio * mean / SPEED)}

    return Scene(stepper, struck, judge)


def _add(model: Any, name: str, low: float, length: float, cells: int, element: str) -> None:
    add_box(
        model,
        name,
        corner=(0.0, 0.0, low),
        size=(_SIDE, _SIDE, length),
        cells=(1, 1, cells),
        cell=ELEMENTS[element].cell,
    )
