"""The package is layered, and each external library has its place.

A test checks the whole package and reports all offenders in one message.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial

TESTS = Path(__file__).parent
PACKAGE = TESTS.parent / "dolfinx_nts"

# A package imports from the rows above its own, and from itself.
LAYERS = [
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
    {"diagnostics", "gradients", "plotting"},
    {"io"},
    {""},
]
LEVEL = {package: level for level, row in enumerate(LAYERS) for package in row}

# Packages that may import a library.
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
    "ufl": {
        *("fem", "materials", "model", "solvers", "integrators", "diagnostics", "gradients"),
        *("plotting", "io"),
    },
    "dolfinx_nts._kernels": {
        *("parallel", "fem", "model", "search", "contact", "contact.implicit"),
        *("contact.explicit", "solvers", "integrators"),
    },
}

# Largest number of public members of a class, and of attributes that its methods set, both
# with inherited ones: as in `CentralDifference`. Lower them whenever classes get smaller.
MAX_MEMBERS, MAX_ATTRIBUTES = 33, 44

# Largest number of modules in a folder.
MAX_MODULES = 20


def name_of(path: Path) -> str:
    """Name of a module in the package: ``contact.pair``, ``contact`` for its ``__init__``."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix("__init__")


PATHS = {name_of(path).rstrip("."): path for path in sorted(PACKAGE.rglob("*.py"))}


@cache
def package_of(module: str) -> str:
    """Innermost package of `LAYERS` that contains a module."""
    return max((w for w in LEVEL if f"{module}.".startswith(f"{w}." if w else "")), key=len)


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(PATHS[module].read_text())


@cache
def nodes_of(module: str) -> list[ast.AST]:
    return list(ast.walk(tree(module)))


def imported_by(nodes: list[ast.AST] | list[ast.stmt]) -> set[str]:
    """Dotted names that import statements name."""
    names = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            # Imports are absolute: a leading dot marks a relative one.
            source = "." * node.level + (node.module or "")
            names |= {f"{source}.{alias.name}" for alias in node.names}
    return names


@cache
def imports(module: str) -> set[str]:
    """Dotted names that a module imports, also inside functions."""
    return imported_by(nodes_of(module))


def own_imports(module: str) -> set[str]:
    """Modules of this package that a module imports."""
    names = {n.removeprefix("dolfinx_nts.") for n in imports(module) if n.startswith("dolfinx_nts")}
    known = {*PATHS, "_kernels"} - {""}
    return {n if n in known else n.rpartition(".")[0] for n in names} - {module}


def uses(names: set[str], library: str) -> bool:
    """Whether dotted names include a library or a part of it."""
    return any(f"{name}.".startswith(f"{library}.") for name in names)


def expect_none(offenders: list[str] | Iterator[str]) -> None:
    """Fail with one line for each offender."""
    lines = list(offenders)
    assert not lines, f"{len(lines)} offenders:\n" + "\n".join(lines)


def test_modules_import_from_layers_above_their_own():
    offenders = [f"{path.name} belongs to no package" for path in PACKAGE.glob("*.py*")]
    offenders = [line for line in offenders if not re.match(r"(__init__|compat)\.py |_kern", line)]
    for module in PATHS:
        own = package_of(module)
        if not own and module:
            offenders.append(f"{module} has no layer")
        offenders += [f"{module}: relative import" for n in imports(module) if n.startswith(".")]
        for other in own_imports(module):
            package = package_of(other)
            if package != own and LEVEL[package] >= LEVEL[own]:
                offenders.append(f"{module} imports {other}")
    expect_none(offenders)


def test_folders_are_small():
    paths = [*PATHS.values(), *TESTS.rglob("*.py")]
    sizes = Counter(path.parent.relative_to(PACKAGE.parent).as_posix() for path in paths)
    expect_none(
        f"{folder}: {size} modules" for folder, size in sorted(sizes.items()) if size > MAX_MODULES
    )


def test_no_modules_import_each_other_in_a_circle():
    graph = {module: own_imports(module) - {""} for module in PATHS if module}
    assert len(list(TopologicalSorter(graph).static_order())) >= len(graph)


