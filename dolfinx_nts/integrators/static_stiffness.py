"""Stiffness of nodes without inertia, by which springs of contact are chosen."""

from collections.abc import Iterator
from contextlib import contextmanager

from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["long_step", "static_stiffness"]

# Length of a step, relative to that of the run [-], in which inertia and damping are nothing.
_LONG = 1e12


@contextmanager
def long_step(dt: fem.Constant) -> Iterator[None]:
    """Context in which a step is so long that forms have neither inertia nor damping. Local.

    Args:
        dt: Length of a step in forms [s].
    """
    length = float(dt.value)
    dt.value = _LONG * length
    try:
        yield
    finally:
        dt.value = length


def static_stiffness(tangent: Tangent, dt: fem.Constant, share: float) -> Floats:
    """Mean diagonal entry of the static stiffness at each owned node. Collective.

    Inertia in a tangent grows as 1/dt^2: springs that follow it become stiffer with shorter
    steps, so that their motion is never resolved.

    Args:
        tangent: Tangent of a step, which forgets its matrix.
        dt: Length of a step in its forms [s].
        share: Part of the stiffness in them [-], see `Scheme.stress_share`.

    Returns:
        Stiffness, shape ``(n,)`` [N/m].
    """
    with long_step(dt):
        tangent.assemble_nearby()
        stiffness = tangent.nodal_stiffness()
        tangent.forget()
    static: Floats = (1 / share) * stiffness
    return static
