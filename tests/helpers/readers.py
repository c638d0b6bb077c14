"""Files of fields, read by a program that knows nothing of this package."""

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
