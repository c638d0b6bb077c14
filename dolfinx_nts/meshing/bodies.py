"""Cells and facets of the bodies in a gmsh model, checked and in the format of DOLFINx. Local."""

import logging
from typing import NamedTuple

import basix
import numpy as np

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts
from dolfinx_nts.meshing.elements import ENTITIES, KINDS, Block, Elements, names
from dolfinx_nts.meshing.repeated import (
    check_repeated_cells,
    warn_of_double_nodes,
    warn_of_overlapping_cells,
)

__all__ = ["Bodies", "bodies_of", "find_dimension", "with_default_groups"]

_logger = logging.getLogger("dolfinx_nts")

# Names in DOLFINx of gmsh's element types of cells and facets.
_NAMES = {
    **{1: "interval", 2: "triangle", 3: "quadrilateral", 4: "tetrahedron", 5: "hexahedron"},
    **{8: "interval", 9: "triangle", 10: "quadrilateral", 11: "tetrahedron", 12: "hexahedron"},
}
# Element types of the facets of cells.
_FACETS = {2: 1, 3: 1, 4: 2, 5: 3, 9: 8, 10: 8, 11: 9, 12: 10}
_EXPECTED = {3: "hexahedra, tetrahedra or prisms", 2: "triangles or quadrilaterals"}
_PYRAMIDS = {7, 14, 19}  # of first, second and incomplete second order
# det J at a point, relative to the power of the longest tangent of the cell [-], below which the
# cell counts as flat there; and z of nodes in the plane, relative to its extent [-].
_FLAT = 1e-12
# Degree of the quadrature at whose points det J of curved cells is checked [-].
_DEGREE = 4
# Number of cells whose Jacobians are computed at a time [-], about 100 MB.
_CHUNK = 50_000


class Bodies(NamedTuple):
    """Cells and facets in physical groups.

    Attributes:
        cell: Name of the cells in DOLFINx.
        degree: Polynomial degree of their geometry.
        x: Positions of the nodes of cells, shape ``(n, 3)`` [m].
        cells: Rows of x of each cell in the order of DOLFINx, shape ``(c, k)``.
        cell_tags: Physical group of each cell, shape ``(c,)``.
        facets: Rows of x of each tagged facet, shape ``(f, l)``.
        facet_tags: Physical group of each of these facets, shape ``(f,)``.
        tags: Tags of the physical groups by name.
        num_facets: Number of facets of the physical groups in the file or model.
    """

    cell: str
    degree: int
    x: Floats
    cells: GlobalInts
    cell_tags: GlobalInts
    facets: GlobalInts
    facet_tags: GlobalInts
    tags: dict[str, int]
    num_facets: dict[int, int]

    def description(self) -> "Bodies":
        """Copy without nodes, cells and facets, for other ranks."""
        rows = "x", "cells", "cell_tags", "facets", "facet_tags"
        return self._replace(**{name: getattr(self, name)[:0] for name in rows})


def with_default_groups(mesh: Elements) -> Elements:
    """If no cells are in physical groups, put each entity with cells into a group of its own.

    Programs without physical groups write such files.
    """
    dim = next((dim for dim in (3, 2) if mesh.kinds(dim)), 0)
    if not dim or mesh.physical(dim):
        return mesh
    with_cells = {block.entity for block in mesh.blocks if block.dim == dim and len(block.numbers)}
    groups = {(dim, entity): (entity,) for entity in sorted(with_cells)}
    _logger.info(
        "no %s is in a physical group: each is a body, %s",
        ENTITIES[dim],
        ", ".join(mesh.name(dim, entity) for _, entity in groups),
    )
    return mesh._replace(groups={**mesh.groups, **groups})


def find_dimension(mesh: Elements) -> int:
    """Find the dimension of the cells of a model, and check that there are bodies.

    Args:
        mesh: The model.

    Returns:
        3, or 2 for a model without volumes.

    Raises:
        ValueError: There are no bodies, or surfaces that leave the plane z = 0.
    """
    if mesh.physical(3):
        return 3
    if mesh.entities(3) or not mesh.physical(2):
        raise ValueError(
            "expected volumes, or in a model without volumes surfaces in the plane, as bodies, "
            f"given {_without_bodies(mesh)}"
        )
    x = mesh.x
    if np.abs(x[:, 2]).max(initial=0) > _FLAT * np.ptp(x[:, :2], axis=0).max(initial=0):
        low, high = x[:, 2].min(), x[:, 2].max()
        raise ValueError(
            "expected physical volumes, or surfaces in the plane z = 0, given surfaces from "
            f"z = {low:g} up to z = {high:g}: bodies are solid, there are no shells; mesh their "
            "volumes, gmsh.model.mesh.generate(3), and put these into physical groups"
        )
    return 2


