"""XML file to which elements are appended, valid at any time.

The closing tags cannot be moved atomically, so they stay where they are, and elements are written
to padding in front of them. The padding is a processing instruction, ``<?pad ... ?>`` full of
spaces, which readers of XML skip:

1. The new element is written into it, followed by the ``<?pad`` of a new instruction. All of
   this still belongs to the old instruction.
2. The ``<`` of the old instruction becomes a space. Writing this single byte is atomic: it makes
   the element valid and begins the new instruction.
3. The rest of the old instruction is overwritten by spaces.

When the padding is full, the file is replaced by a file whose padding is as long as its content.
The mean time per element therefore does not grow with their number.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import IO

from dolfinx_nts.io.atomic_file import replace

__all__ = ["XmlSeries"]

# XML requires the space.
_START, _END = b"<?pad ", b"?>\n"
# Overwrites the start of the padding instruction, as indentation of a new element.
_INDENT = b" " * len(_START)
# Padding of a new file [bytes], enough for the first 30 states of a run with contact.
_FIRST_ROOM = 2**16


class XmlSeries:
    """XML file that grows by elements. Local, as all its methods.

    The file is opened for each change only, so nothing has to be closed after an error.

    Args:
        path: The file.
        head: Text in front of the elements.
        tail: Text behind them.
    """

    def __init__(self, path: Path, head: str, tail: str) -> None:
        self._path, self._head, self._tail = path, head.encode(), tail.encode()
        self._end = 0  # end of the elements in the file [bytes]
        self._room = 0  # length of the padding behind them [bytes]

    def start(self, elements: Iterable[str]) -> None:
        """Replace the file by one with the given elements.

        Args:
            elements: Texts of the first elements, perhaps none.

        Raises:
            OSError: The file cannot be written.
        """
        self._replace(b"".join(_INDENT + text.encode() for text in elements), _FIRST_ROOM)

    def append(self, element: str) -> None:
        """Add an element.

        Args:
            element: Its text, in which there is no ``?>``.

        Raises:
            OSError: The file cannot be written. It is valid nevertheless.
        """
        text, start = element.encode(), self._end
        length = len(text) + len(_START)
        if length > self._room:
            elements = self._elements() + _INDENT + text
            self._replace(elements, max(_FIRST_ROOM, len(elements)))
            return
        with open(self._path, "r+b") as file:
            _put(file, start + len(_START), text + _START)
            _put(file, start, _INDENT[:1])
            self._end, self._room = start + length, self._room - length
            _put(file, start + 1, _INDENT[1:])

    def close(self) -> None:
        """Remove the padding, after the last element.

        Raises:
            OSError: The file cannot be written. It is as it was.
        """
        self._replace(self._elements(), 0)

    def _elements(self) -> bytes:
        return self._path.read_bytes()[len(self._head) : self._end]

    def _replace(self, elements: bytes, room: int) -> None:
        before = self._head + elements
        instruction = _START + b" " * room + _END if room else b""
        replace(self._path, before + instruction + self._tail)
        self._end, self._room = len(before), room


def _put(file: IO[bytes], place: int, data: bytes) -> None:
    file.seek(place)
    file.write(data)
    file.flush()
