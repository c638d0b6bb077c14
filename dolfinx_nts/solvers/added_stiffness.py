"""Stiffness that matrices of the bodies have on their diagonals beside that of the forms."""

from dolfinx_nts.common.arrays import Floats

__all__ = ["NEARBY_SHIFT", "AddedStiffness"]

# Stiffness added to matrices near the derivative, relative to that of the derivative [-]:
# contact makes up for what is too much, not for what is too little.
NEARBY_SHIFT = 1e6


class AddedStiffness:
    """What is added for bodies that nothing else holds, or that go against a resistance. Local.

    Attributes:
        shift: Stiffness of the owned nodes that holds them a little, shape ``(n, 1)``, or of all
            [N/m].
        num_free: Number of rigid motions that it holds a little.
        drag: The same of a resistance that acts for a while, see `Drag`.
        in_addition: What the last matrix got of both, ``(n, 1)`` or of all nodes [N/m].
    """

    def __init__(self) -> None:
        """Begin without any."""
        self.shift: Floats | float = 0.0
        self.num_free = 0
        self.drag: Floats | float = 0.0
        self.in_addition: Floats | float = 0.0

    def added(self, held: Floats | float, *, is_exact: bool) -> Floats | float:
        """What matrices have on their diagonals in addition, ``(n, 1)`` or of all nodes [N/m].

        Args:
            held: Stiffness of nodes that are held where they are, of the same shape [N/m].
            is_exact: Whether it is the matrix of the derivative, and not one near it.
        """
        shift = self.shift + held
        return (shift if is_exact else NEARBY_SHIFT * shift) + self.drag
