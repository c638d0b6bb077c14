"""Stiffness on the diagonal of the matrix of the bodies, in addition to that of the forms."""

from dolfinx_nts.common.arrays import Floats

__all__ = ["NEARBY_SHIFT", "AddedStiffness"]

# Stiffness added to matrices near the derivative, relative to that added to the derivative [-]. The
# contact correction compensates too much stiffness, but not too little.
NEARBY_SHIFT = 1e6


class AddedStiffness:
    """Stiffness added for free bodies and for a viscous resistance. Local.

    Attributes:
        shift: Small stiffness of the owned nodes of free bodies, shape ``(n, 1)``, or of all nodes
            [N/m].
        num_free: Number of rigid motions that only this stiffness resists.
        drag: Stiffness of a temporary resistance, of the same shape, see `Drag`.
        in_addition: Sum of these in the last matrix, shape ``(n, 1)`` or of all nodes [N/m].
    """

    def __init__(self) -> None:
        self.shift: Floats | float = 0.0
        self.num_free = 0
        self.drag: Floats | float = 0.0
        self.in_addition: Floats | float = 0.0

    def added(self, held: Floats | float, *, is_exact: bool) -> Floats | float:
        """Stiffness to add to the diagonal, ``(n, 1)`` or of all nodes [N/m].

        Args:
            held: Stiffness of nodes that the matrix clamps, of the same shape [N/m].
            is_exact: Whether the matrix is the derivative itself, or a definite one near it.
        """
        shift = self.shift + held
        return (shift if is_exact else NEARBY_SHIFT * shift) + self.drag
