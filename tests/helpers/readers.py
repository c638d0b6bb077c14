"""Field files, read by VTK and h5py without this package."""

import h5py
import numpy as np
import pytest


def read_grids(path):
    """Times and grids by VTK's readers of VTKHDF and XDMF, which ParaView has too."""
    pyvista = pytest.importorskip("pyvista")
    if path.suffix == ".vtkhdf":
        return read_vtkhdf(path)
    reader = pyvista.get_reader(path)
    grids = []
    for t in reader.time_values:
        reader.set_active_time_value(t)
        grids.append(reader.read().copy())
    return np.array(reader.time_values), grids


def read_vtkhdf(path):
    """Times and grids of a VTKHDF file."""
    pyvista = pytest.importorskip("pyvista")
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    grids = []
    if times is None:  # VTK takes a single state for one without a time
        with h5py.File(path, "r") as file:
            times = file["VTKHDF/Steps/Values"][:]
    for t in times:
        reader.UpdateTimeStep(t)
        grids.append(pyvista.wrap(reader.GetOutputDataObject(0)).copy())
    return np.array(times), grids


def read_fields(folder):
    """Every array in the HDF5 files of a folder, by file and name."""
    arrays = {}
    for path in folder.glob("*.h5"):
        with h5py.File(path, "r") as file:
            arrays |= {(path.name, name): values[()] for name, values in file.items()}
    return arrays
