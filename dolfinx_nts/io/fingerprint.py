"""Fingerprint of a scene: data that must not change when a run is resumed.

It has a text for each part of the scene, with digests of long values. The texts do not depend on
the partition of the mesh.
"""

import hashlib
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from dolfinx_nts.common.arrays import Array
from dolfinx_nts.contact.friction.laws import FrictionLaw
from dolfinx_nts.contact.method import MORTAR
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.components import deformation_gradient, dimension
from dolfinx_nts.fem.node_numbering import input_ids
from dolfinx_nts.integrators.implicit.generalized_alpha import GeneralizedAlpha
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.checksum import checksum
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.materials.plasticity import J2Plasticity
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["fingerprint"]

# Cached material of a body and digest of its energy, since UFL takes long to compute it.
_known: WeakKeyDictionary[Body, tuple[Hyperelastic, str]] = WeakKeyDictionary()


def fingerprint(stepper: Stepper) -> dict[str, str]:
    """Describe the scene of a stepper. Collective.

    The description contains the mesh, bodies with materials, pairs with laws, kinds of loads,
    supported degrees of freedom, and the integrator. It contains neither the state nor the values
    of loads and supports.

    Args:
        stepper: Stepper of the scene.

    Returns:
        Texts by name, the same on all ranks.
    """
    V = stepper.u.function_space
    mesh = V.mesh
    comm, ids = mesh.comm, input_ids(V)

    def rows(number: Array, values: Array) -> str:
        """Checksum of rows from all ranks by their numbers."""
        own = np.array([checksum(number, values)], dtype=np.uint64)
        return f"{int(reductions.total(comm, own)[0]):016x}"

    owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local)
    original = mesh.topology.original_cell_index
    n = mesh.geometry.index_map().size_local
    # Input coordinates of the mesh: coordinates of degrees of freedom are computed, with a
    # round-off error that depends on the partition.
    nodes = rows(mesh.geometry.input_global_indices[:n], mesh.geometry.x[:n])
    cells = rows(original[owned], ids[V.dofmap.list[owned]])
    scene = {"integrator": type(stepper).__name__, "mesh": f"{nodes} {cells}"}
    if isinstance(stepper, GeneralizedAlpha):
        scene["integrator"] += f" with rho_inf = {stepper.rho_inf}"
    for number, body in enumerate(stepper.bodies, start=1):
        numbers = original[body.cells]
        scene[f"body {number}"] = f"{rows(numbers, numbers)} of {_material(stepper, body)}"
    for number, pair in enumerate(stepper.pairs, start=1):
        scene[f"pair {number}"] = _pair(pair, ids, rows)
        scene[f"laws of pair {number}"] = f"{_law(pair.enforcement)}, {_law(pair.friction)}"
    scene["loads"] = ", ".join(
        f"{type(load).__name__} {_digest(load.form(stepper.u_n, stepper.u).signature())}"
        for load in stepper.loads
    )
    fixed = stepper.supports.fixed
    dim = dimension(V)
    numbers = dim * ids[fixed // dim] + fixed % dim
    scene["supports"] = rows(numbers, numbers)
    return comm.bcast(scene)  # type: ignore[no-any-return]


def _digest(*values: Any) -> str:
    """Digest of texts and arrays: 12 digits."""
    digest = hashlib.sha256()
    for value in values:
        text = value.encode() if isinstance(value, str) else np.ascontiguousarray(value).tobytes()
        digest.update(text)
    return digest.hexdigest()[:12]


def _material(stepper: Stepper, body: Body) -> str:
    material = body.material
    numbers = {
        "rho": material.rho,
        "mass_damping": material.mass_damping,
        "stiffness_damping": material.stiffness_damping,
        **material.parameters,
    }
    for number, branch in enumerate(material.branches, start=1):
        numbers |= {f"share_{number}": branch.share}
        numbers |= {f"relaxation_time_{number}": branch.relaxation_time}
    if isinstance(material, J2Plasticity):
        numbers |= {f"hardening_{i}": x for i, x in enumerate(material.hardening, start=1)}
    return f"{_energy(stepper, body)} with {_numbers(numbers)}"


def _energy(stepper: Stepper, body: Body) -> str:
    """Digest of the energy of a body, without its material parameters."""
    first = next(other for other in stepper.bodies if other.material is body.material)
    material, digest = _known.get(first, (None, ""))
    if material is not first.material:
        C = right_cauchy_green(deformation_gradient(stepper.u))
        form = bulk_form([first], lambda law, parameters, rho: law.psi(C, **parameters))
        digest = _digest(form.signature())
        _known[first] = first.material, digest
    return digest


def _pair(pair: ContactPair, ids: Array, rows: Callable[[Array, Array], str]) -> str:
    text = rows(pair.nodes.node_ids, pair.nodes.node_ids)
    text += " that are smooth" if pair.method == MORTAR and pair.nodes.smooth is True else ""
    text += " against "
    if isinstance(pair.segments, Surface):
        text += rows(pair.segments.key, np.sort(ids[pair.segments.segments], axis=1))
        smooth = pair.segments.smooth
        text += " that are smooth" if smooth is True else ""
        text += f" that are {_law(smooth)}" if isinstance(smooth, RigidSphere) else ""
    else:
        text += _law(pair.segments)
    return f"{text}, {pair.method}"


def _law(law: object) -> str:
    """Class and parameters of a law or an obstacle."""
    return "none" if law is None else f"{type(law).__name__}({_numbers(vars(law))})"


def _numbers(values: dict[str, Any]) -> str:
    return ", ".join(f"{name.lstrip('_')}={_value(value)}" for name, value in values.items())


def _value(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return _digest(value)
    if isinstance(value, FrictionLaw):
        return _law(value)
    plain = value is None or isinstance(value, bool | int | float | str | np.number)
    return str(value) if plain else type(value).__name__
