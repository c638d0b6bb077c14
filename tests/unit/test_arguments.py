"""Checks of arguments."""

import numpy as np
import pytest

from dolfinx_nts.arguments import finite, instances, nonnegative, positive, real

pytestmark = pytest.mark.serial


def test_lists_are_returned_as_tuples():
    assert instances(int, [1, 2]) == (1, 2)
    assert instances(int, iter([1])) == (1,)
    assert instances(str, ["ab"]) == ("ab",)


@pytest.mark.parametrize(
    ("items", "message"),
    [
        ("ab", "expected a list of str, given str"),
        (3, "expected a list of str, given int"),
        (None, "expected a list of str, given NoneType"),
        (["ab", 3], "expected a str, given int"),
        ([str], "expected a str, given type"),
    ],
)
def test_what_is_no_list_of_a_kind_is_refused(items, message):
    with pytest.raises(TypeError, match=message):
        instances(str, items)


@pytest.mark.parametrize("value", [2, 2.0, np.float64(2), np.int32(2)])
def test_numbers_of_any_type_are_taken(value):
    assert real("a", value) == finite("a", value) == 2.0
    assert positive("a", value) == nonnegative("a", value) == 2.0


@pytest.mark.parametrize("value", ["1", None, 1j, [1.0]])
@pytest.mark.parametrize("check", [real, finite, nonnegative, positive])
def test_what_is_no_number_is_refused(check, value):
    with pytest.raises(TypeError, match="expected a number for a, given"):
        check("a", value)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(value):
    with pytest.raises(ValueError, match="expected a finite number for a"):
        finite("a", value)
    with pytest.raises(ValueError, match="expected a > 0"):
        positive("a", value)
    with pytest.raises(ValueError, match="expected a >= 0"):
        nonnegative("a", value)


def test_signs_are_checked():
    assert finite("a", -1) == -1
    assert nonnegative("a", 0) == 0
    with pytest.raises(ValueError, match="expected a >= 0, given -1"):
        nonnegative("a", -1)
    with pytest.raises(ValueError, match="expected a > 0, given 0"):
        positive("a", 0)