def _without_bodies(mesh: Elements) -> str:
    """Content of a model without bodies, and advice how to define bodies in it, as text."""
    for dim in (3, 2):
        if count := len(mesh.entities(dim)):
            return (
                f"{count} {ENTITIES[dim]}{'s' * (count > 1)} without cells: call "
                f"gmsh.model.mesh.generate({dim}) before read_mesh reads the model"
            )
    return (
        "a model without either: call synchronize() of model.occ or model.geo after adding "
        "shapes, and before making physical groups"
    )


def bodies_of(mesh: Elements, dim: int) -> Bodies:
    """Collect the bodies of a model.

    Args:
        mesh: The model, with cells of one kind.
        dim: Dimension of its cells.

    Returns:
        Cells and facets in the order of their physical groups and entities; nodes of no cell are
        left out.

    Raises:
        ValueError: A name has two tags, or cells are of an unsupported kind, in no or several
            groups, or degenerate at a point.
    """
    tags = _tags_by_name(mesh, dim)
    kind = _kind_of_cells(mesh, dim)
    facet = _FACETS[kind]
    num_facets = _check_groups(mesh, dim, {dim: kind, dim - 1: facet})
    numbers, cells, cell_tags = _stacked(mesh.physical(dim), kind)
    _, facets, facet_tags = _stacked(mesh.physical(dim - 1), facet)

    of_cells = np.isin(mesh.numbers, cells)
    own, x = mesh.numbers[of_cells], mesh.x[of_cells]
    # Facets without a cell are omitted: `read_mesh` detects their absence.
    near = np.isin(facets, own).all(axis=1)
    order = np.argsort(own)
    cells, facets = (
        order[np.searchsorted(own, nodes, sorter=order)][
            :, compat.order_of_gmsh(_NAMES[of], KINDS[of].num_nodes)
        ]
        for nodes, of in ((cells, kind), (facets[near], facet))
    )
    facet_tags = facet_tags[near]
    joined = _are_joined(_NAMES[kind], cells, facets)
    for tag, size in zip(*np.unique(facet_tags[joined], return_counts=True), strict=True):
        num_facets[tag] -= size
        _logger.info(
            "physical %s: %d facets are left out, as merged nodes join them with facets of "
            "another group within the mesh",
            *(mesh.name(dim - 1, tag), size),
        )
    degree = KINDS[kind].order
    _check_cells(_NAMES[kind], degree, x[:, :dim], cells, numbers)
    check_repeated_cells(cells, numbers)
    if _NAMES[kind] in ("triangle", "tetrahedron"):
        warn_of_overlapping_cells(x[:, :dim], cells[:, : dim + 1], numbers)
    warn_of_double_nodes(
        *(x, cells, cell_tags),
        {tag: mesh.name(dim, tag) for tag in mesh.physical(dim)},
    )
    groups = facets[~joined], facet_tags[~joined]
    return Bodies(_NAMES[kind], degree, x, cells, cell_tags, *groups, tags, num_facets)


def _are_joined(cell: str, cells: GlobalInts, facets: GlobalInts) -> Flags:
    """Whether facets are given twice and lie between two cells, shape ``(f,)``.

    Such facets belong to two volumes whose common nodes were merged. Cells and facets are given by
    their nodes in the order of DOLFINx, vertices first, shapes ``(c, n)`` and ``(f, m)``.
    """
    sides = basix.topology(getattr(basix.CellType, cell))[-2]
    corners = np.sort(facets[:, : len(sides[0])], axis=1)
    nodes, which, counts = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    several = counts > 1
    if several.any():
        twice = nodes[several]
        near = cells[np.isin(cells, twice).sum(axis=1) >= len(sides[0])]
        of_cells = np.sort(np.concatenate([near[:, side] for side in sides]), axis=1)
        _, same, others = np.unique(
            np.concatenate([twice, of_cells]), axis=0, return_inverse=True, return_counts=True
        )
        several[several] = others[same.ravel()[: len(twice)]] > 2
    joined: Flags = several[which.ravel()]
    return joined


def _tags_by_name(mesh: Elements, dim: int) -> dict[str, int]:
    """Tags of the groups of cells and facets by name."""
    tags: dict[str, int] = {}
    for of in (dim, dim - 1):
        for tag in mesh.physical(of):
            name = mesh.name(of, tag)
            if tags.setdefault(name, tag) != tag:
                raise ValueError(f"expected one tag for {name!r}, given {tags[name]} and {tag}")
        _warn_of_lost_names(mesh, of)
    return tags


def _warn_of_lost_names(mesh: Elements, dim: int) -> None:
    """Warn of groups without a name if other groups have one."""
    groups = mesh.physical(dim)
    lost = [mesh.name(dim, tag) for tag in groups if not mesh.names.get((dim, tag))]
    if lost and len(lost) < len(groups):
        _logger.warning(
            "physical %s: no name, while other groups of the same dimension have one: gmsh drops "
            "a name that another group has; give each group a name of its own, or put both into "
            "one group",
            ", ".join(lost),
        )


