"""Pages of the API reference, one for each name in ``__all__``, before Sphinx reads them."""

import inspect
import re
from pathlib import Path
from types import ModuleType

from sphinx.application import Sphinx

import dolfinx_nts

__all__ = ["setup", "write"]

# Heading of a part of the index, and its names in the order in which users meet them.
PARTS = {
    "Meshes": ["read_mesh", "MeshData", "parts", "examples", "axisymmetric"],
    "Bodies and materials": [
        *("Body", "SaintVenantKirchhoff", "NeoHookean", "MooneyRivlin", "Yeoh", "Ogden"),
        *("Hyperelastic", "HolzapfelGasserOgden", "J2Plasticity"),
        *("PlaneStress", "RigidBody", "Guide"),
    ],
    "Surfaces and obstacles": [
        *("Surface", "boundary_of", "Obstacle", "RigidPlane", "RigidSphere", "RigidCylinder"),
        *("RigidCone", "RigidSurface", "ExactObstacle", "Motion"),
    ],
    "Contact": [
        *("ContactPair", "all_pairs", "two_half_passes", "LagrangeMultiplier", "Penalty"),
        *("Tied", "Coulomb", "Stribeck", "SlipWeakening", "Tresca", "FrictionLaw", "FrictionNodes"),
        "close_gaps",
    ],
    "Loads": [
        *("Load", "BodyForce", "Gravity", "Force", "Moment", "Traction", "Pressure", "FormLoad"),
    ],
    "Steps in time": [
        *("EnergyMomentum", "Midpoint", "GeneralizedAlpha", "CentralDifference", "QuasiStatic"),
        *(
            "ContactForce",
            "StepControl",
            "StepReport",
            "Reaction",
            "StepperStatistics",
            "ConvergenceError",
        ),
        *("load_state", "Gradient", "Scheme", "ImplicitStepper", "Newmark", "NewmarkRates"),
    ],
    "Results": [
        *("Recorder", "Diagnostics", "Balance", "BodyBalance", "PairBalance", "Overlap"),
        *("Fields", "plotting"),
    ],
}


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages when the build begins."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("builder-inited", lambda app: write(Path(app.srcdir) / "api"), priority=400)
    app.connect("autodoc-skip-member", _skip_fields)
    # After napoleon, which makes fields of the sections of a docstring.
    app.connect("autodoc-process-docstring", _part_attributes, priority=900)
    return {"parallel_read_safe": True}


def write(folder: Path) -> None:
    """Write the index and a page for each public name.

    Args:
        folder: Where the pages go.

    Raises:
        ValueError: A public name is in no part, or in two.
    """
    listed = sorted(name for names in PARTS.values() for name in names)
    if listed != sorted(dolfinx_nts.__all__):
        wrong = set(listed) ^ set(dolfinx_nts.__all__)
        raise ValueError(f"expected each name of __all__ once in api_pages.PARTS, but {wrong}")
    folder.mkdir(exist_ok=True)
    lines = ["# API reference", ""]
    for heading, names in PARTS.items():
        lines += [f"## {heading}", "", "```{eval-rst}"]
        lines += [".. currentmodule:: dolfinx_nts", "", ".. autosummary::", "   :nosignatures:", ""]
        lines += [*(f"   {name}" for name in names), "```", ""]
    lines += ["```{toctree}", ":hidden:", "", *map(_title, listed), "```", ""]
    _replace(folder / "index.md", "\n".join(lines))
    for name in listed:
        _replace(folder / f"{_title(name)}.rst", _page(name))


def _skip_fields(app: Sphinx, kind: str, name: str, item: object, skip: bool, options: object):
    """Leave out fields of a named tuple, which the docstring of the tuple has."""
    return True if type(item).__name__ == "_tuplegetter" else None


def _part_attributes(
    app: Sphinx, kind: str, name: str, item: object, options: object, lines: list[str]
) -> None:
    """Make a field of each attribute where a docstring has several before one text."""
    for number, line in reversed(list(enumerate(lines))):
        if found := re.match(r":ivar ([^:]+, [^:]+): (.*)", line):
            names = found[1].split(", ")
            lines[number : number + 1] = [f":ivar {part}: {found[2]}" for part in names]


def _page(name: str) -> str:
    """Page of a class, a function, or a module with its functions."""
    item = getattr(dolfinx_nts, name)
    title = f"{name}\n{'=' * len(name)}\n\n"
    if isinstance(item, ModuleType):
        functions = "".join(f"\n.. autofunction:: {entry}\n" for entry in item.__all__)
        return (
            f"{title}.. automodule:: dolfinx_nts.{name}\n\n"
            f".. currentmodule:: dolfinx_nts.{name}\n{functions}"
        )
    kind = "class" if inspect.isclass(item) else "function"
    options = (
        "   :members:\n   :inherited-members: RuntimeError, tuple\n" if kind == "class" else ""
    )
    return f"{title}.. currentmodule:: dolfinx_nts\n\n.. auto{kind}:: {name}\n{options}"


def _title(name: str) -> str:
    """Name of a page, which differs from the public name so that links to this find one target."""
    return f"dolfinx_nts.{name}"


def _replace(path: Path, text: str) -> None:
    """Write a file unless it has this text, so that Sphinx reads what has changed only."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
