r"""Axisymmetric meshes: plane meshes of the half section of bodies of revolution.

x is the radius r, y is the axis. Without twist the deformation gradient consists of its part in the
plane and the hoop stretch 1 + u_x/r. Integrals over the full circumference have the weight
:math:`2\pi r`. Nodes on the axis keep u_x = 0.
"""

import logging
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.domain import extract_unique_domain

from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.collective_calls import meet

__all__ = [
    "axis_nodes",
    "axisymmetric",
    "hoop_gradient",
    "is_axisymmetric",
    "is_on_axis",
    "over_circumference",
]

_logger = logging.getLogger("dolfinx_nts")

# Distance from the axis, relative to the largest radius [-], that counts as zero.
_ON_AXIS = 1e-10

# Distance from the axis that counts as zero [m], or None for a plane mesh. The key is the id of the
# UFL domain, since hashing the domain itself is slow.
_KNOWN: dict[int, float | None] = {}


def axisymmetric(mesh: Mesh) -> None:
    """Declare that a mesh of the plane is the half section of bodies of revolution. Collective.

    x is the radius, y the axis; there is no rotation about it. All objects created on the mesh
    afterwards refer to the full circumference: masses, energies and forces of bodies, areas of
    surfaces, loads and obstacles. Nodes on the axis stay on it without a condition in ``bcs``.
    Facets on the axis do not belong to surfaces.

    Args:
        mesh: Mesh of triangles or quadrilaterals, with coordinates x >= 0.

    Raises:
        TypeError: ``mesh`` is not a DOLFINx mesh.
        ValueError: The mesh is not in the plane, reaches beyond the axis, or was used for bodies,
            surfaces or spaces of the package before.

    Example:
        >>> from dolfinx.mesh import create_rectangle
        >>> mesh = create_rectangle(MPI.COMM_WORLD, [(0, 0), (0.5, 1)], [2, 4])  # m
        >>> nts.axisymmetric(mesh)
        >>> V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        >>> side = nts.Surface.where(V, lambda x: np.isclose(x[0], 0.5))
        >>> round(float(side.area.sum()), 6)  # 2 pi 0.5 m x 1 m
        3.141593
    """
    if not isinstance(mesh, Mesh):
        raise TypeError(f"expected a mesh, given {kind_of(mesh)}")
    meet(mesh.comm, "make a mesh axisymmetric")
    if mesh.geometry.dim != 2 or mesh.topology.dim != 2:
        raise ValueError(
            "expected a mesh of the plane, with x as the radius and y as the axis, given one of "
            f"dimension {mesh.topology.dim} in {mesh.geometry.dim} dimensions"
        )
    r = mesh.geometry.x[:, 0]
    largest = reductions.largest(mesh.comm, float(np.abs(r).max(initial=0.0)))
    least = reductions.least(mesh.comm, float(r.min(initial=np.inf)))
    if not least >= -_ON_AXIS * largest:
        raise ValueError(
            f"expected radii x >= 0 in an axisymmetric mesh, given one of {least:g} m: the mesh is "
            "the half section of bodies of revolution, on one side of the axis x = 0"
        )
    if _KNOWN.setdefault(mesh.ufl_domain().ufl_id(), _ON_AXIS * largest) is None:
        raise ValueError(
            "expected axisymmetric(mesh) before bodies, surfaces and other objects are created on "
            "the mesh, given a mesh with such objects"
        )
    if mesh.comm.rank == 0:
        _logger.info(
            "axisymmetric: x is the radius, y the axis, on which nodes stay; forces, masses and "
            "energies refer to the full circumference"
        )


def is_axisymmetric(mesh: Mesh | ufl.Mesh) -> bool:
    """Whether a mesh is axisymmetric, which cannot change after this call. Local."""
    return _tolerance(mesh) is not None


def is_on_axis(mesh: Mesh, x: Floats) -> Flags:
    """Whether positions, ``(..., 3)`` [m], are on the axis of an axisymmetric mesh. Local."""
    tolerance = _tolerance(mesh)
    flags: Flags = np.zeros(x.shape[:-1], dtype=bool)
    return flags if tolerance is None else np.abs(x[..., 0]) <= tolerance


def axis_nodes(V: fem.FunctionSpace) -> Ints:
    """Local nodes of a space on the axis, owned and ghost. Local."""
    if not is_axisymmetric(V.mesh):
        return np.empty(0, dtype=np.int32)
    on_axis = is_on_axis(V.mesh, V.tabulate_dof_coordinates())
    return indices(on_axis)


def over_circumference(value: Any, mesh: Mesh) -> Any:
    """Density, UFL, times 2 pi r if the mesh is axisymmetric. Local."""
    if not is_axisymmetric(mesh):
        return value
    return 2 * np.pi * ufl.SpatialCoordinate(mesh)[0] * value


def hoop_gradient(v: Any, *, on_axis: bool = False) -> Any:
    """Hoop component v_x/r of the gradient of a vector field, UFL; 0 in a plane mesh.

    Args:
        v: Vector field of the plane, UFL (2,).
        on_axis: Whether the component is also evaluated on the axis, where it is the limit of the
            quotient.
    """
    domain = extract_unique_domain(v)
    if not is_axisymmetric(domain):
        return 0
    r = ufl.SpatialCoordinate(domain)[0]
    if not on_axis:
        return v[0] / r
    return ufl.conditional(ufl.gt(r, _tolerance(domain)), v[0] / r, ufl.grad(v)[0, 0])


def _tolerance(mesh: Mesh | ufl.Mesh) -> float | None:
    domain = mesh if isinstance(mesh, ufl.Mesh) else mesh.ufl_domain()
    return _KNOWN.setdefault(domain.ufl_id(), None)
