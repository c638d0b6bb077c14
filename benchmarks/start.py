"""Time to the first result: a process that starts with nothing compiled, and one after it.

Run as ``python3 -m benchmarks.start '{"law": ...}'`` in a process of its own, which takes the
first step of the ball on the plate and prints CPU and wall time as JSON. Kernels are kept in the
folder that XDG_CACHE_HOME names.
"""

import json
import os
import resource
import sys
import time
from pathlib import Path
from typing import Any

__all__ = ["first_step"]

_OWN = "psi"  # a law that is not of the package


def first_step(law: str) -> dict[str, Any]:
    """Row of ``start.csv``: seconds from the start of the process to the first accepted step.

    CPU time is that of the process and of the compilers that it runs.

    Args:
        law: Name of a material of the package, or ``"psi"``.
    """
    from mpi4py import MPI

    import ufl
    from dolfinx import fem

    import dolfinx_nts as nts

    def psi(C: Any, mu: Any, kappa: Any) -> Any:
        J = ufl.sqrt(ufl.det(C))
        return mu / 2 * (ufl.tr(C) - 3 - 2 * ufl.ln(J)) + kappa / 4 * (J**2 - 1 - 2 * ufl.ln(J))

    path = Path(__file__).parents[1] / "dolfinx_nts" / "meshing" / "ball_plate.msh"
    mesh, cells, facets, tag = nts.read_mesh(path, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    if law == _OWN:
        material = nts.Hyperelastic(psi, rho=1e3, mu=3.5e4, kappa=1.4e5)
    else:
        material = getattr(nts, law)(E=1e5, nu=0.4, rho=1e3)
    ball, plate = (nts.Body(V, cells, tag[name], material) for name in ("ball", "plate"))
    surfaces = (nts.Surface(V, facets, tag[name]) for name in ("ball_outer", "plate_top"))
    pair = nts.ContactPair(*surfaces, nts.LagrangeMultiplier(), method="node-to-segment")
    stepper = nts.EnergyMomentum([ball, plate], [pair], dt=0.01)
    stepper.set_velocity(ball, (0.0, 1.0, -1.0))
    stepper.advance()
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu = sum(usage.ru_utime + usage.ru_stime for usage in used)
    return {"law": law, "cpu_seconds": cpu, "wall_seconds": time.time() - _started()}


def _started() -> float:
    """Time at which this process has started [s since the epoch], on Linux."""
    ticks = int(Path("/proc/self/stat").read_text().rsplit(")", 1)[1].split()[19])
    boot = time.time() - float(Path("/proc/uptime").read_text().split()[0])
    return boot + ticks / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    print("ROW", json.dumps(first_step(**json.loads(sys.argv[1]))))
