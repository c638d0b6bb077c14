"""Archive in memory: restored values equal stored ones."""

import numpy as np
import pytest

from dolfinx_nts.common.archive import Snapshot

pytestmark = pytest.mark.serial


def test_numbers_come_back_with_their_kinds():
    archive = Snapshot()
    taken = {"int": 3, "float": 0.1, "bool": True}
    for name, value in taken.items():
        assert archive.same(name, value) is value
    archive.rewind()
    assert archive.restores
    for name, value in taken.items():
        given = archive.same(name, type(value)(0))
        assert (type(given), given) == (type(value), value)


@pytest.mark.parametrize("kind", ["same", "nodal"])
def test_arrays_are_copied_in_both_directions(kind):
    archive = Snapshot()
    ids = np.arange(2)

    def exchange(values):
        return archive.same("a", values) if kind == "same" else archive.nodal("a", ids, values)

    values = np.array([1.0, 2.0])
    assert exchange(values) is values
    values[0] = 7.0
    archive.rewind()
    for _ in range(2):
        given = exchange(values)
        np.testing.assert_array_equal(given, [1.0, 2.0])
        given[1] = 8.0
    np.testing.assert_array_equal(values, [7.0, 2.0])


def test_local_arrays_are_the_very_same_or_none():
    archive = Snapshot()
    array = np.zeros(1)
    archive.local("work", [array])
    archive.local("nothing", None)
    archive.rewind()
    (given,) = archive.local("work", None)
    assert given is array
    assert archive.local("nothing", [array]) is None


def test_value_that_is_not_restored_is_reported():
    with pytest.raises(KeyError, match="other"):
        Snapshot().rewind().same("other", 0.0)
