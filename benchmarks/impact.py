"""Energy balance of the impact of the README by scheme and contact law, as a table of the site.

    python3 -m benchmarks.impact

Writes ``docs/tables/impact.md``; takes half a minute.
"""

import csv
import tempfile
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx import fem

import dolfinx_nts as nts

__all__ = ["main", "run", "table"]

ROOT = Path(__file__).parents[1]
ROUND_OFF = 1e-9  # J
CAUSES = ("bulk", "persistent_contact", "activation", "facet_change", "friction")
VARIANTS: dict[str, tuple[type[nts.EnergyMomentum], Any, Any]] = {
    "`EnergyMomentum`, elastic": (nts.EnergyMomentum, nts.LagrangeMultiplier(), None),
    "`EnergyMomentum`, plastic": (nts.EnergyMomentum, nts.LagrangeMultiplier("plastic"), None),
    "`Midpoint`, elastic": (nts.Midpoint, nts.LagrangeMultiplier(), None),
    "`Midpoint`, plastic": (nts.Midpoint, nts.LagrangeMultiplier("plastic"), None),
    "`EnergyMomentum`, elastic, exact friction": (
        *(nts.EnergyMomentum, nts.LagrangeMultiplier()),
        nts.Coulomb(0.3),
    ),
    "`EnergyMomentum`, springs, friction": (
        *(nts.EnergyMomentum, nts.Penalty(1e5)),
        nts.Coulomb(0.3, eps_T=1e5),
    ),
    "`Midpoint`, springs, friction of the paper": (
        *(nts.Midpoint, nts.Penalty(1e5)),
        nts.Coulomb(0.3, eps_T=1e5, law="convective"),
    ),
}


def run(name: str, until: float, folder: Path) -> list[dict[str, float]]:
    """Compute the impact.

    Args:
        name: Variant.
        until: Time at the end [s].
        folder: For the files of the run.

    Returns:
        Rows of the table of its `Recorder`.
    """
    scheme, enforcement, friction = VARIANTS[name]
    mesh, cells, facets, tag = nts.read_mesh(nts.examples.ball_plate(), MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3, one_point=())
    ball, plate = (nts.Body(V, cells, tag[body], rubber) for body in ("ball", "plate"))
    surfaces = [nts.Surface(V, facets, tag[side]) for side in ("ball_outer", "plate_top")]
    pair = nts.ContactPair(*surfaces, enforcement, friction, method="node-to-segment")
    stepper = scheme([ball, plate], [pair], dt=0.01)
    stepper.set_velocity(ball, (0.0, 1.0, -1.0))
    with nts.Recorder(folder / "run", stepper, every=10**6) as record:
        for step in stepper.run(until=until):
            record.write(step)
    with (folder / "run.csv").open(newline="") as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    return rows


def table(runs: dict[str, list[dict[str, float]]]) -> str:
    """Markdown table: one row a variant.

    Args:
        runs: Rows of the tables of the runs, by variant.

    Returns:
        The table.
    """
    heads = ["variant", "energy at the end", "change [%]"]
    heads += [cause.replace("_", " ") for cause in CAUSES]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, rows in runs.items():
        start, end = rows[0], rows[-1]
        change = 100 * (end["total_energy"] / start["total_energy"] - 1)
        cells = [name, f"{end['total_energy']:.2f}", _number(change, ".2g")]
        cells += [_number(end[f"energy_{cause}"], "+.3g") for cause in CAUSES]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + f"\n\nEnergies in joules; 0 is less than {ROUND_OFF:g}.\n"


def _number(value: float, form: str) -> str:
    """Text of a number, 0 if it is round-off."""
    return "0" if abs(value) < ROUND_OFF else f"{value:{form}}"


def main() -> None:
    """Run all variants and write the table."""
    with tempfile.TemporaryDirectory() as folder:
        runs = {name: run(name, 1.0, Path(folder)) for name in VARIANTS}
    (ROOT / "docs" / "tables" / "impact.md").write_text(table(runs), encoding="utf-8")


if __name__ == "__main__":
    main()
