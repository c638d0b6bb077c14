"""Pictures: written once, not empty; what they show in closed form."""

from unittest import mock

import numpy as np
import pytest

from dolfinx_nts import plotting
from dolfinx_nts.io.recorder import Recorder
from dolfinx_nts.plotting import pictures
from dolfinx_nts.plotting.stress import von_mises
from helpers.scenes import BLOCK_RUBBER, BLOCK_STEP, blocks, gathered

pytest.importorskip("pyvista")
image = pytest.importorskip("matplotlib.image")


def once(value):
    """Parameter of tests that run on one rank only: one rank draws, and slowly."""
    return pytest.param(value, marks=pytest.mark.serial)


@pytest.fixture
def folder(comm, tmp_path):
    """Return one folder for all ranks."""
    return comm.bcast(tmp_path)


def colours(comm, path):
    """Number of different colours in a picture. Collective."""
    comm.barrier()
    return len(np.unique(np.asarray(image.imread(path)).reshape(-1, 4)[:, :3], axis=0))


@pytest.mark.parametrize("colour", ["stress", once("displacement")])
@pytest.mark.parametrize("cell", [once("hexahedron"), "tetrahedron"])
@pytest.mark.parametrize("degree", [once(1), 2])
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
    stress = von_mises(stepper)
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
    plotting.forces(folder / "run.csv", folder / "forces.png")
    for name in ("energies", "momenta", "error", "forces"):
        assert agree(colours(comm, folder / f"{name}.png") > 50)


def test_an_unknown_colour_is_refused(comm, folder, refused):
    with refused(ValueError, "'stress' or 'displacement', given 'red'"):
        plotting.snapshot(blocks(comm).stepper, folder / "a.png", colour="red")
    assert not any(folder.iterdir())


def test_a_missing_folder_is_refused_on_all_ranks(comm, folder, refused):
    with refused(FileNotFoundError, "nowhere"):
        plotting.snapshot(blocks(comm).stepper, folder / "nowhere" / "a.png")


@pytest.mark.parametrize("cell", [once("hexahedron"), "tetrahedron"])
@pytest.mark.parametrize("colour", [once("pressure"), "gap"])
def test_contact_is_drawn_before_and_while_bodies_touch(comm, folder, agree, cell, colour):
    stepper = blocks(comm, cell=cell).stepper
    for name, steps in (("apart", 0), ("touching", 5)):
        for _ in range(steps):
            stepper.advance()
        plotting.contact(stepper, folder / f"{name}.png", colour=colour)
        assert agree(colours(comm, folder / f"{name}.png") > 50)


def test_a_wrong_contact_picture_is_refused(comm, folder, refused):
    stepper = blocks(comm).stepper
    with refused(ValueError, "'pressure' or 'gap', given 'stress'"):
        plotting.contact(stepper, folder / "a.png", colour="stress")
    with refused(IndexError, "range"):
        plotting.contact(stepper, folder / "a.png", pair=7)


@pytest.fixture
def recorded(comm, folder):
    """Record three states; positions of the nodes in each."""
    stepper = blocks(comm).stepper
    V = stepper.u.function_space
    positions = [gathered(V, stepper.x)]
    with Recorder(folder / "run", stepper) as record:
        for step in stepper.run(until=2 * BLOCK_STEP):
            record.write(step)
            positions.append(gathered(V, stepper.x))
    return positions


def test_states_of_a_movie_are_those_of_the_run(comm, folder, agree, recorded):
    times, grids = pictures._states(folder / "run.xdmf", "velocity", "v")
    assert agree(np.allclose(times, BLOCK_STEP * np.arange(3)))
    for grid, x in zip(grids, recorded, strict=True):
        assert agree(np.allclose(grid.points, x, rtol=0, atol=1e-14))
        assert agree(np.allclose(grid["v"], np.linalg.norm(grid["velocity"], axis=1)))


@pytest.mark.parametrize(
    "colour", [once("displacement"), once("contact_pressure"), "gap", once("body")]
)
def test_a_run_becomes_a_gif(comm, folder, agree, recorded, colour):
    from PIL import Image

    plotting.animate(folder / "run.xdmf", folder / "run.gif", colour=colour, fps=10)
    comm.barrier()
    with Image.open(folder / "run.gif") as movie:
        assert agree(movie.n_frames == 3 and movie.info["duration"] == 100)
        assert agree(len(np.unique(np.asarray(movie.convert("RGB")).reshape(-1, 3), axis=0)) > 20)


def test_a_field_that_is_not_there_is_refused(comm, folder, recorded):
    if comm.rank == 0:
        with pytest.raises(ValueError, match=r"colour out of .*given 'stress'"):
            plotting.animate(folder / "run.xdmf", folder / "run.gif", colour="stress")
        assert not (folder / "run.gif").exists()


@pytest.mark.parametrize("place", ["notebook", "window", "nowhere"])
def test_pictures_to_turn_appear_where_there_is_a_place(comm, monkeypatch, refused, place):
    monkeypatch.setattr("scooby.in_ipykernel", lambda: place == "notebook")
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    if place == "window":
        monkeypatch.setenv("DISPLAY", ":0")
    stepper = blocks(comm).stepper
    with mock.patch("pyvista.Plotter") as plotter:
        if place == "nowhere":
            with refused(RuntimeError, "expected a notebook or a display"):
                plotting.show(stepper)
        else:
            plotting.show(stepper)
    if comm.rank == 0 and place != "nowhere":
        options = plotter.call_args.kwargs
        assert options["notebook"] == (place == "notebook")
        assert not options["off_screen"]
        plotter.return_value.show.assert_called_once_with()
        # What a notebook shows must live on.
        assert plotter.return_value.close.called == (place == "window")
    else:
        plotter.assert_not_called()
