"""The scene in CalculiX, whose program ``ccx`` is given by the variable CCX or on the path.

Face-to-face penalty contact, St. Venant-Kirchhoff material (``*ELASTIC`` with NLGEOM), the
trapezoidal rule of ``*DYNAMIC`` with the damping that CalculiX has of its own.
"""

import os
import re
import resource
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.peers.scene import NU, RHO, VELOCITY, E, Floats, H, Ints, Run, Scene, num_steps

__all__ = ["command", "deck", "run", "surface", "version"]

# Nodes of the faces of a hexahedron in the numbering of CalculiX.
_FACES = ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0))
# Slope of pressure over depth, relative to Young's modulus per metre [-]: the largest of the
# range that the manual advises.
_SLOPE = 50


def command() -> list[str]:
    """Command that runs CalculiX; empty where it is not installed."""
    return shlex.split(os.environ.get("CCX") or shutil.which("ccx") or "")


def version() -> str:
    """Version that the program prints."""
    text = subprocess.run([*command(), "-v"], capture_output=True, text=True, check=False).stdout
    return found[1] if (found := re.search(r"[Vv]ersion (\S+)", text)) else "unknown"


def run(scene: Scene) -> Run:
    """Run the scene."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "impact.inp").write_text(deck(scene))
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([*command(), "impact"], cwd=folder, capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        u, v = _printed(Path(folder) / "impact.dat", len(scene.X))
        increments = np.loadtxt(Path(folder) / "impact.sta", skiprows=2)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    x = scene.X + np.concatenate([np.zeros((1, *scene.X.shape)), u])
    return Run(x, np.concatenate([scene.start[None], v]), cpu, float(increments[:, 3].sum()))


def deck(scene: Scene) -> str:
    """Input of CalculiX."""
    nodes = [f"{i + 1}, {x:.17g}, {y:.17g}, {z:.17g}" for i, (x, y, z) in enumerate(scene.X)]
    cells = [f"{i + 1}, {', '.join(map(str, cell + 1))}" for i, cell in enumerate(scene.cells)]
    speeds = [
        f"{node + 1}, {d + 1}, {value}"
        for node in np.unique(scene.ball)
        for d, value in enumerate(VELOCITY)
    ]
    return "\n".join(
        [
            *("*NODE, NSET=NALL", *nodes),
            *("*ELEMENT, TYPE=C3D8, ELSET=EALL", *cells),
            *surface("OUTER", scene.cells, scene.outer),
            *surface("TOP", scene.cells, scene.top),
            *("*MATERIAL, NAME=RUBBER", "*ELASTIC", f"{E}, {NU}", "*DENSITY", f"{RHO}"),
            "*SOLID SECTION, ELSET=EALL, MATERIAL=RUBBER",
            *("*SURFACE INTERACTION, NAME=TOUCH",),
            *("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", f"{_SLOPE * E}"),
            "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE",
            "OUTER, TOP",
            *("*INITIAL CONDITIONS, TYPE=VELOCITY", *speeds),
            *(f"*STEP, NLGEOM, INC={2 * num_steps}", "*DYNAMIC, DIRECT", f"{H}, {H * num_steps}"),
            *("*NODE PRINT, NSET=NALL, FREQUENCY=1", "U, V"),
            "*END STEP\n",
        ]
    )


def surface(name: str, cells: Ints, facets: Ints) -> list[str]:
    """Lines of a surface, whose facets are named by their cells."""
    wanted = {frozenset(facet) for facet in facets.tolist()}
    faces = [
        f"{i + 1}, S{number + 1}"
        for i, cell in enumerate(cells.tolist())
        for number, face in enumerate(_FACES)
        if frozenset(cell[k] for k in face) in wanted
    ]
    return [f"*SURFACE, NAME={name}, TYPE=ELEMENT", *faces]


def _printed(path: Path, num_nodes: int) -> tuple[Floats, Floats]:
    """Displacements and velocities of all increments."""
    lines = [line for line in path.read_text().splitlines() if line.strip()]
    blocks = np.array([line.split() for line in lines if line.lstrip()[0].isdigit()], dtype=float)
    blocks = blocks[:, 1:].reshape(-1, 2, num_nodes, 3)
    return blocks[:, 0], blocks[:, 1]
