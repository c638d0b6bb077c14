"""A hollow ball that flies obliquely onto a free plate, as plain arrays."""

from pathlib import Path
from typing import NamedTuple

import gmsh
import numpy as np
import numpy.typing as npt

__all__ = ["NU", "RHO", "T_END", "VELOCITY", "E", "H", "Run", "Scene", "num_steps", "read"]

MESH = Path(__file__).parents[2] / "dolfinx_nts" / "meshing" / "ball_plate.msh"
# Young's modulus [Pa], Poisson's ratio, density [kg/m^3] of both bodies; step and end [s]. At the
# end the ball has left the plate.
E, NU, RHO, H, T_END = 1e5, 0.4, 1e3, 0.01, 2.0
# Initial velocity of the ball [m/s].
VELOCITY = (0.0, 1.0, -1.0)
num_steps = round(T_END / H)

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Scene(NamedTuple):
    """Mesh of the scene.

    Attributes:
        X: Nodes, shape ``(n, 3)`` [m].
        ball, plate: Hexahedra, shape ``(c, 8)``, nodes in the order of gmsh.
        outer, top: Facets of the ball and of the plate in contact, shape ``(f, 4)``, once around.
    """

    X: Floats
    ball: Ints
    plate: Ints
    outer: Ints
    top: Ints

    @property
    def cells(self) -> Ints:
        """All hexahedra."""
        return np.concatenate([self.ball, self.plate])

    @property
    def start(self) -> Floats:
        """Velocity at the start, shape ``(n, 3)`` [m/s]."""
        v = np.zeros_like(self.X)
        v[np.unique(self.ball)] = VELOCITY
        return v


class Run(NamedTuple):
    """Result of a code.

    Attributes:
        x, v: Positions [m] and velocities [m/s] at the start and after each step, shape
            ``(steps + 1, n, 3)``.
        cpu_seconds: Time of the steps, without reading the mesh and compiling.
        newton_iterations: Of all steps; NaN for explicit ones.
        has_lumped_mass: Whether the mass of each row is lumped at its node.
        has_one_point: Whether one point a cell has the energy of changes of volume.
    """

    x: Floats
    v: Floats
    cpu_seconds: float
    newton_iterations: float
    has_lumped_mass: bool = False
    has_one_point: bool = False


def read() -> Scene:
    """Read the mesh."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(MESH))
    tags, x, _ = gmsh.model.mesh.getNodes()
    place = np.empty(int(tags.max()) + 1, dtype=np.int64)
    place[tags] = np.arange(len(tags))
    groups = gmsh.model.getPhysicalGroups()
    names = {gmsh.model.getPhysicalName(*group): group for group in groups}

    def elements(name: str, size: int) -> Ints:
        dim, group = names[name]
        nodes = [
            gmsh.model.mesh.getElements(dim, entity)[2][0]
            for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group)
        ]
        return place[np.concatenate(nodes)].reshape(-1, size)

    scene = Scene(
        x.reshape(-1, 3),
        *(elements(name, 8) for name in ("ball", "plate")),
        *(elements(name, 4) for name in ("ball_outer", "plate_top")),
    )
    gmsh.finalize()
    return scene
