"""Write ball_plate.msh: a hollow ball above a plate.

Run it as ``python3 meshes/ball_plate.py``; the file is `examples.ball_plate()`
and has the same bytes each time. Lengths in metres.
"""

from pathlib import Path

import gmsh

from dolfinx_nts.meshing.parts import add_box, add_hollow_ball


def write(path: Path) -> None:
    """Write the mesh to ``path`` (MSH 4.1, ASCII)."""
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("ball_plate")
    add_hollow_ball(
        gmsh.model,
        "ball",
        centre=(0.0, -0.5, 1.05),
        inner_radius=0.8,
        outer_radius=1.0,
        cells_per_edge=6,
        layers=2,
    )
    add_box(gmsh.model, "plate", corner=(-2.0, -2.0, -0.4), size=(4.0, 4.0, 0.4), cells=(10, 10, 1))
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
    gmsh.write(str(path))
    gmsh.finalize()


if __name__ == "__main__":
    write(Path(__file__).parents[1] / "dolfinx_nts" / "meshing" / "ball_plate.msh")
