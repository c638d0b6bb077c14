"""Test parameters for which several ranks test nothing that other parameters do not test."""

from collections.abc import Iterable, Mapping
from typing import Any

import pytest

__all__ = ["once", "once_except"]


def once(*values: Any, id: str | None = None) -> Any:
    """Parameters with which a test runs on one rank only.

    Args:
        values: The parameters.
        id: Name of the test.

    Returns:
        What `pytest.mark.parametrize` takes.
    """
    return pytest.param(*values, marks=pytest.mark.serial, id=id)


def once_except(cases: Iterable[Any], *several: Any) -> list[Any]:
    """Cases that all run on one rank, and some of them on several.

    Args:
        cases: The cases; of a mapping the names, which become names of the tests.
        several: Cases, of a mapping their names, for several ranks.

    Returns:
        What `pytest.mark.parametrize` takes.
    """
    if isinstance(cases, Mapping):
        named = [(name, pytest.param(case, id=name)) for name, case in cases.items()]
    else:
        named = [(case, pytest.param(case)) for case in cases]
    assert {*several} <= {name for name, _ in named}
    return [case if name in several else once(*case.values, id=case.id) for name, case in named]
