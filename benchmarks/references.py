"""Rows of ``errors.csv``: results compared with reference values."""

from typing import Any

__all__ = ["FINE_MESH", "rows"]

Run = dict[str, Any]

FINE_MESH = "v_z, fine mesh"
_EXPLICIT = "central differences"


def rows(runs: list[Run]) -> list[dict[str, Any]]:
    """One row for each run and quantity.

    Values without a closed form are compared with the smallest step on the same mesh (and mass).
    The velocity of the ball on the plate has a second reference, the limit of the meshes. A
    reference is no row of its own.

    Args:
        runs: Results of `errors.run`.
    """
    fine = _fine_mesh(runs)
    table = []
    for run in runs:
        if run["is_reference"]:
            continue
        for quantity, value in run["values"].items():
            table.append(_row(run, quantity, value, _reference(run, quantity, runs)))
        if fine is not None and run["problem"] == "ball":
            table.append(_row(run, FINE_MESH, run["values"]["v_z"], fine))
    return [row for row in table if row["error"] is not None]


def _row(run: Run, quantity: str, value: float, reference: float | None) -> dict[str, Any]:
    names = ("problem", "scheme", "element", "n", "h", "dofs", "cpu_seconds")
    error = None if reference is None else abs(value - reference)
    row = {name: run[name] for name in names}
    return row | {"quantity": quantity, "value": value, "reference": reference, "error": error}


def _reference(run: Run, quantity: str, runs: list[Run]) -> float | None:
    if quantity in run["exact"]:
        return float(run["exact"][quantity])
    # With lumped mass the limit of a mesh differs from that with consistent mass.
    scheme = _EXPLICIT if run["scheme"] == _EXPLICIT else "EM elastic"
    same = ("problem", "n", "element")
    for other in runs:
        if (
            other["is_reference"]
            and other["scheme"] == scheme
            and all(other[name] == run[name] for name in same)
        ):
            return float(other["values"][quantity])
    return None


def _fine_mesh(runs: list[Run]) -> float | None:
    """Limit of v_z of the ball, extrapolated from three meshes (Aitken)."""
    values = {
        run["n"]: run["values"]["v_z"]
        for run in reversed(runs)  # the longest step counts: the same for all meshes
        if (run["problem"], run["scheme"], run["element"]) == ("ball", _EXPLICIT, "default")
        and not run["is_reference"]
    }
    if not all(n in values for n in (6, 12, 24)):
        return None
    a, b, c = (values[n] for n in (6, 12, 24))
    return float(c - (c - b) ** 2 / ((c - b) - (b - a)))
