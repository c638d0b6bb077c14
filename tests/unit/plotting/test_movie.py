"""Movies: data sent to the file and the encoder."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_nts.plotting.movie import Movie

pytestmark = pytest.mark.serial

Image = pytest.importorskip("PIL.Image")

FRAMES = np.array([0, 90, 200], dtype=np.uint8)[:, None, None, None] * np.ones(
    (3, 32, 48, 3), dtype=np.uint8
)


def test_a_gif_has_the_frames_and_repeats(tmp_path):
    with Movie(tmp_path / "a.gif", fps=4) as movie:
        for frame in FRAMES:
            movie.write(frame)
    with Image.open(tmp_path / "a.gif") as image:
        assert (image.n_frames, image.info["duration"], image.info["loop"]) == (3, 250, 0)
        for number, frame in enumerate(FRAMES):
            image.seek(number)
            assert np.array_equal(np.asarray(image.convert("RGB")), frame)


def test_an_mp4_goes_to_its_encoder(tmp_path, monkeypatch):
    calls, received = [], []

    def write_frames(path, size, **options):
        calls.append((path, size, options["fps"]))
        try:
            while True:
                received.append((yield))
        finally:
            calls.append("closed")

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", SimpleNamespace(write_frames=write_frames))
    with Movie(tmp_path / "a.mp4", fps=4) as movie:
        for frame in FRAMES:
            movie.write(frame)
    assert calls == [(str(tmp_path / "a.mp4"), (48, 32), 4), "closed"]
    assert np.array_equal(received, FRAMES)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of its reader
def test_an_mp4_is_read_back(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    with Movie(tmp_path / "a.mp4", fps=4) as movie:
        for frame in FRAMES:
            movie.write(frame)
    reader = ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    meta = next(reader)
    frames = [np.frombuffer(frame, dtype=np.uint8) for frame in reader]
    assert (meta["size"], meta["fps"]) == ((48, 32), 4)
    assert np.allclose([frame.mean() for frame in frames], [0, 90, 200], atol=3)


def test_a_missing_encoder_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ModuleNotFoundError, match="pip install imageio-ffmpeg"):
        Movie(tmp_path / "a.mp4", fps=4)


def test_wrong_use_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"expected a file .gif or .mp4, given .*a.avi"):
        Movie(tmp_path / "a.avi", fps=4)
    with pytest.raises(ValueError, match="fps > 0, given 0"):
        Movie(tmp_path / "a.gif", fps=0)


def test_nothing_is_written_after_an_error(tmp_path):
    with pytest.raises(ZeroDivisionError), Movie(tmp_path / "a.gif", fps=4) as movie:
        movie.write(FRAMES[0])
        raise ZeroDivisionError
    assert not any(tmp_path.iterdir())
