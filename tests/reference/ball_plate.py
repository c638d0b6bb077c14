"""The ball on the plate without friction, by the independent reference program.

Bodies of ``bulk.py``, contact of single pairs of ``nts.py``, and an own
search, active set and Newton's method, written from ``docs/method.md``. It
reads the mesh file itself and shares no code with the package. The table with
which ``tests/verification/impact/test_ball_plate.py`` compares is printed by

    cd tests && python3 -m reference.ball_plate          (20 minutes)
    cd tests && python3 -m reference.ball_plate --one    (one segment a node)

A node that is equally near to several segments has the mean of their gaps,
each with its own discrete gradient; with ``--one`` the lowest number decides.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.sparse
import scipy.sparse.linalg

from reference import nts
from reference.bulk import Bulk

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

MESH = Path(__file__).parents[2] / "dolfinx_nts" / "meshing" / "ball_plate.msh"
YOUNG, POISSON, DENSITY = 1e5, 0.4, 1e3  # Pa, -, kg/m^3
STEP = 0.01  # s

# Vertices of gmsh's hexahedra and quadrilaterals in tensor order.
HEXAHEDRON, QUADRILATERAL = [0, 1, 3, 2, 4, 5, 7, 6], [0, 1, 3, 2]
# How far outside its segments [reference coordinates] a node keeps them at the
# start of a step, and in equilibrium (docs/method.md).
KEPT, KEPT_IN_EQUILIBRIUM = 0.01, 0.15
# Difference of distances of equally near segments, relative to a segment [-].
EQUAL = 1e-8
# Gaps that count as zero, and gaps at which active nodes may stay, relative to a segment [-].
TOUCHES, NEAR = 1e-9, 0.01
# Nodes higher above the plate do not touch in any step [m].
FAR = 0.1

Law = Callable[[Array, Array, float, Flags], Flags]


def read_mesh(path: Path) -> tuple[Array, dict[str, IntArray]]:
    """Return nodes (n, 3) and the cells of each physical group of a MSH 4.1 file."""
    text = path.read_text()
    section = {
        name: text.split(f"${name}\n")[1].split(f"$End{name}")[0].splitlines()
        for name in ("PhysicalNames", "Entities", "Nodes", "Elements")
    }
    names = {tuple(line.split()[:2]): line.split('"')[1] for line in section["PhysicalNames"][1:]}
    points, curves, surfaces, volumes = map(int, section["Entities"][0].split())
    lines = section["Entities"][1 + points + curves :]
    group = {}
    for dim, some in ((2, lines[:surfaces]), (3, lines[surfaces : surfaces + volumes])):
        for line in some:
            words = line.split()  # tag, box, number of physical tags, tags
            group[str(dim), words[0]] = names[str(dim), words[8]]
    coordinates: dict[int, list[float]] = {}
    lines = section["Nodes"][1:]
    while lines:
        count = int(lines[0].split()[3])
        tags, values = lines[1 : 1 + count], lines[1 + count : 1 + 2 * count]
        coordinates |= {
            int(t): list(map(float, v.split())) for t, v in zip(tags, values, strict=True)
        }
        lines = lines[1 + 2 * count :]
    row = {tag: number for number, tag in enumerate(coordinates)}
    cells: dict[str, IntArray] = {}
    lines = section["Elements"][1:]
    while lines:
        dim, entity, _, count = lines[0].split()
        some = [[row[int(tag)] for tag in line.split()[1:]] for line in lines[1 : 1 + int(count)]]
        order = QUADRILATERAL if dim == "2" else HEXAHEDRON
        cells[group[dim, entity]] = np.array(some)[:, order]
        lines = lines[1 + int(count) :]
    return np.array(list(coordinates.values())), cells


def elastic(gap_n: Array, gap_trial: Array, size: float, active: Flags) -> Flags:
    """Elastic impact: nodes that touch, would penetrate, or were active nearby hold their gap."""
    passes = (gap_n > 0) & (gap_trial < gap_n) & (gap_n + gap_trial < TOUCHES * size)
    stays = active & (gap_n < NEAR * size)
    return (gap_n <= TOUCHES * size) | passes | stays


def hold(gap_n: Array, gap_trial: Array, size: float, active: Flags) -> Flags:
    """Elastic impact: only nodes that have touched hold their gap."""
    return gap_n <= 1e-12


def plastic(gap_n: Array, gap_trial: Array, size: float, active: Flags) -> Flags:
    """Plastic impact: all nodes may touch, and close their gap."""
    return np.full(len(gap_n), True)


VARIANTS: dict[str, tuple[bool, Law]] = {
    "midpoint": (False, plastic),
    "EM, plastic": (True, plastic),
    "EM, hold": (True, hold),
    "EM, elastic": (True, elastic),
}


@dataclass
class State:
    """Positions and velocities, active nodes and their segments."""

    x: Array
    v: Array
    mean: Array
    segments: list[list[int]]
    active: Flags
    impulse: Array


class BallPlate:
    """The scene and its steps.

    Args:
        conserving: Energy-momentum scheme, otherwise the midpoint rule.
        law: Who may touch, and the gap that is held.
        shares: Nodes that are equally near to several segments have all.
    """

    def __init__(self, conserving: bool, law: Law, shares: bool = True) -> None:
        """Read the mesh, and let the ball fly."""
        X, cells = read_mesh(MESH)
        lmbda = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
        mu = YOUNG / (2 * (1 + POISSON))
        both = np.vstack((cells["ball"], cells["plate"]))
        self.bulk = Bulk(X, both, lmbda=lmbda, mu=mu, rho=DENSITY)
        self.mass = scipy.sparse.csr_matrix(self.bulk.mass)
        self.nodes = np.unique(cells["ball_outer"])
        self.segments = cells["plate_top"]
        corners = X[self.segments]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.orientation = np.sign(normal[:, 2])
        self.size = float(np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1).max())
        self.conserving, self.law, self.shares = conserving, law, shares
        self.contact = nts.contact_conserving if conserving else nts.contact_midpoint
        v = np.zeros_like(X)
        v[np.unique(cells["ball"])] = [0.0, 1.0, -1.0]
        num = len(self.nodes)
        none: list[list[int]] = [[] for _ in range(num)]
        self.state = State(X, v, v, none, np.full(num, False), np.zeros(3))

    def nearest(self, x: Array, number: int) -> list[int]:
        """Return the nearest segments of a node, lowest number first."""
        node = x[self.nodes[number]]
        corners = x[self.segments]
        if node[2] > corners[:, :, 2].max() + FAR:
            return []
        around = np.linalg.norm(corners.mean(axis=1) - node, axis=1)
        some = np.flatnonzero(around < 0.75 * self.size)
        if not len(some):
            return []
        away = np.array([self.distance(x, number, i) for i in some])
        equal = some[away <= away.min() + EQUAL * self.size]
        return equal.tolist() if self.shares else [int(equal[0])]

    def pair(self, number: int, segment: int) -> IntArray:
        """Return node and vertices of a pair."""
        return np.concatenate(([self.nodes[number]], self.segments[segment]))

    def distance(self, x: Array, number: int, segment: int) -> float:
        """Return the distance of a node from a segment, which ends at its edges."""
        x_pair = x[self.pair(number, segment)]
        xi, gap, _, _ = nts.project(x_pair, self.orientation[segment])
        return abs(gap) if max(*-xi, *(xi - 1)) <= 0 else nts.distance(x_pair)

    def find(self, x: Array, number: int, before: list[int], allowed: float) -> list[int]:
        """Return the previous segments, or the nearest ones if the node has left one of them."""
        for i in before:
            xi = nts.project(x[self.pair(number, i)], self.orientation[i])[0]
            if max(*-xi, *(xi - 1)) > allowed:
                return self.nearest(x, number)
        return before or self.nearest(x, number)

    def gap(self, x: Array, number: int, segments: list[int]) -> float:
        """Return the mean gap of a node to its segments, none: NaN."""
        gaps = [nts.project(x[self.pair(number, i)], self.orientation[i])[1] for i in segments]
        return float(np.mean(gaps)) if gaps else np.nan

    def choose(self, old: State, trial: Array) -> tuple[list[list[int]], Flags]:
        """Return the segments at t_n, and which nodes may touch."""
        begin, gap_n, gap_trial = [], *np.full((2, len(self.nodes)), np.nan)
        for number, before in enumerate(old.segments):
            # None of several segments was the right one.
            single = before if len(before) == 1 else []
            own = self.find(old.x, number, single, KEPT)
            met = own if len(own) > 1 else self.find(trial, number, own, KEPT)[:1]
            gap_n[number] = self.gap(old.x, number, met)
            gap_trial[number] = self.gap(trial, number, met)
            begin.append(own)
        eligible = self.law(gap_n, gap_trial, self.size, old.active)
        return begin, eligible & ~np.isnan(gap_n)

    def advance(self) -> int:
        """Make one step and return the number of active nodes."""
        old, dt = self.state, STEP
        trial = old.x + dt * old.v
        begin, eligible = self.choose(old, trial)
        x = old.x + dt * old.mean
        segments = [self.find(x, n, own, KEPT) for n, own in enumerate(begin)]
        multiplier = np.where(old.active & eligible, -1.0, 0.0)
        for _ in range(5):
            x, multiplier, force = self.solve(old, x, segments, eligible, multiplier)
            found = [
                self.find(x, n, own, KEPT_IN_EQUILIBRIUM) if eligible[n] else own
                for n, own in enumerate(segments)
            ]
            if found == segments:
                break
            segments = found
        else:
            raise RuntimeError("segments change repeatedly")
        mean = (x - old.x) / dt
        active = multiplier < 0
        impulse = old.impulse - dt * force
        self.state = State(x, 2 * mean - old.v, mean, segments, active, impulse)
        return int(active.sum())

    def solve(
        self,
        old: State,
        x: Array,
        segments: list[list[int]],
        eligible: Flags,
        multiplier: Array,
    ) -> tuple[Array, Array, Array]:
        """Return positions, multipliers and the force on the plate of a step."""
        weight, dt = YOUNG * self.size, STEP
        some = [n for n in np.flatnonzero(eligible) if segments[n]]
        target = {
            n: self.gap(old.x, n, segments[n]) if self.law is not plastic else 0.0 for n in some
        }
        active = multiplier < 0
        for iteration in range(40):
            force, K = self.bulk.internal(old.x, x, conserving=self.conserving, sparse=True)
            inertia = self.mass @ (2 / dt**2 * (x - old.x) - 2 / dt * old.v).ravel()
            excess = np.zeros(len(active))
            before = active.copy()
            for n in some:
                excess[n] = self.gap(x, n, segments[n]) - target[n]
                test = multiplier[n] + weight * excess[n]
                active[n] = test < 0 if iteration else active[n] or test < 0
            multiplier[~active] = 0.0
            own = np.flatnonzero(active)
            F, G, T = self.contacts(old.x, x, own, [segments[n] for n in own], multiplier[own])
            R = inertia + force + F @ multiplier[own]
            # Increments that balance the forces, and unit multipliers.
            K = (K + 2 / dt**2 * self.mass + T).tocsc()
            factors = scipy.sparse.linalg.splu(
                K,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.1,
                options={"SymmetricMode": True},
            )
            change, unit = -factors.solve(R), factors.solve(F)
            increments = np.linalg.solve(G @ unit, G @ change + excess[own])
            change = (change - unit @ increments).reshape(-1, 3)
            x, multiplier[own] = x + change, multiplier[own] + increments
            if np.abs(change).max() < 1e-12 and (active == before).all():
                at_node = F.reshape(*x.shape, len(own))[self.nodes[own], :, range(len(own))]
                return x, multiplier, multiplier[own] @ at_node
        raise RuntimeError("no convergence")

    def contacts(
        self, x_n: Array, x: Array, own: IntArray, segments: list[list[int]], multiplier: Array
    ) -> tuple[Array, Array, scipy.sparse.csr_matrix]:
        """Return forces of unit multipliers (3n, m), gradients of gaps (m, 3n), and the tangent."""
        F, G = np.zeros((x.size, len(own))), np.zeros((len(own), x.size))
        entries, rows, columns = [np.empty(0)], [np.empty(0, dtype=int)], [np.empty(0, dtype=int)]
        for column, (n, several) in enumerate(zip(own, segments, strict=True)):
            for i in several:
                pair = self.pair(n, i)
                result = self.contact(x_n[pair], x[pair], self.orientation[i])
                force, gradient, tangent = (each / len(several) for each in result[2:5])
                dofs = (3 * pair[:, None] + np.arange(3)).ravel()
                F[dofs, column] += force
                G[column, dofs] += gradient
                entries.append(multiplier[column] * tangent.ravel())
                rows.append(np.repeat(dofs, len(dofs)))
                columns.append(np.tile(dofs, len(dofs)))
        where = np.concatenate(rows), np.concatenate(columns)
        T = scipy.sparse.csr_matrix((np.concatenate(entries), where), shape=(x.size, x.size))
        return F, G, T

    def row(self, active: int) -> tuple[float, float, int, float]:
        """Return kinetic and strain energy, active nodes, and the vertical impulse."""
        x, v = self.state.x, self.state.v
        V = self.bulk.strain_energy(x)
        return self.bulk.kinetic_energy(v), V, active, float(self.state.impulse[2])


def rows(
    name: str, steps: int = 100, *, shares: bool = True
) -> Iterator[tuple[float, float, int, float]]:
    """Yield the row of a variant after each step."""
    scene = BallPlate(*VARIANTS[name], shares)
    for _ in range(steps):
        yield scene.row(scene.advance())


if __name__ == "__main__":
    for name in VARIANTS:
        print(f'    "{name}": [')
        for step, row in enumerate(rows(name, shares="--one" not in sys.argv), start=1):
            if step % 25 == 0:
                K, V, active, impulse = row
                print(f"        ({K:.9f}, {V:.9f}, {active}, {impulse:.9f}),", flush=True)
        print("    ],")
