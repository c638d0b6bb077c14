"""Make the figures of the documentation.

    python3 docs/figures.py [NAME...]

runs the demos, or those with the names, and copies their pictures to ``docs/figures``; ``peers``
is the comparison on the first screen, ``first_impact`` what its script computes, ``schemes`` what
scheme and law of impact do to the energy, ``laws`` the force by all laws, ``methods`` the pressure
by both methods of contact. Takes a few minutes.
"""

import csv
import os
import runpy
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "docs" / "figures"

# Pictures of the demos.
DEMOS = {
    "ball_plate": ["ball_plate.png", "ball_plate_pressure.png"],
    "bar_impact": ["bar_impact_force.png"],
    "bowl": ["bowl.png"],
    "drop_test": ["drop_test.png"],
    "drum": ["drum.png"],
    "finger": ["finger.png"],
    "gripper": ["gripper.png"],
    "hammer": ["hammer_force.png"],
    "hertz": ["hertz_force.png", "hertz_pressure.png"],
    "hollow_seal": ["hollow_seal.png"],
    "identification": ["identification.png", "identification_path.png"],
    "indentation": ["indentation.png"],
    "inflation": ["inflation.png"],
    "ironing": ["ironing.png", "ironing_force.png"],
    "own_energy": ["own_energy.png"],
    "own_geometry": ["own_geometry.png"],
    "pile": ["pile.png"],
    "plane": ["plane.png"],
    "punch": ["punch.png"],
    "resume": ["resume_forces.png"],
    "rings": ["rings.png", "rings_ledger.png"],
    "rolling": ["rolling_speed.png"],
    "seal": ["seal.png"],
    "self_contact": ["self_contact.png"],
    "snap_fit": ["snap_fit.png"],
    "taylor_bar": ["taylor_bar.png"],
    "tori": ["tori.png"],
}


def demo(name: str) -> None:
    """Run a demo in a folder of its own and copy its pictures."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        (script,) = (ROOT / "demos").rglob(f"demo_{name}.py")
        runpy.run_path(str(script), run_name="__main__")
        for picture in DEMOS[name]:
            shutil.copy(picture, FIGURES / picture)
        os.chdir(ROOT)


def peers() -> None:
    """Computing time and change of energy of the first impact, from the table of the bench."""
    lines = (ROOT / "docs" / "tables" / "peers.md").read_text(encoding="utf-8").splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines]
    names = ("dolfinx_nts 0", "CalculiX", "GetFEM", "IPC")
    shown = [next(row for row in cells if row[0].startswith(name)) for name in names]
    labels = [row[0].removesuffix(" 0.2.0") for row in shown]
    figure, axes = plt.subplots(1, 2, figsize=(10, 2.4), dpi=160, layout="constrained", sharey=True)
    for axis, column, title in zip(
        axes,
        (4, 6),
        ("CPU time of 200 steps [s]", "relative change of the energy [-]"),
        strict=True,
    ):
        values = [abs(float(row[column])) for row in shown]
        bars = axis.barh(labels, values, color=["tab:blue", *["0.7"] * 3], log=True)
        axis.bar_label(bars, [f"{value:.3g}" for value in values], padding=3)
        axis.set(title=title, xlim=(min(values) / 4, max(values) * 8))
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].invert_yaxis()
    figure.savefig(FIGURES / "peers.png")


def first_impact() -> None:
    """The ball of the README's script in contact, and the force and energy of its table."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    script = text.split("```python\n")[1].split("```")[0]
    figure, (scene, curves) = plt.subplots(
        1, 2, figsize=(10, 3.4), dpi=160, layout="constrained", width_ratios=(1.2, 1)
    )
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        names: dict[str, Any] = {}
        exec(script.replace("until=2.0", "until=0.5"), names)
        plotting.snapshot(names["stepper"], "scene.png", cut=(1, 0, 0))
        scene.imshow(plt.imread("scene.png"))
        exec(script, {})
        table = rows(Path("ball_plate.csv"))
        os.chdir(ROOT)
    scene.set_axis_off()
    start, every = table["total_energy"][0], ("kinetic_energy", "strain_energy", "total_energy")
    for name in every:
        curves.plot(table["time"], table[name], label=name.replace("_", " "))
    curves.set(xlabel="time [s]", ylabel="energy [J]", ylim=(0, 1.35 * start))
    other = curves.twinx()
    other.plot(table["time"], table["contact_force_z"] / 1e3, "k", label="contact force")
    other.set(ylabel="contact force [kN]", ylim=(0, 1.35 * table["contact_force_z"].max() / 1e3))
    lines = [*curves.get_lines(), *other.get_lines()]
    curves.legend(lines, [str(line.get_label()) for line in lines], loc="upper right", ncols=2)
    figure.savefig(FIGURES / "first_impact.png")


