"""Pictures: written once, not empty; contents in closed form."""

import re
from unittest import mock

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import plotting
from dolfinx_nts.io.recorder import Recorder
from dolfinx_nts.plotting import diagrams, pictures
from dolfinx_nts.plotting.arguments import columns
from dolfinx_nts.plotting.canvas import aim
from dolfinx_nts.plotting.scales import prefixed, rounded
from dolfinx_nts.plotting.scene import surface_near, von_mises
from helpers.once import once
from helpers.scene import gathered
from helpers.scenes import BLOCK_RUBBER, BLOCK_STEP, blocks

pytestmark = pytest.mark.at_most_two_ranks

pytest.importorskip("pyvista")
pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")


def colours(comm, path):
    """Number of different colours in a picture. Collective."""
    comm.barrier()
    with Image.open(path) as picture:
        return num_colours(picture)


def num_colours(picture):
    """Number of different colours in a picture."""
    return len(
        np.unique(np.asarray(picture.convert("RGB")).astype(np.int32) @ [1 << 16, 1 << 8, 1])
    )


@pytest.mark.parametrize(
    # Each two of the three meet.
    ("colour", "cell", "degree"),
    [
        ("stress", "tetrahedron", 2),
        once("stress", "hexahedron", 1),
        once("displacement", "tetrahedron", 1),
        once("displacement", "hexahedron", 2),
    ],
)
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
    plotting.ledger(folder / "run.csv", folder / "ledger.png")
    plotting.force_displacement(
        folder / "run.csv", "min_gap", "contact_force_z", folder / "force_displacement.png"
    )
    for name in ("energies", "momenta", "error", "forces", "ledger", "force_displacement"):
        assert agree(colours(comm, folder / f"{name}.png") > 50)
    if comm.rank == 0:
        with pytest.raises(ValueError, match=r"columns from .*given \['way'\]; Recorder"):
            plotting.force_displacement(folder / "run.csv", "way", "contact_force_z")


@pytest.mark.serial
@pytest.mark.parametrize(("size", "pixels"), [((1, 9, 1), 480), ((1, 1, 9), 1200)])
def test_bodies_fill_the_picture_whatever_their_shape(size, pixels):
    """All of them are left of the bar of colours, below the time, and reach two of the ends."""
    pyvista = pytest.importorskip("pyvista")
    corners = np.array(np.meshgrid(*[[0, s] for s in size])).reshape(3, -1).T.astype(float)
    plotter = pyvista.Plotter(off_screen=True)
    aim(plotter, corners, camera=(1, 0, 0))
    width, height = plotter.window_size
    assert (width, height) == (1600, pixels)
    scale = height / 2 / plotter.camera.parallel_scale  # pixels in a metre
    y, z = (corners[:, 1:] - plotter.camera.focal_point[1:]).T * scale
    across, up = 0.5 + y / width, 0.5 + z / height
    assert across.min() >= 0.03 - 1e-9 and across.max() <= 0.84 + 1e-9
    assert up.min() >= 0.03 - 1e-9 and up.max() <= 0.91 + 1e-9
    assert up.mean() == pytest.approx(0.47)
    assert np.ptp(across) == pytest.approx(0.81) or np.ptp(up) == pytest.approx(0.88)
    plotter.close()


@pytest.mark.serial
def test_bodies_are_cut_open_in_the_middle_of_all(comm):
    stepper = blocks(comm).stepper
    drawn = []
    for cut in (None, (1, 0, 0)):
        with (
            mock.patch.object(plotting.Picture, "of_pixels", return_value=plotting.Picture(b"")),
            mock.patch("pyvista.Plotter") as plotter,
        ):
            plotting.snapshot(stepper, cut=cut)
        drawn.append(plotter.return_value.add_mesh.call_args_list[0].args[0])
    whole, half = drawn
    middle = np.mean(whole.bounds[:2])
    assert 0 < half.n_cells < whole.n_cells
    assert np.all(half.cell_centers().points[:, 0] <= middle + 1e-12)
    assert half.n_cells == np.sum(whole.cell_centers().points[:, 0] <= middle + 1e-12)


