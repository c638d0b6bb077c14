"""What the package offers is listed, sorted, documented and annotated."""

import importlib
import inspect
import pkgutil
import re

import pytest

import dolfinx_nts

pytestmark = pytest.mark.serial

# Modules that import a library which may be missing do so inside functions.
MODULES = sorted(
    name.removeprefix("dolfinx_nts.")
    for _, name, is_wing in pkgutil.walk_packages(dolfinx_nts.__path__, "dolfinx_nts.")
    if not (is_wing or name == "dolfinx_nts._kernels")
)


def public_objects():
    """Everything in `__all__` of the package and of its modules."""
    found = {}
    for name in ["", *MODULES]:
        module = importlib.import_module(f"dolfinx_nts.{name}" if name else "dolfinx_nts")
        for entry in module.__all__:
            obj = getattr(module, entry)
            if inspect.isclass(obj) or inspect.isfunction(obj):
                found[f"{obj.__module__}.{obj.__qualname__}"] = obj
    return found


OBJECTS = public_objects()
objects = pytest.mark.parametrize("name", sorted(OBJECTS))

# What users call: the names of the package, and these modules beside it.
BESIDE = (
    *("meshing.gmsh", "meshing.boxes", "meshing.balls", "meshing.rings"),
    *("diagnostics.balance", "io.recorder"),
    *("plotting.pictures", "plotting.diagrams"),
)
FOR_USERS = sorted(
    name
    for name, obj in OBJECTS.items()
    if obj.__name__ in dolfinx_nts.__all__
    or name.removeprefix("dolfinx_nts.").rpartition(".")[0] in BESIDE
)
for_users = pytest.mark.parametrize("name", FOR_USERS)


@pytest.mark.parametrize("name", [n for n in FOR_USERS if inspect.isclass(OBJECTS[n])])
def test_class_tells_its_arguments(name):
    """As ``help`` and editors show them."""
    kinds = {p.kind for p in inspect.signature(OBJECTS[name]).parameters.values()}
    assert inspect.Parameter.VAR_POSITIONAL not in kinds


def methods(cls):
    """Public functions and properties that a class defines itself."""
    for name, value in vars(cls).items():
        if not name.startswith("_"):
            value = getattr(value, "__func__", value)
            if isinstance(value, property):
                value = value.fget
            if inspect.isfunction(value):
                yield name, value


def parameters(function):
    names = list(inspect.signature(function).parameters)
    return [n for n in names if n not in ("self", "cls")]


@pytest.mark.parametrize("module", ["", *MODULES])
def test_all_exists_and_is_sorted(module):
    found = importlib.import_module(f"dolfinx_nts.{module}" if module else "dolfinx_nts")
    names = found.__all__
    # As ruff sorts: constants, classes, functions.
    kinds = [0 if n.isupper() else 1 if n[0].isupper() else 2 for n in names]
    assert list(names) == [n for _, n in sorted(zip(kinds, names, strict=True))]
    assert all(hasattr(found, name) for name in names)
    assert found.__doc__


def test_package_has_a_version():
    assert dolfinx_nts.__version__.count(".") == 2


def test_dir_lists_the_public_names_only():
    assert dir(dolfinx_nts) == sorted([*dolfinx_nts.__all__, "__version__"])


def test_wings_for_users_are_imported_from_the_package():
    from dolfinx_nts import meshing, parts, plotting

    assert parts is dolfinx_nts.parts and plotting is dolfinx_nts.plotting
    assert parts.add_box is meshing.add_box


@objects
def test_object_has_a_docstring(name):
    assert inspect.getdoc(OBJECTS[name])


@for_users
def test_docstring_names_all_arguments_or_attributes(name):
    obj = OBJECTS[name]
    doc = inspect.getdoc(obj)
    assert doc, name
    is_data = hasattr(obj, "__dataclass_fields__") or hasattr(obj, "_fields")
    if is_data:
        fields = getattr(obj, "__dataclass_fields__", None) or obj._fields
        public = [f for f in fields if not f.startswith("_")]
        assert "Attributes:" in doc or not public
        for field in public:
            assert f"{field}:" in doc, f"{name} lacks {field}"
        return
    if inspect.isclass(obj) and issubclass(obj, Exception):
        return
    takes = obj.__init__ if inspect.isclass(obj) else obj
    if takes is object.__init__:
        return
    # Classes that take the same as another of the package may say so.
    if same := re.search(r"Arguments,\sattributes\sand\serrors\sare\sthose\sof\s`(\w+)`", doc):
        other = getattr(dolfinx_nts, same[1])
        assert inspect.signature(other) == inspect.signature(obj)
        doc = inspect.getdoc(other)
    arguments = parameters(takes)
    if arguments:
        assert "Args:" in doc, name
        for argument in arguments:
            assert f"{argument}:" in doc, f"{name} lacks {argument}"


@objects
def test_methods_are_documented(name):
    obj = OBJECTS[name]
    if not inspect.isclass(obj):
        pytest.skip("a function")
    lacking = [method for method, function in methods(obj) if not inspect.getdoc(function)]
    assert not lacking


@for_users
def test_functions_say_what_they_return(name):
    obj = OBJECTS[name]
    if inspect.isclass(obj) or inspect.signature(obj).return_annotation in (None, "None"):
        pytest.skip("returns nothing")
    assert "Returns:" in inspect.getdoc(obj)


@objects
def test_everything_public_is_annotated(name):
    obj = OBJECTS[name]
    functions = [f for _, f in methods(obj)] if inspect.isclass(obj) else [obj]
    for function in functions:
        signature = inspect.signature(function)
        assert signature.return_annotation is not inspect.Signature.empty, function
        for parameter in signature.parameters.values():
            if parameter.name not in ("self", "cls"):
                assert parameter.annotation is not inspect.Parameter.empty, function
