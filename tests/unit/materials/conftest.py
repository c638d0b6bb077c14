"""Shared helpers of the tests of materials."""

import numpy as np
import pytest
from dolfinx import fem

from dolfinx_nts.fem.jit import compile_expression
from helpers.models.boxed import Box


@pytest.fixture
def at(comm):
    """Evaluate a UFL expression of C at a given tensor."""
    mesh = Box(comm, shape=(comm.size, 1, 1)).mesh
    C = fem.Constant(mesh, np.eye(3))

    def compiled(function):
        expression = compile_expression(function(C), np.full((1, 3), 0.25))

        def value(number):
            C.value[:] = number
            return expression.eval(mesh, np.zeros(1, dtype=np.int32)).ravel()

        return value

    return compiled
