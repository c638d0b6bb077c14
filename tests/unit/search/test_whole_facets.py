"""Facets of degree 2 in mortar contact: nodes and hat functions."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts import compat
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.search.mortar.whole_facets import HatFunctions, whole_facets
from dolfinx_nts.search.scatter import NodalScatter

pytestmark = pytest.mark.serial

cells = pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])


@cells
def test_nodes_of_a_facet_are_found_by_its_segments(cell):
    element = Element(cell, 2)
    numbers = np.random.default_rng(2).permutation(100)[: len(element.points)].astype(np.int32)
    segments = numbers[element.pieces]
    assert (whole_facets(segments, 2) == numbers).all()
    assert whole_facets(segments, 1) is segments


@cells
def test_hats_are_linear_on_facets_and_forces_do_the_same_work_on_them(cell, rng):
    element, none = Element(cell, 2), np.empty(0, dtype=np.int64)
    n, k = len(element.points), len(element.basix.entity_closure_dofs[0])
    index_map = compat.index_map(MPI.COMM_SELF, n, none, none.astype(np.int32))
    hat_functions = HatFunctions(NodalScatter(index_map), np.arange(n, dtype=np.int32)[None], k)
    values = np.zeros((n, 3))
    values[:k] = element.points[:k] @ rng.normal(size=(2, 3)) + 0.4
    field, forces = hat_functions.spread(values), rng.normal(size=(n, 3))
    middle = np.linalg.lstsq(np.c_[element.points, np.ones(n)], field, rcond=None)[1]
    assert np.abs(middle).max(initial=0.0) <= 1e-20
    gathered = hat_functions.gather(forces)
    assert not gathered[k:].any()
    assert np.vdot(gathered, values) == pytest.approx(np.vdot(forces, field), rel=1e-12)
