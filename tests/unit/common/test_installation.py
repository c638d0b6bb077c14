"""Error messages where a required package is not installed."""

import pytest

from dolfinx_nts.common import installation

pytestmark = pytest.mark.serial


def test_all_that_is_needed_is_found():
    installation.check_installation()


@pytest.mark.parametrize("missing", [["petsc4py"], ["dolfinx"], ["mpi4py", "dolfinx", "petsc4py"]])
def test_missing_packages_are_named_with_where_they_come_from(missing, monkeypatch):
    found = installation.find_spec
    monkeypatch.setattr(
        installation, "find_spec", lambda name: None if name in missing else found(name)
    )
    match = rf"without {' and '.join(missing)}: conda .*apt-get .*pip install dolfinx-solver-real"
    with pytest.raises(ImportError, match=match):
        installation.check_installation()