def rows(table: Path) -> dict[str, npt.NDArray[np.float64]]:
    """Columns of a table by name."""
    with table.open(newline="") as file:
        lines = list(csv.DictReader(file))
    return {name: np.array([float(line[name]) for line in lines]) for name in lines[0]}


def recorded(stepper: nts.EnergyMomentum, until: float) -> dict[str, npt.NDArray[np.float64]]:
    """Run; columns of the table."""
    with tempfile.TemporaryDirectory() as folder:
        with nts.Recorder(Path(folder) / "run", stepper, every=10**6) as record:
            for step in stepper.run(until):
                record.write(step)
        return rows(Path(folder) / "run.csv")


def schemes() -> None:
    """What changes the energy of the impact, by scheme and law of impact."""
    figure, grid = plt.subplots(
        2, 2, figsize=(10, 6), dpi=160, sharex=True, sharey=True, layout="constrained"
    )
    causes = {
        "bulk": "stress of the scheme",
        "persistent_contact": "nodes that stay in contact",
        "activation": "nodes that become active or part",
        "facet_change": "nodes that change to another facet",
    }
    for line, scheme in zip(grid, (nts.Midpoint, nts.EnergyMomentum), strict=True):
        for axes, law in zip(line, ("plastic", "elastic"), strict=True):
            table = recorded(scene(scheme, law), 1.0)
            for name, label in causes.items():
                axes.plot(table["time"], table[f"energy_{name}"], label=label)
            total = table["total_energy"] - table["total_energy"][0]
            axes.plot(table["time"], total, "k--", label="total energy")
            axes.set_title(f"{scheme.__name__}, {law} impact")
            axes.grid(alpha=0.3)
        line[0].set_ylabel("change of the energy [J]")
    for axes in grid[1]:
        axes.set_xlabel("time [s]")
    grid[0, 1].legend(loc="lower left")
    figure.savefig(FIGURES / "schemes.png")


def laws() -> None:
    """Force of a bar that strikes a wall, by all laws of impact, against wave theory."""
    choices = {
        "LagrangeMultiplier()": nts.LagrangeMultiplier(),
        'LagrangeMultiplier("plastic")': nts.LagrangeMultiplier("plastic"),
        'LagrangeMultiplier("resolved")': nts.LagrangeMultiplier("resolved"),
        'LagrangeMultiplier("restitution", e=0.5)': nts.LagrangeMultiplier("restitution", e=0.5),
        'LagrangeMultiplier("restitution", e=0.0)': nts.LagrangeMultiplier("restitution", e=0.0),
        "Penalty()": nts.Penalty(),
    }
    figure, grid = plt.subplots(
        2, 3, figsize=(13, 6), dpi=160, sharex=True, sharey=True, layout="constrained"
    )
    cells, gap = 20, 0.01
    for axes, (title, law) in zip(grid.flat, choices.items(), strict=True):
        shape = {"corner": (gap, 0, 0), "size": (1, 0.05, 0.05), "cells": (cells, 1, 1)}
        mesh, tags, facets, tag = nts.read_mesh(
            lambda model, shape=shape: parts.add_box(model, "bar", **shape), MPI.COMM_SELF
        )
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        # Waves have the speed 1 and no lateral contraction; a step is half of one through a cell.
        bar = nts.Body(V, tags, tag["bar"], nts.SaintVenantKirchhoff(1.0, 0.0, 1.0))
        wall = nts.RigidPlane((0, 0, 0), (1, 0, 0))
        pair = nts.ContactPair(nts.Surface(V, facets, tag["bar_left"]), wall, law)
        stepper = nts.EnergyMomentum([bar], [pair], dt=0.5 / cells)
        stepper.set_velocity(bar, (-gap, 0, 0))
        table = recorded(stepper, 3.5)
        force = table["contact_force_x"] / (gap * 0.05**2)
        axes.plot([0, 1, 1, 3, 3, 3.5], [0, 0, 1, 1, 0, 0], "k", lw=1, label="wave theory")
        axes.plot(table["time"], force, label="computed")
        axes.set_title(title)
        axes.grid(alpha=0.3)
    grid[0, 0].legend()
    for axes in grid[:, 0]:
        axes.set_ylabel(r"force / ($\rho$ c v A)")
    for axes in grid[1]:
        axes.set_xlabel("time [L / c]")
    figure.savefig(FIGURES / "laws.png")


