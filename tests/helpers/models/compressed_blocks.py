"""Patch test: two stacked blocks of the same cross-section under compression."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from helpers.laws import NODAL_PAIR


@dataclass(frozen=True)
class Compressed:
    """Result of a compression.

    Attributes:
        stress: Normal stress at the midpoints of this rank's cells, relative to linear
            elasticity, shape ``(c,)``.
        stepper: The stepper after the step.
        mean_pressure: Modulus times compression.
    """

    stress: npt.NDArray[np.float64]
    stepper: nts.QuasiStatic
    mean_pressure: float


def compress(
    lower: int,
    upper: int,
    pairs: Callable[..., Any] = NODAL_PAIR,
    *,
    modulus: float = 1.0,
    compression: float = 1e-4,
    nu: float = 0.3,
    cell: str = "hexahedron",
    degree: int = 1,
    swirl: float = 0.0,
    jitter: float = 0.0,
    one_point: tuple[str, ...] | None = None,
    smooth: bool = False,
) -> Compressed:
    """Compress blocks with given numbers of cells along an edge. Collective.

    Args:
        lower: Cells along an edge of the lower block.
        upper: Of the upper one.
        pairs: Returns the pair of two surfaces, or several.
        modulus: Young's modulus.
        compression: Displacement of the top, whose height is 1.
        nu: Poisson's ratio.
        cell: Kind of the cells.
        degree: Of the displacement.
        swirl: Angle by which the nodes in the middle of the interface are turned within it.
        jitter: Edges of the upper cells by which inner nodes are moved at random, at most.
        one_point: Of the material.
        smooth: Of both surfaces.
    """
    comm = MPI.COMM_WORLD

    def build(model: Any) -> None:
        for name, z, n in (("lower", 0.0, lower), ("upper", 0.5, upper)):
            box = {"corner": (0, 0, z), "size": (1, 1, 0.5), "cells": (n, n, n // 2)}
            meshing.add_box(model, name, cell=cell, **box)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    X = mesh.geometry.x
    x, y = X[:, 0].copy(), X[:, 1].copy()
    swirls = swirl * np.sin(np.pi * x) * np.sin(np.pi * y)
    # Outer faces of the blocks remain in their planes.
    X[:, 0] -= swirls * (y - 0.5)
    X[:, 1] += swirls * (x - 0.5)
    inner = np.all(np.abs(2 * X - np.round(2 * X)) > 1e-9, axis=1)
    moved = np.random.default_rng(1).uniform(-jitter / upper, jitter / upper, (inner.sum(), 3))
    X[inner] += moved
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    material = nts.SaintVenantKirchhoff(E=modulus, nu=nu, rho=1.0, one_point=one_point)
    bodies = [nts.Body(V, cells, tag[name], material) for name in ("lower", "upper")]
    names = ("upper_bottom", "lower_top")
    surfaces = [nts.Surface(V, facets, tag[name], smooth=smooth) for name in names]
    down = fem.Constant(mesh, 0.0)

    def support(axis: int, value: Any, *sides: str) -> fem.DirichletBC:
        held = np.sort(np.concatenate([facets.find(tag[side]) for side in sides]))
        return fem.dirichletbc(
            value, fem.locate_dofs_topological(V.sub(axis), 2, held), V.sub(axis)
        )

    zero = np.float64(0.0)
    bcs = [
        support(0, zero, "lower_left", "upper_left"),
        support(1, zero, "lower_front", "upper_front"),
        support(2, zero, "lower_bottom"),
        support(2, down, "upper_top"),
    ]

    def update(t: float) -> None:
        down.value = -compression * t

    contacts = np.atleast_1d(pairs(*surfaces)).tolist()
    stepper = nts.QuasiStatic(bodies, contacts, dt=1.0, bcs=bcs, update=update)
    stepper.advance()
    F = ufl.Identity(3) + ufl.grad(stepper.u)
    S = material.stress(F.T * F, **material.parameters)
    point = np.full((1, 3), 0.5 if cell == "hexahedron" else 0.25)
    owned = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    stress = fem.Expression(S[2, 2], point).eval(mesh, owned).ravel()
    return Compressed(stress / (-modulus * compression), stepper, modulus * compression)
