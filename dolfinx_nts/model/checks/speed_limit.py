"""Check for velocities above the wave speed, mostly due to inconsistent units."""

import logging
import math

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.materials.strain_energy import STRETCHES
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions

__all__ = ["warn_of_speed", "wave_speed"]

_logger = logging.getLogger("dolfinx_nts")


def wave_speed(body: Body) -> float:
    """Largest speed of P-waves along an axis in the undeformed body [m/s]. Local.

    It is infinite for rigid bodies and for moduli that vary in space.
    """
    if body.is_rigid or body.material.has_fields:
        return math.inf
    stiffest = body.material.moduli.diagonal()[STRETCHES].max()
    return math.sqrt(stiffest / body.material.rho)


def warn_of_speed(body: Body, v: Floats) -> None:
    """Warn of a body whose velocity exceeds its wave speed. Collective.

    Args:
        body: The body.
        v: Velocities of its local nodes, shape ``(n, d)`` [m/s].
    """
    comm = body.V.mesh.comm
    fastest = reductions.largest(comm, float(np.linalg.norm(v, axis=1).max(initial=0.0)))
    waves = wave_speed(body)
    if fastest > waves and comm.rank == 0:
        _logger.warning(
            "%s moves at up to %.3g, faster than waves in it (%.3g): harmless if all bodies move "
            "together; otherwise an impact will crush it, so check that lengths, E, rho and "
            "velocity are in consistent units (m, Pa, kg/m^3, m/s, or mm, MPa, t/mm^3, mm/s)",
            body.name,
            fastest,
            waves,
        )
