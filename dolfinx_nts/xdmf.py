"""XDMF file with the fields of a stepper, one time series for ParaView."""

import copy
from pathlib import Path
from xml.etree import ElementTree as ET

from mpi4py import MPI

import numpy as np
from dolfinx import fem, io

from dolfinx_nts.stepper import Stepper

__all__ = ["FieldFile"]


class FieldFile:
    """Displacement, velocity, contact fields and number of the body.

    At the contact nodes: gap [m], contact pressure [Pa], active, and with
    friction slip state (0 open, 1 stick, 2 slip), accumulated slip [m] and
    traction [Pa]; least, summed or largest if a node belongs to several
    pairs. The gap is NaN at other nodes and where a node faces no segment,
    the others are 0 there.

    Collective, as all its methods.

    Args:
        path: The file, ``.xdmf``; a file ``.h5`` comes with it.
        stepper: Midpoint, EnergyMomentum or QuasiStatic.
    """

    def __init__(self, path: Path, stepper: Stepper) -> None:
        """Open the files and write the mesh."""
        self._path, self._stepper = path, stepper
        V = stepper.u.function_space
        mesh = V.mesh
        self._comm: MPI.Comm = mesh.comm
        Q, dofs = V.sub(0).collapse()
        self._nodes = np.asarray(dofs) // 3
        names = ["gap", "contact_pressure", "active"] if stepper.pairs else []
        self._rubs = any(pair.friction is not None for pair in stepper.pairs)
        if self._rubs:
            names += ["slip_state", "accumulated_slip"]
        self._contact = [fem.Function(Q, name=name) for name in names]
        self._traction = fem.Function(V, name="friction_traction")
        self._body = fem.Function(fem.functionspace(mesh, ("DG", 0)), name="body")
        for number, body in enumerate(stepper.bodies):
            self._body.x.array[body.cells] = number
        self._written = -np.inf
        self._file = io.XDMFFile(mesh.comm, str(path), "w")
        self._file.write_mesh(mesh)
        self._file.write_function(self._body)

    def write(self) -> None:
        """Write the present state, unless its time has been written."""
        stepper, t = self._stepper, self._stepper.t
        if t == self._written:
            return
        values = np.zeros((5, len(stepper.x)))
        values[0] = np.nan
        traction = self._traction.x.array.reshape(-1, 3)
        traction[:] = 0
        for pair in stepper.pairs:
            at = pair.nodes.nodes
            values[0, at] = np.fmin(values[0, at], pair.gap(stepper.x))
            values[1, at] += pair.pressure
            history = pair.history
            values[2, at] = np.maximum(values[2, at], history.active)
            if pair.friction is not None:
                state = history.active + 1.0 * history.sliding
                values[3, at] = np.maximum(values[3, at], state)
                values[4, at] += history.slip
                traction[at] -= history.traction / pair.nodes.area[:, None]
        for function, value in zip(self._contact, values, strict=False):
            function.x.array[:] = value[self._nodes]
        vectors = [stepper.u, stepper.v, *([self._traction] if self._rubs else [])]
        for function in (*vectors, *self._contact):
            self._file.write_function(function, t)
        self._written = t

    def close(self) -> None:
        """Close the files and bring them into the form that readers want."""
        self._file.close()
        if self._comm.rank == 0:
            tree = ET.parse(self._path)
            _merge(tree.getroot()[0])
            ET.indent(tree)
            tree.write(self._path, encoding="utf-8", xml_declaration=True)
        self._comm.barrier()


def _merge(domain: ET.Element) -> None:
    """Turn DOLFINx's series, one a function, into one of whole grids.

    ParaView shows separate series as unrelated blocks, and VTK's Xdmf2
    reader crashes on their references to the mesh (pyvista issue 6303).
    """
    mesh, (body,), *series = domain
    for grids in zip(*series, strict=True):
        state = grids[0]
        fields = [field for grid in (*grids, body) for field in grid.iter("Attribute")]
        state[:] = copy.deepcopy([*mesh, *state.iter("Time"), *fields])
        state.set("Name", "state")
        for item in state.iter("DataItem"):
            if "NumberType" not in item.attrib:  # float32 by default
                item.attrib.update(NumberType="Float", Precision="8")
    domain[:] = series[:1]
    domain[0].set("Name", "states")
