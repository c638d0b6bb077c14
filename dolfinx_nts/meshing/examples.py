"""Meshes that come with the package."""

from pathlib import Path

__all__ = ["ball_plate"]


def ball_plate() -> Path:
    """Path of a mesh of a hollow ball above a plate. Local.

    The physical volumes are ``ball`` and ``plate``; surfaces with names are, among others,
    ``ball_outer`` and ``plate_top``.

    Returns:
        A ``.msh`` file of hexahedra, lengths in m.

    Example:
        >>> mesh, cells, facets, tag = nts.read_mesh(nts.examples.ball_plate(), comm)
        >>> "ball" in tag and "plate" in tag
        True
    """
    return Path(__file__).with_name("ball_plate.msh")