def test_packages_import_only_their_libraries():
    expect_none(
        f"{module} imports {library}"
        for module in PATHS
        for library, packages in LIBRARIES.items()
        if package_of(module) not in packages and uses(imports(module), library)
    )


def test_optional_libraries_are_imported_inside_functions():
    expect_none(
        f"{module} imports {library}"
        for module in PATHS
        for library in ("gmsh", "pyvista", "matplotlib")
        if uses(imported_by(tree(module).body), library)
    )


def version_checks(module: str) -> Iterator[str]:
    """Checks for releases of DOLFINx, and what differs between releases."""
    text = PATHS[module].read_text()
    for pattern in (
        r"hasattr\((dolfinx|fem|io|mesh|la|common)\b",
        r"dolfinx\.__version__|version\([\"'](fenics-)?dolfinx",
    ):
        yield from (match[0] for match in re.finditer(pattern, text))
    for node in nodes_of(module):
        if isinstance(node, ast.Attribute):
            name = ast.unparse(node)
            if name.endswith(("geometry.dofmap", ".cmap")):
                yield name
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name.endswith("IndexMap"):
                yield name
        elif isinstance(node, ast.Try):
            caught = [ast.unparse(h.type) for h in node.handlers if h.type]
            tried = ast.unparse(ast.Module(node.body, []))
            if "dolfinx" in tried and re.search("ImportError|ModuleNotFound", " ".join(caught)):
                yield f"try: {tried}"


def test_only_compat_knows_releases_of_dolfinx():
    modules = PATHS.keys() - {"compat"}
    expect_none(f"{module}: {found}" for module in modules for found in version_checks(module))


def defined_in(module: str) -> set[str]:
    """Attributes, functions and classes that a module sets or defines."""
    names = set()
    for node in nodes_of(module):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.attr)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


def test_private_names_are_used_in_their_own_module_only():
    private = re.compile(r"_(?!kernels\b|_)\w+")
    offenders = []
    for module in PATHS:
        for name in imports(module):
            if name.startswith("dolfinx_nts.") and private.fullmatch(name.rpartition(".")[2]):
                offenders.append(f"{module} imports {name}")
        allowed = defined_in(module) | {"_cpp_object", "_replace"}
        for node in nodes_of(module):
            if isinstance(node, ast.Attribute) and private.fullmatch(node.attr):
                on_self = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
                if not on_self and node.attr not in allowed:
                    offenders.append(f"{module}:{node.lineno} {node.attr}")
    expect_none(offenders)


def test_package_does_not_print():
    expect_none(
        f"{module}:{node.lineno}"
        for module in PATHS
        for node in nodes_of(module)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "print"
    )


def test_headers_include_only_the_standard_library_and_each_other():
    root = PACKAGE / "cpp"
    headers = sorted((root / "nts").rglob("*.h"))
    assert headers
    own = {f'"{header.relative_to(root).as_posix()}"' for header in headers}
    expect_none(
        f"{header.relative_to(root)}: {name}"
        for header in headers
        for name in re.findall(r"^\s*#\s*include\s+(\S+)", header.read_text(), re.MULTILINE)
        if name not in own and not re.fullmatch(r"<[a-z_0-9]+>", name)
    )


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
    classes = {
        f"{module}.{node.name}": node
        for module in PATHS
        for node in nodes_of(module)
        if isinstance(node, ast.ClassDef)
    }

    def all_members(name: str) -> tuple[set[str], set[str]]:
        module = name.rpartition(".")[0]
        public, attributes = members(classes[name])
        for base in map(ast.unparse, classes[name].bases):
            known = {n.removeprefix("dolfinx_nts.") for n in imports(module)} | {f"{module}.{base}"}
            for other in known & classes.keys():
                if other.endswith(f".{base}"):
                    inherited = all_members(other)
                    public, attributes = public | inherited[0], attributes | inherited[1]
        return public, attributes

    sizes = {name: tuple(map(len, all_members(name))) for name in classes}
    expect_none(
        f"{name}: {public} members, {attributes} attributes"
        for name, (public, attributes) in sizes.items()
        if public > MAX_MEMBERS or attributes > MAX_ATTRIBUTES
    )
