"""Imports point one way, and each outside library has its place."""

import ast
import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial

PACKAGE = Path(__file__).parents[1] / "dolfinx_nts"

# A module may import from the rows above its own.
LAYERS = [
    {"_kernels", "arguments", "gmsh_options", "reductions"},
    {
        "archive",
        "blocks",
        "compat",
        "contact_history",
        "elements",
        "energy_curve",
        "failures",
        "forms",
        "hexahedra",
        "interrupts",
        "journal",
        "pivoting",
        "progress",
        "slip",
        "timing",
    },
    {"neighbourhood", "packed_form"},
    {"cell_form", "materials", "parts", "ranks", "spaces", "step_control", "supports", "table"},
    {"energies", "meshing"},
    {"numbering"},
    {"surfaces"},
    {"bodies"},
    {"loads", "lumping"},
    {"form_load", "stable_step", "step_forms"},
    {"search", "enforcement", "friction", "obstacles"},
    {"obstacle_neighbourhood", "own_surface", "rigid_surface"},
    {"contact", "contact_rows", "excerpt", "spring_state"},
    {"active_set", "independent", "pairing", "tangential"},
    {"lookout", "normal_springs"},
    {"contact_step", "report", "scene", "springs"},
    {"elimination", "block_rows", "stability"},
    {"assembly", "kept_factors", "kept_rows", "patch_domain"},
    {"patch"},
    {"preconditioner", "saddle", "rest", "explicit_bulk", "lost"},
    {"linear"},
    {"newton"},
    {"runs"},
    {"stepper"},
    {"implicit", "explicit"},
    {"integrators", "generalized_alpha"},
    {"diagnostics", "diagrams", "drawing", "fields", "fingerprint", "movie", "sunk"},
    {"checkpoint", "ledger", "plotting", "vtx", "xdmf"},
    {"output"},
    {"__init__"},
]
LEVEL = {name: level for level, row in enumerate(LAYERS) for name in row}
MODULES = sorted(path.stem for path in PACKAGE.glob("*.py"))

# First layer that may know a library; below it, nothing of it.
FIRST = {"petsc4py": "block_rows", "dolfinx.fem.petsc": "assembly"}
ONLY = {
    "gmsh": {"hexahedra", "meshing"},
    "pyvista": {"drawing", "plotting"},
    "matplotlib": {"diagrams"},
    "PIL": {"movie"},
    "imageio_ffmpeg": {"movie"},
    "dolfinx.io": {"compat"},
    "h5py": {"checkpoint", "xdmf"},
}

modules = pytest.mark.parametrize("module", MODULES)


def tree(module: str) -> ast.Module:
    return ast.parse((PACKAGE / f"{module}.py").read_text())


def imports(module: str) -> set[str]:
    """Dotted names of what a module imports, anywhere in it."""
    names = set()
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "expected absolute imports"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def own_imports(module: str) -> set[str]:
    """Modules of this package that a module imports."""
    own = {name.split(".")[1] for name in imports(module) if name.startswith("dolfinx_nts.")}
    return own & (set(MODULES) | {"_kernels"})


def test_every_module_has_a_layer():
    assert set(MODULES) <= set(LEVEL)


@modules
def test_module_imports_only_from_layers_above_its_own(module):
    assert module in LEVEL, f"give {module} a place in LAYERS"
    wrong = {other for other in own_imports(module) if LEVEL[other] >= LEVEL[module]}
    assert not wrong


@modules
def test_module_knows_only_the_libraries_of_its_layer(module):
    names = imports(module)
    for library, first in FIRST.items():
        if LEVEL[module] < LEVEL[first]:
            assert not {n for n in names if f"{n}.".startswith(f"{library}.")}, library
    for library, allowed in ONLY.items():
        if module not in allowed:
            assert not {n for n in names if f"{n}.".startswith(f"{library}.")}, library


@modules
def test_what_differs_between_releases_is_used_through_compat(module):
    if module == "compat":
        return
    nodes = list(ast.walk(tree(module)))
    used = {ast.unparse(node) for node in nodes if isinstance(node, ast.Attribute)}
    called = {ast.unparse(node.func) for node in nodes if isinstance(node, ast.Call)}
    assert not {name for name in used if name.endswith(("geometry.dofmap", ".cmap"))}
    assert not {name for name in called if name.endswith("IndexMap")}


def test_arrays_of_contact_know_no_forms():
    for module in (
        "search",
        "enforcement",
        "friction",
        "obstacles",
        "obstacle_neighbourhood",
        "contact",
        "contact_history",
        "contact_rows",
        "contact_step",
        "rigid_surface",
        "slip",
        "spring_state",
        "springs",
        "elimination",
    ):
        names = imports(module)
        assert not {n for n in names if n.startswith(("ufl", "dolfinx.fem"))}, module


@modules
def test_optional_libraries_are_imported_where_they_are_used(module):
    names = {
        name
        for node in tree(module).body
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in [getattr(node, "module", None) or node.names[0].name]
    }
    assert not {n for n in names if n.split(".")[0] in ("gmsh", "pyvista", "matplotlib")}


@modules
def test_versions_of_dolfinx_are_told_apart_only_in_compat(module):
    if module == "compat":
        pytest.skip("this is the place")
    text = (PACKAGE / f"{module}.py").read_text()
    assert not re.search(r"hasattr\((dolfinx|fem|io|mesh|la|common)\b", text)
    assert not re.search(r"dolfinx\.__version__|version\([\"'](fenics-)?dolfinx", text)
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Try) and any(
            "ImportError" in ast.unparse(h.type) or "ModuleNotFound" in ast.unparse(h.type)
            for h in node.handlers
            if h.type
        ):
            tried = ast.unparse(ast.Module(node.body, []))
            assert "dolfinx" not in tried


def test_headers_include_only_the_standard_library_and_each_other():
    headers = sorted((PACKAGE / "cpp" / "nts").glob("*.h"))
    assert headers
    own = {header.name for header in headers}
    for header in headers:
        lines = re.findall(r"^\s*#\s*include\s+(\S+)", header.read_text(), re.MULTILINE)
        quoted = {line.strip('"') for line in lines if line.startswith('"')}
        assert quoted <= own, header.name
        angled = {line for line in lines if line.startswith("<")}
        wrong = {line for line in angled if not re.fullmatch(r"<[a-z_0-9]+>", line)}
        assert not wrong, header.name


@modules
def test_package_does_not_print(module):
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id != "print", f"{module}.py:{node.lineno}"
