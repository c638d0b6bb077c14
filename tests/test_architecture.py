"""Imports point one way, and each outside library has its place."""

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial

PACKAGE = Path(__file__).parents[1] / "dolfinx_nts"

# A wing imports from the rows above its own, and from itself.
WINGS = [
    {"common", "_kernels"},
    {"compat"},
    {"parallel"},
    {"fem", "materials", "meshing"},
    {"model"},
    {"search"},
    {"contact"},
    {"contact.implicit", "contact.explicit"},
    {"solvers"},
    {"integrators"},
    {"diagnostics", "plotting"},
    {"io"},
    {""},
]
LEVEL = {wing: level for level, row in enumerate(WINGS) for wing in row}

# Wings, and where it is one place only the module, that may know a library.
LIBRARIES = {
    "petsc4py": {"solvers", "integrators"},
    "dolfinx.fem.petsc": {"solvers"},
    "dolfinx.io": {"compat"},
    "gmsh": {"meshing"},
    "h5py": {"io"},
    "pyvista": {"plotting"},
    "matplotlib": {"plotting"},
    "PIL": {"plotting"},
    "imageio_ffmpeg": {"plotting"},
    "ufl": {"fem", "materials", "model", "solvers", "integrators", "diagnostics", "plotting", "io"},
    "dolfinx_nts._kernels": {
        *("parallel", "fem", "model", "search", "contact", "contact.implicit"),
        *("contact.explicit", "solvers", "integrators"),
    },
}


def name_of(path: Path) -> str:
    """Name of a module in the package: ``contact.pair``, ``contact`` for its ``__init__``."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix("__init__")


PATHS = {name_of(path).rstrip("."): path for path in sorted(PACKAGE.rglob("*.py"))}
modules = pytest.mark.parametrize("module", PATHS)


def wing_of(module: str) -> str:
    """The wing with the longest name in which a module lies."""
    return max((w for w in LEVEL if f"{module}.".startswith(f"{w}." if w else "")), key=len)


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(PATHS[module].read_text())


def imports(module: str, nodes: list[ast.stmt] | None = None) -> set[str]:
    """Dotted names of what a module imports, anywhere in it or in some nodes."""
    names = set()
    for node in ast.walk(tree(module)) if nodes is None else nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "expected absolute imports"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def own_imports(module: str) -> set[str]:
    """Modules of this package that a module imports."""
    names = {n.removeprefix("dolfinx_nts.") for n in imports(module) if n.startswith("dolfinx_nts")}
    known = {*PATHS, "_kernels"} - {""}
    return {n if n in known else n.rpartition(".")[0] for n in names} - {module}


@modules
def test_module_imports_only_from_wings_above_its_own(module):
    own = wing_of(module)
    assert own or module in ("", "compat"), f"give {module} a wing"
    others = {other: wing_of(other) for other in own_imports(module)}
    wrong = {other for other, w in others.items() if w != own and LEVEL[w] >= LEVEL[own]}
    assert not wrong


def test_no_modules_import_each_other_in_a_circle():
    graph = {module: own_imports(module) - {""} for module in PATHS if module}
    assert len(list(TopologicalSorter(graph).static_order())) >= len(graph)


@modules
def test_wing_knows_only_its_libraries(module):
    names = imports(module)
    for library, wings in LIBRARIES.items():
        if wing_of(module) not in wings:
            assert not {n for n in names if f"{n}.".startswith(f"{library}.")}, library


def test_few_modules_lie_outside_the_wings():
    assert {path.name for path in PACKAGE.glob("*.py*")} <= {
        *("__init__.py", "compat.py", "_kernels.pyi")
    }


@modules
def test_what_differs_between_releases_is_used_through_compat(module):
    if module == "compat":
        return
    nodes = list(ast.walk(tree(module)))
    used = {ast.unparse(node) for node in nodes if isinstance(node, ast.Attribute)}
    called = {ast.unparse(node.func) for node in nodes if isinstance(node, ast.Call)}
    assert not {name for name in used if name.endswith(("geometry.dofmap", ".cmap"))}
    assert not {name for name in called if name.endswith("IndexMap")}


@modules
def test_optional_libraries_are_imported_where_they_are_used(module):
    names = imports(module, tree(module).body)
    assert not {n for n in names if n.split(".")[0] in ("gmsh", "pyvista", "matplotlib")}


@modules
def test_versions_of_dolfinx_are_told_apart_only_in_compat(module):
    if module == "compat":
        return
    text = PATHS[module].read_text()
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


@modules
def test_nobody_uses_what_is_private_to_another_module(module):
    nodes = list(ast.walk(tree(module)))
    private = re.compile(r"_(?!kernels\b|_)\w+")
    for name in imports(module):
        if name.startswith("dolfinx_nts."):
            assert not private.fullmatch(name.rpartition(".")[2]), name
    # An attribute with an underscore is set, or defined, in the module that uses it.
    mine = {node.attr for node in nodes if isinstance(node, ast.Attribute)} & {
        name
        for node in nodes
        for name in (
            [node.attr]
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
            else [node.name]
            if isinstance(node, ast.FunctionDef | ast.ClassDef)
            else [node.target.id]
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
            else [target.id for target in node.targets if isinstance(target, ast.Name)]
            if isinstance(node, ast.Assign)
            else []
        )
    }
    for node in nodes:
        if isinstance(node, ast.Attribute) and private.fullmatch(node.attr):
            on_self = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
            allowed = on_self or node.attr in mine or node.attr == "_cpp_object"
            assert allowed or node.attr == "_replace", f"{module}:{node.lineno} {node.attr}"


def test_headers_include_only_the_standard_library_and_each_other():
    root = PACKAGE / "cpp"
    headers = sorted((root / "nts").rglob("*.h"))
    assert headers
    own = {header.relative_to(root).as_posix() for header in headers}
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


# Most public members of a class, and most attributes that it sets on its objects.
MEMBERS, ATTRIBUTES = 15, 12


def members(node: ast.ClassDef) -> tuple[set[str], set[str]]:
    """Public members that a class defines, and attributes that its methods set."""
    functions = {n.name for n in node.body if isinstance(n, ast.FunctionDef)}
    declared = {
        n.target.id
        for n in node.body
        if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)
    }
    stored = {
        n.attr
        for n in ast.walk(node)
        if isinstance(n, ast.Attribute)
        and isinstance(n.ctx, ast.Store)
        and ast.unparse(n.value) == "self"
    }
    attributes = stored - functions
    return {n for n in functions | declared | attributes if not n.startswith("_")}, attributes


def test_classes_are_small():
    nodes = {
        node.name: node
        for module in PATHS
        for node in ast.walk(tree(module))
        if isinstance(node, ast.ClassDef)
    }

    def inherited(node: ast.ClassDef) -> set[str]:
        bases = [nodes[ast.unparse(b)] for b in node.bases if ast.unparse(b) in nodes]
        return set().union(*(members(b)[0] | members(b)[1] | inherited(b) for b in bases))

    for name, node in nodes.items():
        public, attributes = (found - inherited(node) for found in members(node))
        assert len(public) <= MEMBERS, f"{name}: {sorted(public)}"
        assert len(attributes) <= ATTRIBUTES, f"{name}: {sorted(attributes)}"
