"""Methods of contact and their supported combinations."""

from typing import Any, Literal

from dolfinx_nts.contact.enforcement import Tied
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rigid_cone import RigidCone
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.model.surfaces import Surface

__all__ = [
    *("EDGES", "KINDS", "MORTAR", "NODES", "Method"),
    *("check_dimension", "check_method", "check_smooth", "check_tie", "default_method"),
    *("has_patches", "may_be_smooth"),
]

Method = Literal["node-to-segment", "mortar", "edge-to-edge"]
NODES: Method = "node-to-segment"
MORTAR: Method = "mortar"
EDGES: Method = "edge-to-edge"

# Name of each method in messages.
KINDS = {
    NODES: "contact",
    MORTAR: "surface-to-surface contact",
    EDGES: "edge-to-edge contact",
}
# Supported laws of impact of edges; "" for springs.
_OF_EDGES = ("", "elastic", "plastic", "restitution")


def default_method(pair: Any) -> Method:
    """Default method of a pair: mortar contact where it is supported. Local.

    ``pair`` is as for `check_method`, without the method. Smooth segments, ties and convective
    friction are exact at nodes, and have node-to-segment contact.
    """
    between_surfaces = isinstance(pair.segments, Surface) and not pair.touches_itself
    at_nodes = pair.is_convective or isinstance(pair.enforcement, Tied)
    if not between_surfaces or at_nodes or pair.segments.smooth:
        return NODES
    return NODES if isinstance(pair.nodes.smooth, RigidSphere) else MORTAR


def check_method(pair: Any) -> None:
    """Raise ValueError unless the method of a contact pair fits its other arguments. Local.

    ``pair`` is a `ContactPair` with all attributes set.
    """
    if pair.method not in KINDS:
        names = " or ".join(map(repr, KINDS))
        raise ValueError(f"expected method {names}, given {pair.method!r}")
    if pair.method == NODES:
        return
    wrong = ""
    has_edges = pair.method == EDGES and isinstance(pair.segments, RigidSurface)
    if not (isinstance(pair.segments, Surface) or has_edges):
        what = f"a Surface{' or a RigidSurface' * (pair.method == EDGES)}"
        wrong = f"{what} as segments, given {type(pair.segments).__name__}"
    elif pair.touches_itself:
        wrong = "two surfaces, given one that touches itself"
    elif pair.is_convective:
        wrong = f"friction by the law 'objective', given {pair.friction!r}"
    elif pair.method == EDGES and getattr(pair.enforcement, "impact", "") not in _OF_EDGES:
        wrong = f"impact 'elastic', 'plastic' or 'restitution', given {pair.enforcement!r}"
    elif pair.method == EDGES and isinstance(pair.enforcement, Tied):
        wrong = f"LagrangeMultiplier or Penalty as enforcement, given {pair.enforcement!r}"
    if wrong:
        raise ValueError(
            f"expected, with method {pair.method!r}, {wrong}; or use method 'node-to-segment'"
        )


def check_tie(pair: Any) -> None:
    """Raise ValueError if a pair with `Tied` does not support it. Local.

    ``pair`` is as for `check_method`.
    """
    if not isinstance(pair.enforcement, Tied):
        return
    wrong = ""
    if not isinstance(pair.segments, Surface):
        wrong = f"a Surface as segments, given {pair.segments!r}: bcs fix nodes in space"
    elif pair.touches_itself:
        wrong = "two surfaces, given one that touches itself"
    elif pair.friction is not None:
        wrong = f"no friction, as tied nodes never slide, given {pair.friction!r}"
    if wrong:
        raise ValueError(f"expected, with Tied, {wrong}")


def has_patches(pair: Any) -> bool:
    """Whether a `ContactPair` has segments with curved patches. Local."""
    return isinstance(pair.segments, Surface) and pair.segments.smooth is True


def may_be_smooth(pair: Any) -> bool:
    """Whether the segments of a `ContactPair` are flat and could be smooth. Local."""
    segments = pair.segments
    if not isinstance(segments, Surface) or segments.smooth:
        return False
    return Element.of(segments.V).degree == 1 and not _wrong_with_smooth(pair)


def check_smooth(pair: Any) -> None:
    """Raise ValueError if a pair with smooth segments does not support them. Local.

    ``pair`` is as for `check_method`.
    """
    surfaces = [pair.segments, pair.nodes] if pair.method == MORTAR else [pair.segments]
    is_smooth = any(isinstance(each, Surface) and each.smooth for each in surfaces)
    if is_smooth and (wrong := _wrong_with_smooth(pair)):
        raise ValueError(
            f"expected, with smooth segments, {wrong}; or use segments without smooth=True"
        )


def _wrong_with_smooth(pair: Any) -> str:
    """Requirement that a pair with smooth segments does not meet, or "". Local."""
    wrong = ""
    if pair.method == EDGES:
        wrong = f"method {NODES!r} or {MORTAR!r}, given {pair.method!r}"
    elif pair.method == MORTAR and (spheres := _spheres(pair)):
        wrong = f"smooth=True with method {MORTAR!r}, given {spheres[0]!r}"
    elif pair.touches_itself:
        wrong = "two surfaces, given one that touches itself"
    elif pair.is_convective:
        wrong = f"friction by the law 'objective', given {pair.friction!r}"
    elif isinstance(pair.enforcement, Tied):
        wrong = f"LagrangeMultiplier or Penalty as enforcement, given {pair.enforcement!r}"
    elif is_axisymmetric(pair.nodes.V.mesh):
        wrong = "a mesh in space or in the plane, given an axisymmetric mesh"
    return wrong


def _spheres(pair: Any) -> list[RigidSphere]:
    """Given spheres (``smooth=RigidSphere``) of the surfaces of a pair. Local."""
    kinds = (pair.segments.smooth, pair.nodes.smooth)
    return [kind for kind in kinds if isinstance(kind, RigidSphere)]


def check_dimension(pair: Any) -> None:
    """Raise ValueError if the arguments of a pair do not fit its space dimension. Local.

    ``pair`` is as for `check_method`.
    """
    dim, segments = dimension(pair.nodes.V), pair.segments
    if not isinstance(segments, Surface) and segments.dim != dim:
        raise ValueError(
            f"expected an obstacle in {dim} dimensions, as the mesh, given {segments!r} in "
            f"{segments.dim}: give it points of {dim} coordinates or, as an ExactObstacle of your "
            f"own, the class attribute dim = {dim}"
        )
    if dim == 3:
        return
    _check_axisymmetric(pair)
    wrong = ""
    if pair.method == EDGES:
        wrong = f"another method, as edges cross in space only, given {EDGES!r}"
    elif pair.is_convective:
        wrong = f"friction by the law 'objective', given {pair.friction!r}"
    if wrong:
        raise ValueError(f"expected, in two dimensions, {wrong}; or use a mesh in space")


def _check_axisymmetric(pair: Any) -> None:
    """Raise ValueError if an obstacle does not fit an axisymmetric or plane mesh. Local."""
    axisymmetric, segments = is_axisymmetric(pair.nodes.V.mesh), pair.segments
    if isinstance(segments, RigidCone) and not axisymmetric:
        raise ValueError(f"expected an axisymmetric mesh with a RigidCone, given {segments!r}")
    if not axisymmetric:
        return
    if isinstance(segments, Obstacle) and not segments.is_of_revolution:
        raise ValueError(
            "expected, in an axisymmetric mesh, a RigidPlane normal to the axis y, a RigidSphere "
            "with its centre on it, a RigidCone, or a custom ExactObstacle with the class "
            f"attributes dim = 2 and is_of_revolution = True, given {segments!r}"
        )
