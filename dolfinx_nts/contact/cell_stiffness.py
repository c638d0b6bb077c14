"""Stiffness of the cells at the springs of a contact pair.

A layer of cells of height h, between nodes, and P-wave modulus M has the stiffness M/h per area.
"""

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.layers import layers
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["SOFT", "depth_per_speed", "layers_in_series", "softer_layer"]

# Compliance of a default spring with inertia relative to that of the cells [-]: of the cells of
# both sides in explicit steps, whose forces are those at one end, of the softer side in implicit
# steps. Smaller: nodes vibrate at frequencies above those of the cells, which waves cannot carry
# away. The contact force of colliding rods then scatters permanently by 15 % (1), 9 % (1.25), 4 %
# (5/3), 3 % (2) of its mean in explicit steps, and by 8 % (1.1), 5 % (4/3), 3 % (5/3) in implicit
# steps. Larger: more penetration, and lower peaks of impact forces unless the spring becomes
# stiffer: for a ball on a block of 6 cells by 5 % (1.1), 6 % (4/3), 7 % (5/3). Measured on the rods
# of tests/verification/impact/test_rods.py with 40 cells and in benchmarks.defaults.
SOFT = 5 / 3
# Compression up to which springs are soft, relative to the compression by the pressure of plane
# waves [-]. Larger: with 2.4 instead of 1.5 the peak force of the ball is 4.5 instead of 1.9 % too
# small; smaller (1.2: 1.4 %): vibration exceeds that pressure, and would persist where springs are
# stiff.
_BEYOND_WAVES = 1.5


def layers_in_series(pair: ContactPair, modulus: Floats) -> Floats:
    """Stiffness of the layers of both sides of a pair in series. Collective.

    Args:
        pair: The pair.
        modulus: P-wave modulus at the owned nodes, shape ``(n,)`` [Pa]; infinite in bodies that do
            not deform, and where the modulus vanishes, so that cells do not limit the spring
            stiffness.

    Returns:
        At each node of the surface of nodes, shape ``(m,)`` [N/m]; infinite where nothing deforms.
    """
    area, own, other = _compressions(pair, modulus)
    return _stiffness(area, own + other)


def softer_layer(pair: ContactPair, modulus: Floats) -> Floats:
    """Stiffness of the softer layer of both sides, see `layers_in_series`. Collective."""
    area, own, other = _compressions(pair, modulus)
    return _stiffness(area, np.maximum(own, other))


def depth_per_speed(pair: ContactPair, modulus: Floats, density: Floats) -> Floats:
    """Compression at which default springs change to the stiff slope, per impact speed. Collective.

    Where surfaces meet at a relative speed v, plane waves of both sides of the impedances
    Z = rho c exert the pressure v/(1/Z_1 + 1/Z_2). Springs keep their soft slope up to one and a
    half times this pressure.

    Args:
        pair: The pair.
        modulus: As in `softer_layer`.
        density: Density at the owned nodes, shape ``(n,)`` [kg/m^3].

    Returns:
        At each node of the surface of nodes, shape ``(m,)`` [s].
    """
    _, own, other = _compressions(pair, modulus)
    slowness = 1 / np.sqrt(density * modulus)  # 0 in rigid bodies
    of_both = slowness[pair.nodes.nodes]
    if isinstance(pair.segments, Surface):
        area, compression = layers(pair.segments, modulus)
        of_both = of_both + _mean(pair, area, slowness[pair.segments.nodes], compression > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth: Floats = _BEYOND_WAVES * SOFT * np.maximum(own, other) / of_both
    return depth


def _compressions(pair: ContactPair, modulus: Floats) -> tuple[Floats, Floats, float]:
    """Areas of the nodes, and compression of the layers of both sides per pressure. Collective.

    Returns:
        Area and compression at each node of the surface of nodes, shape ``(m,)`` [m^2] and [m/Pa];
        mean compression of the segments where they deform [m/Pa].
    """
    nodes, segments = pair.nodes, pair.segments
    area, own = layers(nodes, modulus)
    if not isinstance(segments, Surface):
        return area, own, 0.0
    of_segments, other = layers(segments, modulus)
    return area, own, _mean(pair, of_segments, other, other > 0)


def _mean(pair: ContactPair, area: Floats, values: Floats, deforms: Flags) -> float:
    """Mean of values at the deformable nodes of the segments; 0 without any. Collective."""
    sums = np.array([area[deforms] @ values[deforms], area[deforms].sum()])
    sums = reductions.total(pair.nodes.V.mesh.comm, sums)
    return float(sums[0] / sums[1]) if sums[1] > 0 else 0.0


def _stiffness(area: Floats, compression: Floats) -> Floats:
    with np.errstate(divide="ignore"):
        stiffness: Floats = area / compression
    return stiffness
