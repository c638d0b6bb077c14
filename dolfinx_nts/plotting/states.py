"""States of a run, read from the file of fields that a `Recorder` has written."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

__all__ = ["states"]


def states(fields: str | Path) -> Iterator[tuple[float, Any]]:
    """Read time [s] and grid of PyVista of each state, undeformed. Local.

    Args:
        fields: File ``.vtkhdf`` or ``.xdmf``.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It has another suffix.
    """
    path = Path(fields)
    if path.suffix not in (".vtkhdf", ".xdmf"):
        raise ValueError(f"expected the .vtkhdf or .xdmf file of a Recorder, given {path}")
    if not path.exists():
        raise FileNotFoundError(f"expected a file of fields, given {path}, which does not exist")
    return _of_vtkhdf(path) if path.suffix == ".vtkhdf" else _of_xdmf(path)


def _of_xdmf(fields: str | Path) -> Iterator[tuple[float, Any]]:
    import pyvista

    reader = pyvista.get_reader(fields)
    for t in reader.time_values:
        reader.set_active_time_value(t)
        # The reader writes the points of every state into the same memory.
        yield t, reader.read().copy()


def _of_vtkhdf(fields: Path) -> Iterator[tuple[float, Any]]:
    import pyvista
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(fields))
    reader.UpdateInformation()
    for number in range(reader.GetNumberOfSteps()):
        reader.SetStep(number)
        reader.Update()
        yield reader.GetTimeValue(), pyvista.wrap(reader.GetOutputDataObject(0)).copy()
