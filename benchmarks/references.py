"""Rows of ``errors.csv``: values against what they should be."""

from typing import Any

__all__ = ["rows"]

Run = dict[str, Any]

_EXPLICIT = "central differences"


def rows(runs: list[Run]) -> list[dict[str, Any]]:
    """One row for each run and quantity.

    The velocity of the ball has two references: that of the same mesh (and
    mass) at the smallest step, and, for ``v_z, fine mesh``, the limit of the
    meshes. A reference is no row of its own.

    Args:
        runs: Results of `errors.run`.
    """
    fine = _fine_mesh(runs)
    table = []
    for run in runs:
        if run["is_reference"]:
            continue
        for quantity, value in run["values"].items():
            reference = _reference(run, quantity, runs)
            table.append(_row(run, quantity, value, reference))
        if fine is not None and run["scene"] == "ball":
            table.append(_row(run, "v_z, fine mesh", run["values"]["v_z"], fine))
    return [row for row in table if row["error"] is not None]


def _row(run: Run, quantity: str, value: float, reference: float | None) -> dict[str, Any]:
    names = ("scene", "scheme", "element", "n", "h", "dofs", "cpu_seconds")
    error = None if reference is None else abs(value - reference)
    row = {name: run[name] for name in names}
    return row | {"quantity": quantity, "value": value, "reference": reference, "error": error}


def _reference(run: Run, quantity: str, runs: list[Run]) -> float | None:
    if quantity == "rebound":
        return 1.0
    if quantity in ("energy drift", "displacement"):
        return 0.0
    # With lumped mass a mesh has another limit than with the consistent one.
    scheme = _EXPLICIT if run["scheme"] == _EXPLICIT else "EM elastic"
    same = ("scene", "n", "element")
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
        if (run["scene"], run["scheme"], run["element"]) == ("ball", _EXPLICIT, "full")
        and not run["is_reference"]
    }
    if not all(n in values for n in (6, 12, 24)):
        return None
    a, b, c = (values[n] for n in (6, 12, 24))
    return float(c - (c - b) ** 2 / ((c - b) - (b - a)))
