"""Rigid and stiff round bodies that bend a body with coarse facets: roles by `all_pairs`."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.search.kinks import arc_length

pytestmark = pytest.mark.at_most_two_ranks

SPAN, HEIGHT, RADIUS, DEFLECTION, E = 2.0, 0.05, 0.1, 0.02, 1e4


def bending(comm, cells, facets, degree=2, modulus=np.inf, has_pad=False):
    """Forces on three rollers that bend a beam, relative to beam theory."""
    centres = (
        (-SPAN / 2, -HEIGHT / 2 - RADIUS),
        (SPAN / 2, -HEIGHT / 2 - RADIUS),
        (0.0, HEIGHT / 2 + RADIUS),
    )

    def build(model):
        length = 1.3 * SPAN
        corner = (-length / 2, -HEIGHT / 2)
        add = parts.add_rectangle
        add(model, "beam", corner=corner, size=(length, HEIGHT), cells=(cells, 4 // degree**2))
        if has_pad:
            add(model, "pad", corner=(-0.5, -5.0), size=(1.0, 1.0), cells=(50, 50))
        occ = model.occ
        for number, centre in enumerate(centres):
            inner, outer = ([(2, occ.addDisk(*centre, 0, r, r))] for r in (0.04, RADIUS))
            (surface,), _ = occ.cut(outer, inner)
            occ.synchronize()
            model.addPhysicalGroup(2, [surface[1]], name=f"roller {number}")
            for _, curve in model.getBoundary([surface], oriented=False):
                model.mesh.setTransfiniteCurve(curve, facets + 1)
            model.mesh.setRecombine(*surface)
        model.mesh.generate(2)

    mesh, cell_tags, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    beam = nts.Body(V, cell_tags, tag["beam"], nts.SaintVenantKirchhoff(E, 0.0, 1.0))
    down = nts.Motion(lambda t: (0.0, -DEFLECTION * t))
    guides = nts.Guide(), nts.Guide(), nts.Guide(motion=down)
    rollers, bcs, travel = [], [], fem.Constant(mesh, np.zeros(2))
    for i, (guide, centre) in enumerate(zip(guides, centres, strict=True)):
        if modulus == np.inf:
            rollers += [nts.RigidBody(V, cell_tags, tag[f"roller {i}"], rho=1.0, guide=guide)]
            continue
        material = nts.SaintVenantKirchhoff(modulus, 0.3, 1.0)
        rollers += [nts.Body(V, cell_tags, tag[f"roller {i}"], material)]
        hub = fem.locate_dofs_geometrical(
            V, lambda x, at=centre: np.hypot(x[0] - at[0], x[1] - at[1]) < 0.0401
        )
        bcs += [fem.dirichletbc(travel if i == 2 else np.zeros(2), hub, V)]

    def middle(x):
        return (abs(x[0]) < 1e-6) & (abs(x[1] + HEIGHT / 2) < 1e-9)

    along, _ = V.sub(0).collapse()
    dofs = fem.locate_dofs_geometrical((V.sub(0), along), middle)
    bcs = [fem.dirichletbc(fem.Function(along), dofs, V.sub(0)), *bcs]
    bodies = [beam, *rollers]
    if has_pad:
        bodies.append(
            nts.Body(V, cell_tags, tag["pad"], nts.SaintVenantKirchhoff(E / 1e3, 0.0, 1.0))
        )
        held = fem.locate_dofs_geometrical(V, lambda x: x[1] < -3.9)
        bcs.append(fem.dirichletbc(np.zeros(2), held, V))
    pairs = nts.all_pairs(bodies)

    def update(t):
        travel.value[1] = -DEFLECTION * t

    stepper = nts.QuasiStatic(bodies, pairs, dt=0.25, bcs=bcs, update=update)
    *_, last = stepper.run(until=1.0)
    theory = 48 * E * HEIGHT**3 / 12 / SPAN**3 * DEFLECTION
    return [reaction.force[1] / theory for reaction in last.reactions[-3:]], pairs, rollers


@pytest.mark.parametrize(("cells", "facets"), [(26, 32), (26, 64)])
def test_bar_of_coarse_cells_is_bent_over_rigid_rollers(comm, cells, facets):
    """With nodes of the bar alone the force was 0 to 0.9 of that of beam theory."""
    forces, pairs, rollers = bending(comm, cells, facets)
    assert sorted(forces) == pytest.approx([-1.0, 0.5, 0.5], rel=0.01)
    assert {pair.method for pair in pairs} == {"node-to-segment"}
    assert arc_length(nts.boundary_of(rollers[0])) == pytest.approx(np.inf)
    outer = nts.boundary_of(rollers[0], where=lambda x: x[1] < -1.6 * RADIUS - HEIGHT / 2)
    assert 0.4 < arc_length(outer) / (0.25 * RADIUS) < 1.1


@pytest.mark.parametrize(("cells", "facets"), [(52, 16), (26, 32)])
def test_bar_is_bent_over_stiff_rollers(comm, cells, facets):
    """With nodes of the bar, which see mean gaps, the forces on 16 facets were 0.66 of theory."""
    forces, _, _ = bending(comm, cells, facets, modulus=100 * E)
    assert sorted(forces) == pytest.approx([-1.0, 0.5, 0.5], rel=0.01)


def test_soft_body_elsewhere_does_not_change_the_roles(comm):
    forces, pairs, _ = bending(comm, 26, 32, has_pad=True)
    assert sorted(forces) == pytest.approx([-1.0, 0.5, 0.5], rel=0.01)
    assert "node-to-segment" in {pair.method for pair in pairs}


def test_rollers_give_the_segments_if_the_facets_of_the_bar_resolve_them(comm):
    forces, pairs, _ = bending(comm, 156, 64)
    assert sorted(forces) == pytest.approx([-1.0, 0.5, 0.5], rel=0.02)
    assert "mortar" in {pair.method for pair in pairs}