@pytest.mark.serial
def test_surface_of_an_obstacle_is_where_its_depth_is_zero():
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (50, 3))
    for obstacle, distance in (
        (nts.RigidPlane((0, 0, 0.2), (0, 0, 1)), lambda x: x[:, 2] - 0.2),
        (nts.RigidSphere((0, 0, 0), 0.7), lambda x: np.linalg.norm(x, axis=1) - 0.7),
        (nts.RigidCylinder((0, 0, 0), (1, 0, 0), 0.5), lambda x: np.hypot(*x[:, 1:].T) - 0.5),
    ):
        surface = surface_near(obstacle, points, 0.0)
        assert surface.n_points > 500
        assert np.abs(distance(surface.points)).max() < 2e-3
        # One that has moved up by 0.1 m and turned about the vertical.
        motion = nts.Motion(lambda t: (0, 0, 0.2 * t), lambda t: (0, 0, t))
        surface = surface_near(obstacle.moving(motion), points, 0.5)
        x = surface.points - [0, 0, 0.1]
        x[:, :2] = x[:, :2] @ [[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]]
        assert surface.n_points > 500
        assert np.abs(distance(x)).max() < 2e-3
    assert surface_near(nts.RigidPlane((0, 0, 9), (0, 0, 1)), points, 0.0).n_points == 0
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 1], [2, 2, 1]])
    drawn = surface_near(nts.RigidSurface(corners, [[0, 1, 2, 3]], (1, 1, 9)), points, 0.0)
    assert np.array_equal(drawn.points, corners) and drawn.n_cells == 1


@pytest.mark.serial
@pytest.mark.parametrize(
    ("value", "scale", "prefix"),
    [
        *((8e3, 1e3, "k"), (0.0024, 1e-3, "m"), (0.5, 1.0, ""), (99.0, 1.0, "")),
        *((-2.5e6, 1e6, "M"), (0.0, 1.0, ""), (1e-30, 1e-9, "n"), (np.inf, 1.0, "")),
    ],
)
def test_prefix_suits_the_number(value, scale, prefix):
    assert prefixed(value) == (pytest.approx(scale), prefix)


@pytest.mark.serial
def test_range_is_widened_to_labels_that_are_easy_to_read():
    assert rounded(0.07, 9.98) == (0.0, 10.0, 5)
    assert rounded(-1.3, 10.7) == (-5.0, 15.0, 5)
    assert rounded(0.0, 8.0) == (0.0, 8.0, 5)
    assert rounded(3.0, 3.0) == (3.0, 3.0, 2)


@pytest.mark.serial
def test_colour_bar_has_the_unit_and_time_the_prefix(comm, folder):
    stepper = blocks(comm).stepper
    for _ in range(3):
        stepper.advance()

    def drawn(**options):
        with (
            mock.patch.object(plotting.Picture, "of_pixels", return_value=plotting.Picture(b"")),
            mock.patch("pyvista.Plotter") as plotter,
        ):
            plotting.snapshot(stepper, **options)
        bar = plotter.return_value.add_mesh.call_args.kwargs["scalar_bar_args"]["title"]
        return bar.strip(), plotter.return_value.add_text.call_args.args[0]

    title, time = drawn()
    assert re.fullmatch(r"von Mises stress \[[kM]?Pa\]", title)
    assert re.fullmatch(r"t = [\d.]+ m?s", time)
    title, time = drawn(unit="MPa", limits=(0.0, 1.0))
    assert title == "von Mises stress [MPa]" and re.fullmatch(r"t = [\d.e-]+", time)


def test_pictures_are_displayed_by_a_notebook_and_need_no_file(comm, folder, agree):
    stepper = blocks(comm).stepper
    with Recorder(folder / "run", stepper) as record:
        for step in stepper.run(until=0.02):
            record.write(step)
    pictures = [plotting.snapshot(stepper), plotting.contact(stepper)]
    pictures += [draw(folder / "run.csv") for draw in (plotting.energies, plotting.energy_error)]
    pictures.append(plotting.animate(folder / "run.vtkhdf", folder / "run.gif"))
    if comm.rank == 0:
        kinds = [next(iter(picture._repr_mimebundle_())) for picture in pictures]
        assert kinds == ["image/png"] * 4 + ["image/gif"]
        pictures[0].save(folder / "a.png")
    assert agree(colours(comm, folder / "a.png") > 500)
    comm.barrier()
    assert {path.suffix for path in folder.iterdir() if path.is_file()} == {
        *(".csv", ".vtkhdf", ".gif", ".png")
    }


