"""A scene that is its own mirror image stays so, whatever the numbering."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

GAP, SIZE = 0.05, 0.4


@pytest.mark.serial
@pytest.mark.parametrize("is_reversed", [False, True])
def test_block_driven_between_two_stops_stays_on_its_axis(comm, is_reversed):
    """Springs at its corners depended on the number of the segment: 2e-4 m/s sideways."""

    def build(model):
        for name, corner, size, cells in (
            ("block", (-SIZE / 2, -SIZE / 2), (SIZE, SIZE), (4, 4)),
            ("left", (-SIZE / 2 - GAP - 0.3, -0.25), (0.3, 0.5), (3, 5)),
            ("right", (SIZE / 2 + GAP, -0.25), (0.3, 0.5), (3, 5)),
        ):
            parts.add_rectangle(model, name, corner=corner, size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    rubber = nts.NeoHookean(100.0, 0.3, 1.0)
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in ("block", "left", "right")]
    held = fem.locate_dofs_geometrical(V, lambda x: abs(x[0]) > SIZE / 2 + GAP + 0.299)
    stepper = nts.EnergyMomentum(
        bodies[::-1] if is_reversed else bodies,
        nts.all_pairs(bodies[::-1] if is_reversed else bodies),
        dt=1 / 400,
        bcs=[fem.dirichletbc(np.zeros(2), held, V)],
        loads=[nts.Force(bodies[0], lambda t: (2 * np.sin(2 * np.pi * t), 0.0))],
    )
    X = V.tabulate_dof_coordinates()[:, :2].round(6)
    number = {tuple(x): i for i, x in enumerate(X)}
    mirror = [number[x, -y + 0.0] for x, y in X]
    most = 0
    for step in stepper.run(until=1.05):
        most = max(most, step.num_active)
        v = stepper.v.x.array.reshape(-1, 2)
        assert np.abs(v - v[mirror] * [1, -1]).max() < 1e-9
    assert most >= 4
