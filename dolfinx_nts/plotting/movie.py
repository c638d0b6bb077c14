"""Movies, written frame by frame as a GIF, or as an MP4 if its encoder is installed.

Pillow and imageio-ffmpeg are imported when they are needed. Everything is local: one rank
writes.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Movie"]

Frame = npt.NDArray[np.uint8]


class Movie:
    """A movie to which frames are added in a ``with`` block.

    Args:
        filename: File to write, ``.gif`` or ``.mp4``.
        fps: Frames per second [1/s].

    Attributes:
        write: Function that adds a frame, RGB of shape ``(h, w, 3)``.

    Raises:
        ModuleNotFoundError: The encoder of MP4 is not installed.
        ValueError: The suffix is unknown, or ``fps`` is not positive.
    """

    def __init__(self, filename: str | Path, fps: float) -> None:
        self._path, self._fps = Path(filename), fps
        kinds: dict[str, Callable[[Frame], None]] = {".gif": self._quantise, ".mp4": self._encode}
        if self._path.suffix not in kinds:
            raise ValueError(f"expected a file .gif or .mp4, given {filename}")
        if not fps > 0:
            raise ValueError(f"expected fps > 0, given {fps}")
        self.write = kinds[self._path.suffix]
        self._images: list[Any] = []
        self._encoder: Any = None
        if self._path.suffix == ".mp4":
            try:
                import imageio_ffmpeg
            except ModuleNotFoundError as error:
                raise ModuleNotFoundError(
                    "an MP4 needs the package imageio-ffmpeg (pip install imageio-ffmpeg); "
                    "a GIF needs nothing more"
                ) from error
            self._ffmpeg = imageio_ffmpeg

    def __enter__(self) -> "Movie":
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Complete the file; after an error no GIF is written."""
        if self._encoder is not None:
            self._encoder.close()
        if self._images and error is None:
            first, *others = self._images
            duration = 1000 / self._fps
            first.save(self._path, save_all=True, append_images=others, duration=duration, loop=0)

    def _quantise(self, frame: Frame) -> None:
        """Store a frame for the GIF."""
        from PIL import Image

        self._images.append(Image.fromarray(frame).quantize())

    def _encode(self, frame: Frame) -> None:
        """Send a frame to the encoder of the MP4."""
        if self._encoder is None:
            height, width = frame.shape[:2]
            self._encoder = self._ffmpeg.write_frames(
                str(self._path), (width, height), fps=self._fps, macro_block_size=2
            )
            self._encoder.send(None)
        self._encoder.send(np.ascontiguousarray(frame))
