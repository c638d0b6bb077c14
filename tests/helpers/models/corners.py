"""Corners of cubes in the order of binary numbers."""

from itertools import product

import numpy as np

__all__ = ["corners"]


def corners(stepper, body):
    """Corners of a cube of 1 m in the order of binary numbers, local nodes, shape ``(8,)``."""
    X = stepper.u.function_space.tabulate_dof_coordinates()[body.nodes]
    far = np.linalg.norm(X[:, None] - X, axis=2)
    # Opposite corners are the pairs of nodes at the largest distance.
    (ends,) = np.nonzero(np.isclose(far.max(axis=1), far.max()))
    X, nodes = X[ends], body.nodes[ends]
    sides = X[np.isclose(np.linalg.norm(X - X[0], axis=1), 1.0)] - X[0]
    order = [
        np.linalg.norm(X - X[0] - np.dot(bits[::-1], sides), axis=1).argmin()
        for bits in product((0, 1), repeat=3)
    ]
    return nodes[order]
