"""ActiveSet: active nodes by their multipliers and gaps."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.contact.implicit.normal.active_set import ActiveSet
from helpers.models.plane import blocks

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(("is_static", "stays"), [(True, True), (False, False)])
def test_gaps_of_active_nodes_count_with_inertia_only(is_static, stays):
    """In statics a node that presses stays held whatever gap an iteration has left."""
    scene = blocks()
    pair = nts.ContactPair(
        scene.nodes, scene.segments, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    (state,) = nts.QuasiStatic([scene.lower, scene.upper], [pair], dt=1.0).contacts
    n = len(state.nodes.nodes)
    node, presses = np.arange(n, dtype=np.int32), np.full(n, -10.0)
    active = ActiveSet(state, pair.enforcement, np.full(n, 1e7), is_static)
    excess, before = np.full(n, 1e-5), np.ones(n, dtype=bool)
    found, violators = active.update(node, excess, before, presses, 1)
    assert found.all() == stays and (violators == 0) == stays
    # Tensile nodes are released, and penetrating nodes are activated, in any case.
    pulls = active.update(node, 0 * excess, before, -presses, 2)[0]
    inside = active.update(node, -excess, ~before, 0 * presses, 3)[0]
    assert not pulls.any() and inside.all()
