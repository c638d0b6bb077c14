"""Pictures: written once, not empty; von Mises stress in closed form."""

import numpy as np
import pytest

from dolfinx_nts import plotting
from dolfinx_nts.output import Recorder
from scenes import BLOCK_RUBBER, blocks

pytest.importorskip("pyvista")
image = pytest.importorskip("matplotlib.image")


@pytest.fixture
def folder(comm, tmp_path):
    """Return one folder for all ranks."""
    return comm.bcast(tmp_path)


def colours(comm, path):
    """Number of different colours in a picture. Collective."""
    comm.barrier()
    return len(np.unique(np.asarray(image.imread(path)).reshape(-1, 4)[:, :3], axis=0))


@pytest.mark.parametrize("colour", ["stress", "displacement"])
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("degree", [1, 2])
def test_snapshot_shows_the_bodies(comm, folder, agree, colour, cell, degree):
    stepper = blocks(comm, cell=cell, degree=degree).stepper
    for _ in range(3):
        stepper.advance()
    plotting.snapshot(stepper, folder / "a.png", colour=colour)
    assert agree(colours(comm, folder / "a.png") > 500)
    camera = [(5.0, 5.0, 5.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)]
    plotting.snapshot(stepper, folder / "b.png", colour=colour, limits=(0.0, 1.0), camera=camera)
    assert agree(colours(comm, folder / "b.png") > 50)


def test_von_mises_stress_of_a_stretched_bar(comm):
    stepper = blocks(comm).stepper
    E, nu, _ = BLOCK_RUBBER
    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    stretch = 1.3
    for body in stepper.bodies:
        stepper.set_displacement(body, lambda X: np.diag([stretch - 1, 0, 0]) @ X)
    strain = (stretch**2 - 1) / 2
    axial = stretch * (lmbda + 2 * mu) * strain  # sigma_11 = F^2 S_11 / J
    lateral = lmbda * strain / stretch
    stress = plotting._von_mises(stepper)
    error = np.abs(stress - (axial - lateral)).max(initial=0.0)
    assert comm.allreduce(error) < 1e-12 * axial


def test_diagrams_of_a_run(comm, folder, agree):
    stepper = blocks(comm).stepper
    with Recorder(folder / "run", stepper) as record:
        for step in stepper.run(until=0.06):
            record.write(step)
    plotting.energies(folder / "run.csv", folder / "energies.png")
    plotting.momenta(folder / "run.csv", folder / "momenta.png")
    plotting.energy_error({"scheme": folder / "run.csv"}, folder / "error.png")
    for name in ("energies", "momenta", "error"):
        assert agree(colours(comm, folder / f"{name}.png") > 50)


def test_an_unknown_colour_is_refused(comm, folder, refused):
    with refused(ValueError, "'stress' or 'displacement', given 'red'"):
        plotting.snapshot(blocks(comm).stepper, folder / "a.png", colour="red")
    assert not any(folder.iterdir())


def test_a_missing_folder_is_refused_on_all_ranks(comm, folder, refused):
    with refused(FileNotFoundError, "nowhere"):
        plotting.snapshot(blocks(comm).stepper, folder / "nowhere" / "a.png")