def methods() -> None:
    """Nodal pressure below a paraboloid on a block by both methods of contact, and Hertz's."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), dpi=200, sharey=True, layout="constrained")
    line = np.linspace(0, 1, 200)
    for ax, method in zip(axes, ("node-to-segment", "mortar"), strict=True):
        for label, marker, swapped in (("finer", ".", False), ("coarser", "x", True)):
            ax.plot(*hertz(method, swapped), marker, ms=5, label=f"{label} side has the nodes")
        ax.plot(line, np.sqrt(1 - line**2), "k", lw=1, label="Hertz")
        ax.set(title=f'method="{method}"', xlabel="$r / a$", xlim=(0, 1.3))
    axes[0].set_ylabel("$p / p_0$")
    axes[1].legend()
    figure.savefig(FIGURES / "methods_pressure.png")


def hertz(method: Any, swapped: bool) -> tuple[Any, Any]:
    """Press a paraboloid of radius 40 m on a block, a quarter of both; radii and pressures."""
    E, nu, radius, depth = 1.0, 0.3, 40.0, 0.002

    def build(model: Any) -> None:
        for name, z, n in (("lower", -1.0, 12), ("upper", 1.0, 16)):
            box = {"corner": (0, 0, z), "size": (1, 1, 1), "cells": (n, n, n // 2)}
            parts.add_box(model, name, **box)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    # Cells grow from the origin; the bottom of the upper block is curved.
    x = mesh.geometry.x
    upper = x[:, 2] > 0.5
    x[upper, 2] -= 1
    x[:] = np.sign(x) * (0.8 * np.abs(x) ** 2.2 + 0.2 * np.abs(x))
    x[upper, 2] += (1 - x[upper, 2]) * (x[upper, :2] ** 2).sum(axis=1) / 2 / radius
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(E, nu, 1.0)
    bodies = [nts.Body(V, cells, tag[name], material) for name in ("lower", "upper")]
    sides = [nts.Surface(V, facets, tag[name]) for name in ("upper_bottom", "lower_top")]
    pair = nts.ContactPair(*(sides[::-1] if swapped else sides), method=method)
    way = fem.Constant(mesh, 0.0)

    def hold(axis: int, value: Any, *names: str) -> fem.DirichletBC:
        held = np.sort(np.concatenate([facets.find(tag[name]) for name in names]))
        dofs = fem.locate_dofs_topological(V.sub(axis), 2, held)
        return fem.dirichletbc(value, dofs, V.sub(axis))

    def update(t: float) -> None:
        way.value = -depth * t

    zero, ends = np.float64(0.0), ("lower_bottom", "upper_top")
    bcs = [
        hold(0, zero, "lower_left", "upper_left", *ends),
        hold(1, zero, "lower_front", "upper_front", *ends),
        hold(2, zero, "lower_bottom"),
        hold(2, way, "upper_top"),
    ]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1 / 3, bcs=bcs, update=update)
    for _ in stepper.run(1.0):
        pass
    (contact,) = stepper.contacts
    force = -4 * contact.history.lambda_N.sum()
    a = (1.5 * force * radius * (1 - nu**2) / E) ** (1 / 3)
    r = np.hypot(*stepper.x[contact.nodes.nodes, :2].T)
    return r / a, contact.pressure / (1.5 * force / np.pi / a**2)


def scene(scheme: Any, law: str) -> nts.EnergyMomentum:
    """Stepper of the first impact."""
    mesh, cells, facets, tag = nts.read_mesh(nts.examples.ball_plate(), MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3, one_point=())
    ball, plate = (nts.Body(V, cells, tag[name], rubber) for name in ("ball", "plate"))
    surfaces = [nts.Surface(V, facets, tag[name]) for name in ("ball_outer", "plate_top")]
    pair = nts.ContactPair(*surfaces, nts.LagrangeMultiplier(law), method="node-to-segment")
    stepper = scheme([ball, plate], [pair], dt=0.01)
    stepper.set_velocity(ball, (0.0, 1.0, -1.0))
    return stepper


if __name__ == "__main__":
    others = {f.__name__: f for f in (peers, first_impact, schemes, laws, methods)}
    for wanted in sys.argv[1:] or [*DEMOS, *others]:
        others.get(wanted, lambda name=wanted: demo(name))()