def _kind_of_cells(mesh: Elements, dim: int) -> int:
    """Element type of all cells."""
    kinds = list(mesh.kinds(dim))
    if len(kinds) == 1 and kinds[0] in _FACETS:
        return kinds[0]
    hint = ""
    if any(kind not in KINDS or KINDS[kind].order > 1 for kind in kinds):
        hint = (
            "; of second order those without prisms, of one kind and with all their nodes "
            "(Mesh.SecondOrderIncomplete = 0), or call gmsh.model.mesh.setOrder(1)"
        )
        if dim == 2 and len(kinds) > 1:
            hint += (
                "; Mesh.SubdivisionAlgorithm = 1 with Mesh.RecombineAll = 1 leaves no triangles "
                "between quadrilaterals"
            )
    if _PYRAMIDS.intersection(kinds):
        hint = (
            "; pyramids lie between hexahedra and tetrahedra: mesh all volumes with tetrahedra "
            "(without recombined or transfinite ones), or mesh both kinds apart, without "
            "common nodes, and join them by a contact pair with Tied()"
        )
    if not kinds:
        hint = f": call gmsh.model.mesh.generate({dim}) before read_mesh reads the model"
    raise ValueError(f"expected {_EXPECTED[dim]}, given {names(kinds)}{hint}")


def _check_groups(mesh: Elements, cell_dim: int, expected: dict[int, int]) -> dict[int, int]:
    """Check physical groups and element types of entities; return numbers of facets by tag."""
    num_facets: dict[int, int] = {}
    of_entity: dict[tuple[int, int], list[Block]] = {entity: [] for entity in mesh.groups}
    for block in mesh.blocks:
        of_entity[block.dim, block.entity].append(block)
    for (dim, entity), blocks in of_entity.items():
        if dim not in expected:
            continue
        groups = list(mesh.groups[dim, entity])
        where = f"{ENTITIES[dim]} {entity} in physical groups {groups}"
        is_cell = dim == cell_dim
        if (is_cell and blocks and len(groups) != 1) or (not is_cell and len(groups) > 1):
            hint = (
                "put each region into one group only"
                if groups
                else f"make it a body by model.addPhysicalGroup({dim}, [{entity}], name=...), or "
                "remove it if it was only an aid to the construction"
            )
            raise ValueError(f"expected one physical group, given {where}: {hint}")
        given = {block.kind for block in blocks}
        if groups and given != {expected[dim]}:
            what = names(sorted(given))
            raise ValueError(f"{where}: expected {names([expected[dim]])}, given {what}")
        if groups and not is_cell:
            size = sum(len(block.numbers) for block in blocks)
            num_facets[groups[0]] = num_facets.get(groups[0], 0) + size
    return num_facets


def _stacked(
    groups: dict[int, list[Block]], kind: int
) -> tuple[GlobalInts, GlobalInts, GlobalInts]:
    """Concatenated numbers, nodes and tags of the elements of groups."""
    blocks = [(tag, block) for tag, of in groups.items() for block in of]
    none = np.empty((0, KINDS[kind].num_nodes), dtype=np.int64)
    numbers = np.concatenate([none[:, 0], *(block.numbers for _, block in blocks)])
    nodes = np.concatenate([none, *(block.nodes for _, block in blocks)])
    tags = np.repeat([tag for tag, _ in blocks], [len(block.numbers) for _, block in blocks])
    return numbers, nodes, tags.astype(np.int64)


def _check_cells(cell: str, degree: int, x: Floats, cells: GlobalInts, numbers: GlobalInts) -> None:
    """Raise if det J of a cell vanishes or changes its sign."""
    shape, dim = basix.CellType[cell], x.shape[1]
    element = basix.create_element(
        basix.ElementFamily.P, shape, degree, basix.LagrangeVariant.equispaced
    )
    # If two edges of a curved cell are on a smooth surface, the cell is flat at their common node.
    points = basix.make_quadrature(shape, _DEGREE)[0] if degree > 1 else basix.geometry(shape)
    values = element.tabulate(1, points)[..., 0]  # (1 + dim, points, nodes)
    bad: list[int] = []
    midpoint = np.zeros(3)
    for begin in range(0, len(cells), _CHUNK):
        own = x[cells[begin : begin + _CHUNK]]
        tangents = np.einsum("apk,ckd->cpad", values[1:], own)
        det = np.linalg.det(tangents)
        longest = np.linalg.norm(tangents, axis=3).max(axis=(1, 2))
        good = det * np.sign(det[:, :1]) > _FLAT * longest[:, None] ** dim
        found = np.flatnonzero(~good.all(axis=1))
        if len(found) and not bad:
            midpoint[:dim] = (values[0] @ own[found[0]]).mean(axis=0)
        bad += [begin + int(cell) for cell in found]
    if bad:
        raise ValueError(
            f"expected det J of one sign in a cell, given {len(bad)} inverted or "
            f"degenerate cells, first gmsh element {numbers[bad[0]]} at "
            f"{midpoint.round(6).tolist()}"
        )