@pytest.mark.serial
def test_picture_that_was_not_drawn_here_shows_and_writes_nothing(tmp_path):
    picture = plotting.Picture(b"")
    picture.save(tmp_path / "a.png")
    assert picture._repr_mimebundle_() == {} and not any(tmp_path.iterdir())
    movie = plotting.Picture(b"123", "video/mp4")._repr_mimebundle_()
    assert "<video" in movie["text/html"] and "MTIz" in movie["text/html"]


@pytest.mark.serial
def test_energy_error_is_the_unexplained_change(tmp_path):
    names = ["time", "total_energy"]
    causes = ("loads", "supports", "obstacles", "damping", "friction")
    names += [f"energy_{cause}" for cause in causes]
    # From rest: gravity gives 3 J and a tool 1 J, a support takes 1 J and friction 0.5 J, 0.1 J
    # are lost.
    rows = [[0.0] * 7, [1.0, 2.4, 3.0, -1.0, 1.0, 0.0, -0.5]]
    text = "\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)])
    (tmp_path / "run.csv").write_text(text)
    time, error = diagrams._unexplained(columns(tmp_path / "run.csv"))
    assert time.tolist() == [0.0, 1.0]
    assert error == pytest.approx([0.0, 0.1 / 2.5])
    assert plotting.energy_error(tmp_path / "run.csv").data


def test_an_unknown_colour_is_refused(comm, folder, refused):
    with refused(ValueError, "'stress' or 'displacement', given 'red'"):
        plotting.snapshot(blocks(comm).stepper, folder / "a.png", colour="red")
    assert not any(folder.iterdir())


def test_a_missing_folder_is_refused_on_all_ranks(comm, folder, refused):
    with refused(FileNotFoundError, "nowhere"):
        plotting.snapshot(blocks(comm).stepper, folder / "nowhere" / "a.png")


@pytest.mark.parametrize(
    ("colour", "cell"), [("gap", "tetrahedron"), once("pressure", "hexahedron")]
)
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
    with refused(IndexError, "one of 1 pairs, from 0, given 7"):
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


def test_states_of_a_movie_agree_with_the_run(comm, folder, agree, recorded):
    times, grids = pictures._states(folder / "run.vtkhdf", "velocity", "v")
    assert agree(np.allclose(times, BLOCK_STEP * np.arange(3)))
    for grid, x in zip(grids, recorded, strict=True):
        assert agree(np.allclose(grid.points, x, rtol=0, atol=1e-14))
        assert agree(np.allclose(grid["v"], np.linalg.norm(grid["velocity"], axis=1)))


@pytest.mark.parametrize(
    "colour", [once("displacement"), once("contact_pressure"), "gap", once("body")]
)
def test_a_run_becomes_a_gif(comm, folder, agree, recorded, colour):
    plotting.animate(folder / "run.vtkhdf", folder / "run.gif", colour=colour, fps=10)
    comm.barrier()
    with Image.open(folder / "run.gif") as movie:
        assert agree(movie.n_frames == 3 and movie.info["duration"] == 100)
        assert agree(num_colours(movie) > 20)


def test_a_field_that_is_not_there_is_refused(comm, folder, recorded):
    if comm.rank == 0:
        with pytest.raises(ValueError, match=r"colour to be one of .*given 'stress'"):
            plotting.animate(folder / "run.vtkhdf", folder / "run.gif", colour="stress")
        assert not (folder / "run.gif").exists()


@pytest.mark.parametrize("place", [once("notebook"), "window", "nowhere"])
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
        # A picture that a notebook shows must not be destroyed.
        assert plotter.return_value.close.called == (place == "window")
    else:
        plotter.assert_not_called()
