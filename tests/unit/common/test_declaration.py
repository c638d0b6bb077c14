"""Declarations of users are immutable; the error explains the alternative."""

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers import scenes

DECLARED = [
    (nts.RigidSphere((0, 0, 0), 1.0), "centre"),
    (nts.RigidPlane((0, 0, 0), (0, 0, 1)), "_point"),
    (nts.RigidSurface(np.eye(3), [[0, 1, 2]], (9, 9, 9)), "_points"),
    (nts.Penalty(1.0), "eps_N"),
    (nts.Penalty(1.0).halved(), "share"),
    (nts.LagrangeMultiplier(), "impact"),
    (nts.Coulomb(0.3), "mu"),
    (nts.NeoHookean(1.0, 0.3, 1.0), "rho"),
    (nts.StepControl(), "gap_tol"),
]


@pytest.mark.serial
@pytest.mark.parametrize(("item", "name"), DECLARED, ids=lambda value: type(value).__name__)
def test_declarations_are_immutable(item, name):
    before, kind = repr(item), type(item).__name__
    with pytest.raises(
        AttributeError, match=f"{name}: create another {kind} with it, and the objects"
    ):
        setattr(item, name, 5.0)
    assert repr(item) == before


def test_bodies_surfaces_and_pairs_never_change(comm):
    scene = scenes.blocks(comm)
    pair, body = scene.stepper.pairs[0], scene.stepper.bodies[0]
    for item, name in (
        (pair, "enforcement"),
        (pair.nodes, "segments"),
        (body, "material"),
    ):
        with pytest.raises(
            AttributeError, match=f"expected no change of a {type(item).__name__} after"
        ):
            setattr(item, name, None)


@pytest.mark.parametrize("name", ["bodies", "pairs", "loads"])
def test_arguments_of_a_stepper_are_immutable(comm, name):
    stepper = scenes.blocks(comm).stepper
    before = getattr(stepper, name)
    with pytest.raises(AttributeError, match=f"create a new EnergyMomentum with another {name}"):
        setattr(stepper, name, ())
    assert getattr(stepper, name) is before


@pytest.mark.serial
def test_a_stepper_has_no_arguments_before_it_is_made():
    class Eager(nts.EnergyMomentum):
        def __init__(self):
            self.found = hasattr(self, "pairs")

    assert not Eager().found


@pytest.mark.serial
def test_a_class_derived_from_a_declaration_sets_its_own_attributes():
    class Wall(nts.RigidPlane):
        def __init__(self, height):
            super().__init__((0, 0, height), (0, 0, 1))
            self.height = height

    wall = Wall(2.0)
    assert wall.height == 2.0
    with pytest.raises(AttributeError, match="create another Wall with it"):
        wall.height = 3.0


@pytest.mark.serial
@pytest.mark.parametrize(
    ("arguments", "options", "given"),
    [((), {"E": 1e5, "nu": 0.3}, "E=, nu="), ((1e5,), {"nu": 0.3, "density": 1}, "float, nu=")],
    ids=["missing", "unknown"],
)
def test_missing_argument_is_named_with_all_that_the_class_takes(arguments, options, given):
    expected = r"expected NeoHookean\(E, nu, rho, .*\), of which E and nu and rho must be given"
    with pytest.raises(TypeError, match=rf"{expected}, given NeoHookean\({given}.*'rho'"):
        nts.NeoHookean(*arguments, **options)
