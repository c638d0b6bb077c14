"""Files of fields, read by a program that knows nothing of this package."""

import h5py
import numpy as np
import pytest


def read_grids(path):
    """Times and grids by VTK's XDMF reader, which ParaView has too."""
    pyvista = pytest.importorskip("pyvista")
    reader = pyvista.get_reader(path)
    grids = []
    for t in reader.time_values:
        reader.set_active_time_value(t)
        grids.append(reader.read().copy())
    return np.array(reader.time_values), grids


def read_fields(folder):
    """Every array in the HDF5 files of a folder, by file and name."""
    arrays = {}
    for path in folder.glob("*.h5"):
        with h5py.File(path, "r") as file:
            arrays |= {(path.name, name): values[()] for name, values in file.items()}
    return arrays
