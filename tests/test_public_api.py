"""Public names are listed, sorted, documented and annotated.

A test checks all names and reports all offenders in one message.
"""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from typing import Any

import pytest

import dolfinx_nts

pytestmark = pytest.mark.serial

# Modules that import an optional library do so inside functions.
MODULES = {
    name: importlib.import_module(name)
    for name in sorted(
        {"dolfinx_nts"}
        | {
            name
            for _, name, is_package in pkgutil.walk_packages(dolfinx_nts.__path__, "dolfinx_nts.")
            if not (is_package or name == "dolfinx_nts._kernels")
        }
    )
}

# Classes and functions in `__all__` of the package and of its modules.
OBJECTS = {
    f"{obj.__module__}.{obj.__qualname__}".removeprefix("dolfinx_nts."): obj
    for module in MODULES.values()
    for obj in (getattr(module, entry) for entry in module.__all__)
    if inspect.isclass(obj) or inspect.isfunction(obj)
}

# For users are the names of the package, and these modules.
MODULES_FOR_USERS = (
    *("meshing.gmsh", "meshing.boxes", "meshing.balls", "meshing.rings"),
    *("diagnostics.balance", "io.recorder"),
    *("plotting.pictures", "plotting.diagrams"),
)
FOR_USERS = {
    name: obj
    for name, obj in OBJECTS.items()
    if obj.__name__ in dolfinx_nts.__all__ or name.rpartition(".")[0] in MODULES_FOR_USERS
}


def methods(cls: type) -> dict[str, Any]:
    """Public functions and properties that a class defines itself."""
    return {
        name: function
        for name, value in vars(cls).items()
        for function in [value.fget if isinstance(value, property) else value]
        for function in [getattr(function, "__func__", function)]
        if not name.startswith("_") and inspect.isfunction(function)
    }


# A class may implement a protocol without being derived from it.
PROTOCOL_METHODS = {
    name
    for obj in OBJECTS.values()
    if getattr(obj, "_is_protocol", False)
    for name, function in methods(obj).items()
    if function.__doc__
}


def expect_none(offenders: list[str] | Iterator[str]) -> None:
    """Fail with one line for each offender."""
    lines = list(offenders)
    assert not lines, f"{len(lines)} offenders:\n" + "\n".join(lines)


def test_public_names_of_modules_are_listed_and_sorted():
    offenders = []
    for module, found in MODULES.items():
        names = list(found.__all__)
        # Order of ruff: constants, classes, functions.
        kinds = [0 if n.isupper() else 1 if n[0].isupper() else 2 for n in names]
        if names != [n for _, n in sorted(zip(kinds, names, strict=True))]:
            offenders.append(f"{module}: __all__ is not sorted")
        offenders += [f"{module} has no {name}" for name in names if not hasattr(found, name)]
        if not found.__doc__:
            offenders.append(f"{module} has no docstring")
    expect_none(offenders)


def test_package_lists_its_version_and_its_public_names_only():
    from dolfinx_nts import meshing, parts, plotting

    assert dolfinx_nts.__version__.count(".") == 2
    assert dir(dolfinx_nts) == sorted([*dolfinx_nts.__all__, "__version__"])
    assert parts is dolfinx_nts.parts and plotting is dolfinx_nts.plotting
    assert parts.add_box is meshing.add_box


def test_public_names_are_documented():
    """Also public methods, unless they override or implement a documented one."""
    offenders = [name for name, obj in OBJECTS.items() if not inspect.getdoc(obj)]
    offenders += [
        f"{name}.{method}"
        for name, obj in OBJECTS.items()
        if inspect.isclass(obj)
        for method in methods(obj)
        if not inspect.getdoc(vars(obj)[method]) and method not in PROTOCOL_METHODS
    ]
    expect_none(offenders)


def test_public_functions_and_methods_are_annotated():
    offenders = []
    for name, obj in OBJECTS.items():
        functions = methods(obj) if inspect.isclass(obj) else {"": obj}
        for method, function in functions.items():
            signature = inspect.signature(function)
            if signature.return_annotation is inspect.Signature.empty:
                offenders.append(f"{name}.{method}: return value".replace(".:", ":"))
            offenders += [
                f"{name}.{method}: {parameter.name}".replace(".:", ":")
                for parameter in signature.parameters.values()
                if parameter.name not in ("self", "cls")
                and parameter.annotation is inspect.Parameter.empty
            ]
    expect_none(offenders)


def undocumented_arguments(obj: Any) -> list[str]:
    """Arguments of a function or class, or fields of data, that its docstring does not name."""
    doc = inspect.getdoc(obj) or ""
    if fields := getattr(obj, "__dataclass_fields__", None) or getattr(obj, "_fields", None):
        section, names = "Attributes", [f for f in fields if not f.startswith("_")]
    elif inspect.isclass(obj) and (
        issubclass(obj, Exception) or obj.__init__ is object.__init__  # type: ignore[misc]
    ):
        return []
    else:
        names = [n for n in inspect.signature(obj).parameters if n not in ("self", "cls")]
        section = "Args"
        # Classes with the arguments of another one may refer to it.
        if same := re.search(r"Arguments,\sattributes\sand\serrors\sas\sfor\s`(\w+)`", doc):
            other = getattr(dolfinx_nts, same[1])
            if inspect.signature(other) != inspect.signature(obj):
                return [f"other arguments than {same[1]}"]
            doc = inspect.getdoc(other) or ""
    wanted = [f"{section}:"] * bool(names) + [f"{name}:" for name in names]
    return [text for text in wanted if text not in doc]


def test_docstrings_for_users_name_arguments_and_return_values():
    offenders = []
    for name, obj in FOR_USERS.items():
        offenders += [f"{name} lacks {text}" for text in undocumented_arguments(obj)]
        if not inspect.isclass(obj):
            returns = inspect.signature(obj).return_annotation not in (None, "None")
            if returns and "Returns:" not in (inspect.getdoc(obj) or ""):
                offenders.append(f"{name} lacks Returns:")
    expect_none(offenders)


def test_signatures_of_classes_for_users_show_their_arguments():
    """In ``help`` and in editors."""
    expect_none(
        name
        for name, cls in FOR_USERS.items()
        if inspect.isclass(cls)
        for parameter in inspect.signature(cls).parameters.values()
        if parameter.kind is inspect.Parameter.VAR_POSITIONAL
    )


def test_classes_for_users_can_be_inspected():
    """By editors, and by mocks with the attributes of a class."""
    for cls in filter(inspect.isclass, FOR_USERS.values()):
        assert inspect.getmembers(cls)
