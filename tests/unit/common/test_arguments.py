"""Arguments: checks, and printed forms of laws, materials and obstacles."""

import numpy as np
import pytest
import ufl

import dolfinx_nts as nts
from dolfinx_nts.common.arguments import finite, instances, nonnegative, positive, real

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
        ([str], "expected a str, given the class str"),
    ],
)
def test_lists_of_other_kinds_are_refused(items, message):
    with pytest.raises(TypeError, match=message):
        instances(str, items)


@pytest.mark.parametrize("value", [2, 2.0, np.float64(2), np.int32(2)])
def test_numbers_of_any_type_are_taken(value):
    assert real("a", value) == finite("a", value) == 2.0
    assert positive("a", value) == nonnegative("a", value) == 2.0


@pytest.mark.parametrize("value", ["1", None, 1j, [1.0]])
@pytest.mark.parametrize("check", [real, finite, nonnegative, positive])
def test_arguments_that_are_no_numbers_are_refused(check, value):
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


def my_energy(C, a):
    """Some energy."""
    return a * (ufl.tr(C) - 3 - ufl.ln(ufl.det(C)))


@pytest.mark.parametrize(
    ("item", "text"),
    [
        (nts.LagrangeMultiplier(), "LagrangeMultiplier(impact='elastic')"),
        (nts.Penalty(), "Penalty(eps_N=None)"),
        (nts.Penalty(1.5e6), "Penalty(eps_N=1500000)"),
        (nts.Penalty().halved(), "Penalty(eps_N=None, share=0.5)"),
        (nts.Coulomb(0.3), "Coulomb(mu=0.3, eps_T=None, law='objective')"),
        (
            nts.Coulomb(np.float64(0.3), 2e-7, law="convective"),
            "Coulomb(mu=0.3, eps_T=2e-07, law='convective')",
        ),
        (
            nts.SaintVenantKirchhoff(E=1e5, nu=0.4, rho=1e3),
            "SaintVenantKirchhoff(E=100000, nu=0.4, rho=1000)",
        ),
        (
            nts.NeoHookean(1e5, 0.49, 1e3, mass_damping=2.0, one_point=["lmbda"]),
            "NeoHookean(E=100000, nu=0.49, volumetric='log', rho=1000, mass_damping=2, "
            "one_point=('lmbda',))",
        ),
        (
            nts.MooneyRivlin(c10=0.3, c01=0.1, kappa=20.0, rho=1.0, stiffness_damping=1e-3),
            "MooneyRivlin(c10=0.3, c01=0.1, kappa=20, rho=1, stiffness_damping=0.001)",
        ),
        (
            nts.Yeoh(c10=0.3, c20=-0.1, c30=0.01, kappa=20.0, rho=1.0),
            "Yeoh(c10=0.3, c20=-0.1, c30=0.01, kappa=20, rho=1)",
        ),
        (
            nts.Hyperelastic(my_energy, rho=1.25, a=7),
            "Hyperelastic(psi=my_energy, a=7, rho=1.25)",
        ),
        (
            nts.RigidPlane((-0.0, 0.1, 2), (0, 0, -3)),
            "RigidPlane(point=(0, 0.1, 2), normal=(0, 0, -1))",
        ),
        (
            nts.RigidSphere((1, 2, 3), 0.5, hollow=True),
            "RigidSphere(centre=(1, 2, 3), radius=0.5, hollow=True)",
        ),
        (
            nts.RigidCylinder((1, 2, 3), (0, 2, 0), 0.5),
            "RigidCylinder(point=(1, 2, 3), axis=(0, 1, 0), radius=0.5, hollow=False)",
        ),
        (
            nts.RigidSurface(np.eye(3), [[0, 1, 2]], outside=(2, 2, 2)),
            "RigidSurface(num_facets=1)",
        ),
    ],
    ids=lambda value: type(value).__name__,
)
def test_printed_are_the_class_and_its_numbers_by_name(item, text):
    assert repr(item) == text
