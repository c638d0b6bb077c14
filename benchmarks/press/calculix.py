"""The scene in CalculiX, see `benchmarks.peers.calculix`."""

import resource
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.peers.calculix import command, surface, version
from benchmarks.peers.scene import NU, E, Floats
from benchmarks.press.scene import MU, NUM_STEPS, Scene, facets

__all__ = ["run", "version"]

# Slopes of pressure over depth and of traction over slip, relative to Young's modulus over the size
# of a cell [-]: with ten times as much face-to-face contact does not converge.
_SLOPE, _STICK, _SIZE = 50.0, 5.0, 0.0155


def run(scene: Scene, method: str, swapped: bool) -> tuple[Floats, float, int]:
    """Run the scene."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "press.inp").write_text(deck(scene, method, swapped))
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([*command(), "press"], cwd=folder, capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        lines = (Path(folder) / "press.dat").read_text().splitlines()
        increments = np.loadtxt(Path(folder) / "press.sta", skiprows=2)
    rows = [line.split()[1:] for line in lines if line.lstrip()[:1].isdigit()]
    u = np.array(rows, dtype=float).reshape(NUM_STEPS, *scene.X.shape)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    x = scene.X + np.concatenate([np.zeros((1, *scene.X.shape)), u])
    return x, cpu, int(increments[:, 3].sum())


def deck(scene: Scene, method: str, swapped: bool) -> str:
    """Input of CalculiX."""
    sides = "LOWER, UPPER" if swapped else "UPPER, LOWER"
    lines = [
        "*NODE, NSET=NALL",
        *(f"{i + 1}, {x:.17g}, {y:.17g}, {z:.17g}" for i, (x, y, z) in enumerate(scene.X)),
        "*ELEMENT, TYPE=C3D8, ELSET=EALL",
        *(f"{i + 1}, {', '.join(map(str, cell + 1))}" for i, cell in enumerate(scene.cells)),
        *("*NSET, NSET=LED", *(str(node + 1) for node in scene.moved.ravel())),
        *("*NSET, NSET=HELD", *(str(node + 1) for node in scene.held.ravel())),
        *surface("UPPER", scene.cells, facets(scene.outer)),
        *surface("LOWER", scene.cells, facets(scene.top)),
        *("*MATERIAL, NAME=RUBBER", "*ELASTIC", f"{E}, {NU}"),
        "*SOLID SECTION, ELSET=EALL, MATERIAL=RUBBER",
        "*SURFACE INTERACTION, NAME=TOUCH",
        *("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", f"{_SLOPE * E / _SIZE}"),
        *("*FRICTION", f"{MU}, {_STICK * E / _SIZE}"),
        *(f"*CONTACT PAIR, INTERACTION=TOUCH, TYPE={method}", sides),
        *("*BOUNDARY", "NALL, 2, 2", "HELD, 1, 3"),
    ]
    for step in range(1, NUM_STEPS + 1):
        x, _, z = scene.travel(step)
        lines += ["*STEP, NLGEOM", "*STATIC, DIRECT", "1., 1."]
        lines += ["*BOUNDARY", f"LED, 1, 1, {x:.12g}", f"LED, 3, 3, {z:.12g}"]
        lines += ["*NODE PRINT, NSET=NALL", "U", "*END STEP"]
    return "\n".join(lines) + "\n"
