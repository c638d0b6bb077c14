"""Slip by convective coordinates: twin, derivatives, equilibrium."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.pair_state import PairState
from helpers import scenes
from helpers.step_parts import following
from reference import nts as reference
from reference.bulk import rotation, sample_pairs, taylor_order

pytestmark = pytest.mark.at_most_two_ranks

ROUNDING = 1e4 * np.finfo(float).eps

kinds = pytest.mark.parametrize("k", [3, 4])
sides = pytest.mark.parametrize("orientation", [1.0, -1.0])


def two_states(k, orientation):
    """Return pairs at t_n and after a small motion."""
    x_n, signs, _, _ = sample_pairs(k, orientation)
    return x_n, x_n + 0.05 * np.random.default_rng(k).normal(size=x_n.shape), signs


@kinds
@sides
def test_slip_and_its_gradients_agree_with_the_twin(k, orientation):
    x_n, x, signs = two_states(k, orientation)
    twin = [reference.convective_slip(*pair, orientation) for pair in zip(x_n, x, strict=True)]
    for ours, theirs in zip(
        _kernels.convective_slip(x_n, x, signs)[:3], zip(*twin, strict=True), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, atol=ROUNDING)


@kinds
@sides
def test_gradient_and_hessian_have_remainders_of_second_order(k, orientation, rng):
    x_n, x, signs = two_states(k, orientation)
    _, _, gradient, hessian, *_ = _kernels.convective_slip(x_n, x, signs)
    d = 0.2 * rng.normal(size=x.shape)
    flat = d.reshape(len(x), -1)

    def slip(y):
        return _kernels.convective_slip(x_n, y, signs)[0]

    def forces(y):
        return _kernels.convective_slip(x_n, y, signs)[1]

    assert taylor_order(slip, x, d, np.einsum("mid,md->mi", gradient, flat)) > 1.9
    # The force is evaluated at the midpoint.
    assert taylor_order(forces, x, d, np.einsum("mide,me->mid", hessian, flat) / 2) > 1.9
    np.testing.assert_allclose(hessian, hessian.swapaxes(2, 3), atol=ROUNDING)


@kinds
@sides
def test_forces_and_their_moments_at_the_midpoint_vanish(k, orientation):
    x_n, x, signs = two_states(k, orientation)
    force = _kernels.convective_slip(x_n, x, signs)[1].reshape(len(x), 2, 1 + k, 3)
    assert np.abs(force.sum(axis=2)).max() < ROUNDING
    assert np.abs(np.cross((x_n + x)[:, None] / 2, force).sum(axis=2)).max() < ROUNDING


@kinds
def test_slip_is_unchanged_by_a_rigid_motion_within_the_step(k):
    x_n, x, signs = two_states(k, 1.0)
    moved = x @ rotation(np.array([1.0, 2, 3]), 1.1).T + [3.0, -1, 2]
    value, turned = (_kernels.convective_slip(x_n, y, signs)[0] for y in (x, moved))
    np.testing.assert_allclose(turned, value, atol=ROUNDING)


@kinds
def test_work_is_the_slip_up_to_third_order(k):
    x_n, x, signs = two_states(k, 1.0)
    errors = []
    for h in (0.02, 0.01):
        dx = h * (x - x_n)
        value, force, *_ = _kernels.convective_slip(x_n, x_n + dx, signs)
        work = np.einsum("mid,md->mi", force, dx.reshape(len(x), -1))
        errors.append(np.abs(work - value).max())
    assert np.log2(errors[0] / errors[1]) > 2.8


@kinds
@sides
def test_frame_carries_covariant_components_to_the_end_of_the_step(k, orientation, rng):
    # t = t_a a^a at both ends with the same t_a: the same products with a_a.
    x_n, x, signs = two_states(k, orientation)
    *_, frame_n, frame = _kernels.convective_slip(x_n, x, signs)
    covariant = []
    for y, e in ((x_n, frame_n), (x, frame)):
        xi = _kernels.project(y, signs)[0]
        tangents = [reference.shape_functions(c, k)[1] @ z[1:] for c, z in zip(xi, y, strict=True)]
        covariant.append(np.einsum("mic,mac->mia", e, tangents))
    np.testing.assert_allclose(*covariant, atol=ROUNDING)


def pair_of(scene, enforcement, friction):
    (pair,) = scene.stepper.pairs
    return nts.ContactPair(
        pair.nodes, pair.segments, enforcement, friction, method="node-to-segment"
    )


@pytest.mark.serial
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize(("mu", "slides"), [(0.01, True), (1e3, False)])
def test_tangent_of_the_pairs_is_the_derivative_of_their_forces(comm, rng, cell, mu, slides):
    scene = scenes.blocks(comm, nts.Midpoint, cell=cell)
    pair = pair_of(scene, nts.Penalty(50.0), nts.Coulomb(mu, eps_T=20.0, law="convective"))
    x_n = scene.stepper.x
    travel = 0.04 * scene.stepper.v.x.array.reshape(-1, 3)
    x = x_n + travel + 0.01 * rng.normal(size=x_n.shape)
    contact, given = PairState(pair), np.ones(len(pair.nodes.nodes))
    contact.choose_penalty(given, given)  # the stiffnesses are the given ones
    step = ContactStep(contact, "midpoint", x_n, x_n + travel, np.ones(len(x)))
    for iteration in range(3):
        state = step.evaluate(x, None, iteration)
    assert state.changed == 0
    assert state.active.sum() > 1
    assert np.all(step.friction.sliding[state.pairs.node[state.active]] == slides)
    d = 0.05 * rng.normal(size=x.shape)

    def forces(y):
        return step.evaluate(y, None, 1).residual

    local = step.candidates.scatter.forward(d)[state.pairs.dofs].reshape(state.residual.shape)
    # Penalty has no constraints: all of the derivative is in the tangent.
    slope = np.einsum("mij,mj->mi", state.tangent, local) + following(state, local)
    assert taylor_order(forces, x, d, slope) > 1.9


@pytest.mark.parametrize("what", ["multiplier", "obstacle", "scheme"])
def test_convective_friction_is_refused_where_it_is_not_defined(comm, what):
    scene = scenes.blocks(comm)
    (pair,), friction = scene.stepper.pairs, nts.Coulomb(0.3, law="convective")
    plane = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    if what == "multiplier":
        with pytest.raises(ValueError, match=r"expected Penalty and .* given LagrangeMultiplier"):
            nts.ContactPair(
                pair.nodes,
                pair.segments,
                nts.LagrangeMultiplier(),
                friction,
                method="node-to-segment",
            )
    elif what == "obstacle":
        with pytest.raises(ValueError, match=r"a Surface as segments .* RigidPlane"):
            nts.ContactPair(pair.nodes, plane, nts.Penalty(), friction, method="node-to-segment")
    else:
        pair = pair_of(scene, nts.Penalty(), friction)
        with pytest.raises(ValueError, match=r"expected Midpoint .* given EnergyMomentum"):
            nts.EnergyMomentum(scene.stepper.bodies, [pair], dt=0.1)


def test_other_laws_are_refused():
    with pytest.raises(ValueError, match="law 'objective' or 'convective', given 'exact'"):
        nts.Coulomb(0.3, law="exact")
