"""Largest stable step: bounds against eigenvalues of assembled matrices."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.jit import compile_quickly
from dolfinx_nts.integrators.explicit import stability
from dolfinx_nts.model.bodies import bulk_form
from dolfinx_nts.model.lumped_mass import lumped_mass
from helpers import scenes
from helpers.models import box_meshes
from helpers.scene import Motion

pytestmark = pytest.mark.at_most_two_ranks


def lengths(cells):
    """Lengths of cells without common nodes, shape ``(c, k, 3)``."""
    c, k, _ = cells.shape
    return _kernels.cell_lengths(
        cells.reshape(-1, 3), np.arange(c * k, dtype=np.int32).reshape(c, k)
    )


@pytest.mark.serial
def test_length_of_a_brick_is_its_shortest_edge():
    corners = np.array(list(np.ndindex(2, 2, 2)))
    bricks = np.array([1.0 * corners * edges for edges in ((1, 1, 1), (3, 0.1, 2), (5, 5, 4))])
    np.testing.assert_allclose(lengths(bricks), [1, 0.1, 4])


@pytest.mark.serial
def test_length_does_not_depend_on_the_frame(rng):
    cells = rng.normal(size=(5, 4, 3))
    motion = Motion.random(rng)
    moved = motion(cells.reshape(-1, 3)).reshape(cells.shape)
    np.testing.assert_allclose(lengths(moved), lengths(cells))


@pytest.mark.serial
@pytest.mark.parametrize("k", [4, 8, 27])
def test_length_agrees_with_eigenvalues(rng, k):
    x = rng.normal(size=(30, 3))
    cells = rng.permuted(np.tile(np.arange(30, dtype=np.int32), (20, 1)), axis=1)[:, :k].copy()
    r = x[cells] - x[cells].mean(axis=1, keepdims=True)
    least = np.linalg.eigvalsh(r.transpose(0, 2, 1) @ r / k)[:, 0]
    np.testing.assert_allclose(_kernels.cell_lengths(x, cells) ** 2, 4 * least, atol=1e-14)
    with pytest.raises(ValueError, match="row numbers of x"):
        _kernels.cell_lengths(x, cells + 30)


@pytest.mark.serial
@pytest.mark.parametrize("nu", [0.0, 0.4])
def test_frequency_of_a_cube_agrees_with_its_swelling(nu):
    """Dilation by e: energy 9 K e^2 h^3/2, kinetic energy 3 rho h^5 e'^2/8."""
    E, rho, h = 4.0, 2.0, 0.5
    corners = h * np.array(list(np.ndindex(2, 2, 2)), dtype=float)[None]
    squared = stability.cell_frequency(nts.SaintVenantKirchhoff(E, nu, rho), corners)
    np.testing.assert_allclose(squared, 12 * (E / (3 * (1 - 2 * nu))) / (rho * h**2))


@pytest.mark.serial
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_estimate_is_on_the_safe_side_and_not_far_from_the_limit(comm, rng, cell, degree, nu):
    data = box_meshes.boxes([(3, 2, 2)], [(1.0, 0.8, 0.5)], cell)
    data.X[:] += rng.uniform(-0.03, 0.03, size=data.X.shape)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    material = nts.SaintVenantKirchhoff(10.0, nu, 2.0)
    body = nts.Body(V, cells, tag["body 0"], material)
    du, eta = ufl.TrialFunction(V), ufl.TestFunction(V)

    def stiffness(material, parameters, rho):
        stress = material.linear_stress(ufl.sym(ufl.grad(du)), **parameters)
        return ufl.inner(stress, ufl.grad(eta))

    K = fem.assemble_matrix(compile_quickly(bulk_form([body], stiffness))).to_dense()
    scale = 1 / np.sqrt(np.repeat(lumped_mass([body]), 3))
    highest = np.linalg.eigvalsh(scale[:, None] * K * scale)[-1]
    x = V.tabulate_dof_coordinates()
    bound, _ = stability.Cells([body]).limits(x)
    assert highest <= bound <= 4 * highest


@pytest.mark.serial
@pytest.mark.parametrize("alpha, beta", [(0.0, 0.0), (5.0, 0.0), (0.0, 0.02), (3.0, 0.3)])
def test_damped_oscillator_is_stable_up_to_the_step(alpha, beta):
    """Steps v += dt (-w^2 u - c v), u += dt v: eigenvalues within the unit circle."""
    squared = 100.0
    damping = stability.Damping(alpha, beta)
    limit = stability.largest_step(squared, damping)
    assert damping.highest(limit) == pytest.approx(squared)
    c = alpha + beta * squared

    def radius(dt):
        v = np.array([-dt * squared, 1 - dt * c])
        return np.abs(np.linalg.eigvals([np.array([1, 0]) + dt * v, v])).max()

    assert radius(0.999 * limit) <= 1 + 1e-6
    assert radius(1.001 * limit) > 1


@pytest.mark.serial
@pytest.mark.parametrize("degree", [1, 2])
def test_a_rank_without_cells_has_no_frequencies(degree):
    """Regression: it failed for cells other than degree 1 in space or in the plane."""
    law, element = nts.NeoHookean(1e3, 0.3, 1.0), Element("quadrilateral", degree)
    none = np.empty((0, 4, 2)), np.empty((0, (degree + 1) ** 2), dtype=bool)
    assert stability.highest_frequency(law, element, *none).shape == (0,)


@pytest.mark.serial
def test_no_step_is_stable_for_a_cell_without_length(comm):
    stepper = scenes.blocks(comm).stepper
    squared, shortest = stability.Cells(stepper.bodies).limits(np.zeros_like(stepper.x))
    assert squared == np.inf and shortest == 0
    for damping in (stability.Damping(0.0, 0.0), stability.Damping(1.0, 0.1)):
        assert stability.largest_step(squared, damping) == 0


@pytest.mark.parametrize(("energy", "is_reported"), [(1e-26, False), (1e-3, True)])
def test_energy_of_springs_is_reported_above_round_off_only(comm, energy, is_reported):
    scene = scenes.blocks(comm, nts.CentralDifference, nts.Penalty())
    stepper = scene.stepper
    watch = stability.Stability(stepper.bodies, [], mass=1.0)
    watch.longest_steps(stepper.x)
    watch.start(0.0)
    watch.count([], 0.0, ContactWork(activation=energy))
    assert bool(watch.exchanged(1e-3)) == is_reported
