"""Bodies, which are regions of the mesh with a material, and forms over their cells.

Bodies of one material share their forms. Inertia and strain energy have separate quadrature rules,
see `Element`. Terms of the energy that cause locking have a single quadrature point per cell and
use the mean gradient of the cell, see `volumetric_split`.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_nts.common.arguments import as_call, instances, kind_of, label
from dolfinx_nts.common.arrays import Ints
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.common.named_tag import NamedTag
from dolfinx_nts.fem.axisymmetry import is_axisymmetric, over_circumference
from dolfinx_nts.fem.elements import Element, check_space, check_tag
from dolfinx_nts.fem.few_nodes import nodes_on_any_rank
from dolfinx_nts.fem.mean_gradient import with_mean_gradients
from dolfinx_nts.materials.hyperelastic import Hyperelastic, hexahedra_lock
from dolfinx_nts.materials.mass_only import MassOnly
from dolfinx_nts.materials.strain_energy import are_pressures, poisson_ratios
from dolfinx_nts.materials.volumetric_split import parts
from dolfinx_nts.model.cell_moduli import CellModuli
from dolfinx_nts.parallel import reductions

__all__ = ["Body", "body_of_nodes", "bulk_form", "check_bodies", "common_space"]


class Body(Declaration):
    """A body: all cells with one tag, made of one material. Collective.

    Args:
        V: Vector space of the displacement, ``("Lagrange", 1, (3,))`` or of degree 2; in the plane
            of shape ``(2,)``.
        cells: Cell tags of the mesh.
        tag: Value of the tag.
        material: Strain energy and density.
        name: Name in messages, columns and legends; empty for the name of the region, or
            ``body`` with the tag.

    Attributes:
        V: The space.
        is_rigid: Whether the body does not deform, see `RigidBody`.
        name: The argument, or the automatic name.
        material: The material.
        cells: Cells of the body that this rank owns, local indices, shape ``(c,)``.
        nodes: Nodes of the body, owned and ghost, local block indices of V, sorted, shape ``(n,)``.

    Raises:
        TypeError: ``V`` is not a function space, ``cells`` not MeshTags, ``tag`` not an integer, or
            ``material`` not a Hyperelastic.
        ValueError: The space or the tag does not fit; the degree is 2 and the material has
            ``one_point`` terms or is `J2Plasticity`; or the material is `PlaneStress` and the mesh
            is not plane.

    Example:
        >>> body = nts.Body(V, cells, tag["lower"], rubber)
        >>> len(body.cells), len(body.nodes)
        (4, 18)
    """

    is_rigid: ClassVar[bool] = False

    def __init__(
        self,
        V: fem.FunctionSpace,
        cells: MeshTags,
        tag: int,
        material: Hyperelastic,
        *,
        name: str = "",
    ) -> None:
        check_space(V)
        tdim = V.mesh.topology.dim
        check_tag(V, cells, tag, tdim, "cells")
        if not isinstance(material, Hyperelastic):
            raise TypeError(
                f"expected a material, such as NeoHookean(E, nu, rho), given {kind_of(material)}"
            )
        named = material.one_point and not material.splits_volume
        if named and V.ufl_element().degree > 1:
            raise ValueError(
                "expected a material without one_point, which is for degree 1, in a space of "
                f"degree {V.ufl_element().degree}"
            )
        if material.remembered_terms and V.ufl_element().degree > 1:
            raise ValueError(
                f"expected, for {type(material).__name__}, a space of degree 1, given one of "
                f"degree {V.ufl_element().degree}: hexahedra of degree 1 do not lock in "
                "plastic flow"
            )
        if material.is_sheet and (V.mesh.geometry.dim != 2 or is_axisymmetric(V.mesh)):
            raise ValueError(
                "expected a mesh of the plane, not axisymmetric, with PlaneStress, given "
                f"{'an axisymmetric one' if is_axisymmetric(V.mesh) else 'one in space'}"
            )
        self.V, self.material, self._tag = V, material, tag
        self.name = label(name) or NamedTag.name_of(tag, "body")
        local = cells.find(tag)
        self.cells: Ints = local[local < V.mesh.topology.index_map(tdim).size_local]
        # This rank may own a node of the body without having one of its cells.
        self.nodes: Ints = nodes_on_any_rank(V, V.dofmap.list[local])

    @cached_property
    def splits_volume(self) -> bool:
        """Whether volumetric terms have one point per cell. Collective at the first use."""
        if not Element.of(self.V).locks:
            return False
        return self.material.splits_volume or (self.material.has_default_rule and self._locks())

    def _locks(self) -> bool:
        """Whether a material that varies in space locks, and has separate volumetric terms."""
        if not (self.material.has_fields and np.isnan(self.material.poisson_ratio)):
            return False
        locks, are_mixed = False, False
        for _, moduli in CellModuli(self.V, self.material).blocks(self.cells):
            locks |= bool(hexahedra_lock(poisson_ratios(moduli)).any())
            are_mixed |= not are_pressures(moduli).all()
        comm = self.V.mesh.comm
        # Both reductions, as they are collective.
        locks, are_mixed = reductions.anywhere(comm, locks), reductions.anywhere(comm, are_mixed)
        return locks and not are_mixed

    def __repr__(self) -> str:
        """Tag, name, material, and number of cells on this rank. Local."""
        given = {"tag": int(self._tag), "name": self.name, "material": self.material}
        return as_call(self, **given, owned_cells=len(self.cells))


def bulk_form(
    bodies: Sequence[Body],
    integrand: Callable[[Hyperelastic, dict[str, Any], Any], Any],
    remembered: Callable[[Hyperelastic, dict[str, Any]], Any] | None = None,
) -> ufl.Form:
    """Integrate over all bodies, with one integral per material and quadrature. Collective.

    The integrand is a sum of terms with the stress, the energy or the density. It is evaluated once
    for each quadrature rule of a material, with zero parameters or density in the terms of the
    other rules.

    Args:
        bodies: Bodies of one space.
        integrand: Function ``integrand(material, parameters, rho)`` that returns UFL per
            reference volume; parameters by name and density are UFL constants or 0.
        remembered: Function ``remembered(material, parameters)`` that returns the terms of
            materials with internal variables, integrated with all quadrature points of the
            stress.

    Returns:
        The form.
    """
    mesh, element = bodies[0].V.mesh, Element.of(bodies[0].V)
    mass, full = element.mass_degree, element.stress_degree
    terms: list[tuple[Any, Ints, int]] = []
    for material, splits in dict.fromkeys((body.material, body.splits_volume) for body in bodies):
        same = [b for b in bodies if b.material is material and b.splits_volume == splits]
        cells = np.concatenate([body.cells for body in same])
        parameters = {
            name: fem.Constant(mesh, value) for name, value in material.parameters.items()
        }
        density = fem.Constant(mesh, material.rho)
        # Quadrature degree, material, names of parameters set to zero, and density.
        most, volumetric = parts(material, splits)
        rules: list[tuple[int, Hyperelastic, Iterable[str], Any]] = [
            (full, *most, density if mass == full else 0.0)
        ]
        if volumetric is not None:
            rules.append((1, *volumetric, 0.0))
        if mass != full:
            rules.append((mass, MassOnly(material.rho, material.mass_damping), (), density))
        for number, (degree, law, without, rho) in enumerate(rules):
            some = parameters | dict.fromkeys(without, 0.0)
            value = ufl.as_ufl(integrand(law, some, rho))
            if number == 0 and remembered is not None and material.remembers:
                value += remembered(material, parameters)
            if value != 0:
                if degree == 1:
                    value = with_mean_gradients(value, bodies[0].V)
                terms.append((over_circumference(value, mesh), np.sort(cells), degree))
    if not terms:  # zero, such as the strain energy of rigid bodies
        terms.append((fem.Constant(mesh, 0.0), np.empty(0, dtype=np.int32), 0))
    # Each term has its own subdomain, even for the same cells: FFCx 0.9 computes functionals with
    # two quadratures in one subdomain wrongly.
    dx = ufl.Measure(
        "dx", domain=mesh, subdomain_data=[(i, cells) for i, (_, cells, _) in enumerate(terms)]
    )
    form = ufl.Form([])
    for i, (value, _, degree) in enumerate(terms):
        form += value * dx(i, metadata={"quadrature_degree": degree})
    return form


def body_of_nodes(bodies: Sequence[Body]) -> Ints:
    """Number of the first body of each local node of the space, or -1, ``(l,)``. Local."""
    index_map = bodies[0].V.dofmap.index_map
    number = np.full(index_map.size_local + index_map.num_ghosts, -1, dtype=np.int32)
    for i in reversed(range(len(bodies))):
        number[bodies[i].nodes] = i
    return number


def common_space(bodies: Sequence[Body]) -> fem.FunctionSpace:
    """Common function space of bodies. Local.

    Args:
        bodies: Some bodies.

    Returns:
        Their space.

    Raises:
        TypeError: Something in the list is not a body.
        ValueError: There are no bodies, or they have several spaces.
    """
    bodies = instances(Body, bodies)
    if not bodies:
        raise ValueError("expected at least one body, given none")
    if any(body.V != bodies[0].V for body in bodies):
        raise ValueError(
            "expected bodies in one function space, given several: make one V on a mesh that has "
            "all bodies, and pass it to each Body"
        )
    return bodies[0].V


def check_bodies(bodies: Sequence[Body]) -> fem.FunctionSpace:
    """Check that every cell of the mesh is in exactly one body. Collective.

    Args:
        bodies: All bodies of the mesh.

    Returns:
        The space of the bodies.

    Raises:
        TypeError: Something in the list is not a body.
        ValueError: There are no bodies, they have several spaces, or a cell is in none or in
            several of them.
    """
    V = common_space(bodies)
    mesh = V.mesh
    count = np.zeros(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    for body in bodies:
        count[body.cells] += 1
    free, shared = reductions.total(mesh.comm, [np.sum(count == 0), np.sum(count > 1)])
    if free or shared:
        raise ValueError(
            "expected every cell in exactly one body, "
            f"given {free} cells in none and {shared} in several: make one Body or "
            "RigidBody for each tag of cells"
        )
    return V


def check_member(body: Any, bodies: Sequence[Body]) -> None:
    """Check that an argument is one of the bodies of a stepper. Local.

    Raises:
        TypeError: It is not a body.
        ValueError: It is a body of another stepper.
    """
    names = ", ".join(each.name for each in bodies)
    if not isinstance(body, Body):
        raise TypeError(
            f"expected one of the bodies given to the stepper ({names}), the Body itself and "
            f"not its name or number, given {body!r}"
        )
    if body not in bodies:
        raise ValueError(
            f"expected a body of this stepper ({names}), given {body.name} of another stepper"
        )
