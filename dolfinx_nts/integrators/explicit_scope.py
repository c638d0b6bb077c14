"""What explicit steps can do, of all that bodies and pairs may declare."""

from collections.abc import Sequence

from dolfinx_nts.common.arguments import instances
from dolfinx_nts.contact.method import EDGES, NODES, has_patches
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.bodies import Body

__all__ = ["check_scope"]


def check_scope(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> None:
    """Check that explicit steps can compute bodies and pairs. Local.

    Raises:
        TypeError: One of them has another type.
        ValueError: A pair has a method or segments, or a body a material, that only the implicit
            steppers know.
    """
    methods = {pair.method for pair in instances(ContactPair, pairs)}
    if others := sorted(methods - {NODES, EDGES}):
        raise _out_of_scope(
            f"pairs of method {NODES!r} or {EDGES!r}", " and ".join(map(repr, others))
        )
    if smooth := [pair.segments.name for pair in pairs if has_patches(pair)]:
        raise _out_of_scope("segments without smooth=True", " and ".join(smooth))
    if names := [body.name for body in instances(Body, bodies) if body.material.remembers]:
        raise _out_of_scope("materials without branches or plasticity", str(names))


def _out_of_scope(expected: str, given: str) -> ValueError:
    """Error that names who can do what is given."""
    return ValueError(
        f"expected {expected} with CentralDifference, given {given}, which the implicit steppers "
        "can do"
    )
