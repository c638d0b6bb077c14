"""Pictures and movies that a notebook displays."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Picture"]


class Picture:
    """A picture or a movie in memory, which a notebook displays.

    Drawing functions return it: as the last expression of a notebook cell it appears below the
    cell; scripts may ignore it.

    Args:
        data: Content of the file; empty on ranks that did not draw.
        kind: Media type of the file, ``"image/png"``, ``"image/gif"`` or ``"video/mp4"``.

    Attributes:
        data, kind: The arguments.

    Example:
        >>> picture = plotting.energies("run.csv")
        >>> picture.save("energies.png")
    """

    def __init__(self, data: bytes, kind: str = "image/png") -> None:
        self.data, self.kind = data, kind

    @classmethod
    def of_pixels(cls, pixels: npt.NDArray[np.uint8]) -> "Picture":
        """Create a PNG picture from RGB pixels. Local.

        Args:
            pixels: Rows of pixels from the top, shape ``(h, w, 3)``.

        Returns:
            The picture.
        """
        from PIL import Image

        buffer = BytesIO()
        Image.fromarray(pixels).save(buffer, "PNG")
        return cls(buffer.getvalue())

    @classmethod
    def of_figure(cls, figure: Any) -> "Picture":
        """Create a PNG picture from a Matplotlib figure. Local.

        Args:
            figure: The figure.

        Returns:
            The picture.
        """
        buffer = BytesIO()
        figure.savefig(buffer, format="png")
        return cls(buffer.getvalue())

    def __repr__(self) -> str:
        return f"Picture({self.kind}, {len(self.data)} bytes)"

    def save(self, filename: str | Path) -> None:
        """Write the content to a file, unless there is none. Local.

        Args:
            filename: File to write.
        """
        if self.data:
            Path(filename).write_bytes(self.data)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        """Content for a notebook; a player for a movie in MP4."""
        from base64 import b64encode

        if not self.data:
            return {}
        text = b64encode(self.data).decode()
        if self.kind == "video/mp4":
            source = f"data:{self.kind};base64,{text}"
            return {"text/html": f'<video controls loop src="{source}"></video>'}
        return {self.kind: text}
