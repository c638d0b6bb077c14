"""Types of the compiled module; array shapes are in its docstrings."""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int32]
_Keys = npt.NDArray[np.int64]
_Flags = npt.NDArray[np.bool_]
_Status = npt.NDArray[np.int8]
_Paired = tuple[_Ints, _Floats, _Floats, _Floats]
_Contact = tuple[_Floats, _Floats, _Floats, _Floats, _Floats, _Floats, _Status]

HYSTERESIS: float
OVERHANG: float
WALL: float
DEEPEST: float

def with_vertices(points: _Floats, x: _Floats, vertices: _Ints, segment: _Ints) -> _Floats: ...
def unit_vectors(rows: _Floats) -> _Floats: ...
def slip_hessian(w: _Floats, b: _Floats, t: _Floats) -> _Floats: ...
def project(x_pair: _Floats, orientation: _Floats) -> tuple[_Floats, _Floats, _Floats, _Status]: ...
def patch_project(
    x_pair: _Floats, orientation: _Floats
) -> tuple[_Floats, _Floats, _Floats, _Status]: ...
def patch_functions(xi: _Floats, points: int) -> _Floats: ...
def gap_gradient(x_pair: _Floats, orientation: _Floats) -> _Floats: ...
def gap_hessian(x_pair: _Floats, orientation: _Floats) -> _Floats: ...
def invariants(x_pair: _Floats, normal: _Floats, xi: _Floats, slack: _Floats) -> _Floats: ...
def constraints(invariants: _Floats) -> _Floats: ...
def constraints_gradient(invariants: _Floats) -> _Floats: ...
def average_gradient(invariants_n: _Floats, invariants: _Floats) -> _Floats: ...
def contact_midpoint(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def contact_static(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def contact_conserving(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def patch_midpoint(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def patch_static(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def patch_conserving(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def slip(
    x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, _Floats, _Floats]: ...
def patch_slip(
    x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, _Floats, _Floats]: ...
def convective_slip(
    x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, _Floats]: ...
def balance(
    normal: _Floats,
    force: _Floats,
    columns: _Floats,
    rank: _Ints,
    known: _Floats,
    direction: _Floats,
) -> _Floats: ...
def slides(
    limit: _Floats,
    trial: _Floats,
    motion: _Floats,
    heading: _Floats,
    sliding: npt.NDArray[np.bool_],
) -> npt.NDArray[np.bool_]: ...
def longest_in_cones(v: _Floats, increment: _Floats) -> float: ...
def with_friction(columns: _Floats, direction: _Floats) -> _Floats: ...
def exact_friction(
    limit: _Floats,
    by_p: _Floats,
    by_slip: _Floats,
    t: _Floats,
    slip: _Floats,
    p: _Floats,
    c: _Floats,
    heading: _Floats,
    sliding: npt.NDArray[np.bool_],
) -> tuple[_Floats, _Floats, _Floats]: ...
def close_gaps(
    nodes: _Ints,
    moves: npt.NDArray[np.bool_],
    gap: _Floats,
    normal: _Floats,
    gradients: _Floats,
    farthest: _Floats,
    x: _Floats,
) -> None: ...
def drift(
    dt: float,
    v: _Floats,
    a: _Floats,
    rate: _Floats,
    u: _Floats,
    du: _Floats,
    about: _Floats,
) -> tuple[float, float]: ...
def kick(dt: float, mobility: _Floats, force: _Floats, a: _Floats, rate: _Floats) -> float: ...
def cell_lengths(x: _Floats, cells: _Ints) -> _Floats: ...
def penalty_forces(
    number: _Ints,
    node: _Ints,
    segment: _Ints,
    xi: _Floats,
    gap: _Floats,
    normal: _Floats,
    segments: _Ints,
    key: _Keys,
    stiffness: _Floats,
) -> Springs: ...
def contact_of_springs(
    springs: Springs,
    num_own: int,
    n: int,
    number: _Ints,
    segment: _Ints,
    gap: _Floats,
    key: _Keys,
    stiffness: _Floats,
) -> tuple[_Keys, _Flags, _Floats, _Floats, _Floats, _Floats, _Floats]: ...
def contact_sums(
    x: _Floats,
    nodes: _Ints,
    force: _Floats,
    energy: _Floats,
    active: _Flags,
    acts_on: _Floats,
    area: _Floats,
) -> _Floats: ...
def work_by_cause(
    before: Springs, after: Springs, du_before: _Floats, du_after: _Floats, dissipation: _Floats
) -> tuple[float, float, float, float, float]: ...
def bounds(x: _Floats, rows: _Ints) -> _Floats: ...
def change_components(x: _Floats) -> _Floats: ...
def take_rows(x: _Floats, rows: _Keys, out: _Floats) -> None: ...
def motion_sums(x: _Floats, p: _Floats, v: _Floats) -> _Floats: ...
def cell_volumes(
    values: _Floats, gradients: _Floats, makes_rings: bool, x: _Floats, cells: _Ints
) -> _Floats: ...
def least_volume_ratio(
    values: _Floats,
    gradients: _Floats,
    makes_rings: bool,
    x: _Floats,
    reference: _Floats,
    cells: _Ints,
) -> tuple[float, int]: ...
def add_rows(total: _Floats, ghosts: _Floats, rows: _Ints, values: _Floats) -> None: ...
def mortar_points(
    facets: _Ints,
    facet_orientation: _Floats,
    X: _Floats,
    x_n: _Floats,
    x: _Floats,
    segments: _Ints,
    orientation: _Floats,
    key: _Keys,
    thickness: _Floats,
    y_n: _Floats,
    y: _Floats,
    reach: float,
    sunk: float,
    are_rings: bool,
    are_smooth: bool,
) -> tuple[_Ints, _Ints, _Floats, _Floats, _Floats, _Floats]: ...
def sum_rows(
    phi: _Floats,
    start: _Keys,
    point: _Ints,
    share: _Floats,
    place: _Ints,
    length: int,
    values: _Floats,
) -> _Floats: ...
def turn_shares(
    start: _Keys, point: _Ints, value: _Floats, of_nodes: _Floats, of_points: _Floats
) -> _Floats: ...
def sum_slip(
    start: _Keys, point: _Ints, part: _Floats, slip: _Floats, frame: _Floats
) -> tuple[_Floats, _Floats]: ...
def spread_tractions(
    start: _Keys, point: _Ints, part: _Floats, traction: _Floats, p: int
) -> _Floats: ...
def sum_slip_blocks(
    phi: _Floats, block: _Ints, count: int, w: _Floats, b: _Floats, traction: _Floats
) -> _Floats: ...
def sum_contact(
    phi: _Floats,
    start: _Keys,
    point: _Ints,
    share: _Floats,
    place: _Ints,
    length: int,
    gap_n: _Floats,
    gap: _Floats,
    turn: _Floats,
    force: _Floats,
    gradient: _Floats,
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats]: ...
def sum_blocks(
    phi: _Floats, block: _Ints, count: int, factor: _Floats, matrix: _Floats
) -> _Floats: ...
def constraint_products(
    nodes: _Ints,
    rank: _Ints,
    rows: _Floats,
    parents: _Ints,
    weights: _Floats,
    directions: _Floats,
) -> tuple[_Keys, _Keys, _Floats]: ...
def at_points(phi: _Floats, nodes: _Ints, x: _Floats) -> _Floats: ...
def eliminated_directions(rank: _Ints, rows: _Floats, normal: _Floats, count: int) -> _Floats: ...
def farthest(x: _Floats, before: _Floats) -> float: ...
def lost(before: _Ints, after: _Ints) -> _Ints: ...
def overlapping_boxes(
    boxes: _Floats, touch: _Floats
) -> tuple[_Floats, _Ints, _Floats, _Floats]: ...
def approach(displacements: _Floats) -> _Floats: ...
def facets_may_be_within(x: _Floats, facets: _Ints, others: _Ints, reach: float) -> bool: ...
def points_on_paths(
    paths: _Floats, number: _Ints, path: _Ints, s: _Floats
) -> tuple[_Floats, _Ints]: ...
def paths_in(
    x: _Floats, nodes: Sequence[_Ints], edges: Sequence[_Ints], which: _Ints, regions: _Floats
) -> tuple[_Floats, _Ints]: ...

class SmallSystem:
    def __init__(self, number: _Keys, row: _Keys, column: _Keys, value: _Floats) -> None: ...
    def solve(self, b: _Floats) -> _Floats: ...

class Boundaries:
    def __init__(self, nodes: Sequence[_Ints], triangles: Sequence[_Ints]) -> None: ...
    def move(self, x: _Floats) -> None: ...
    def extents(self) -> _Floats: ...
    def displacements(self, x: _Floats, before: _Floats) -> _Floats: ...
    def crossings(self, points: _Floats, where: _Ints, boxes: _Floats) -> _Ints: ...
    def winding(self, points: _Floats, where: _Ints) -> _Floats: ...
    def distance(
        self, points: _Floats, where: _Ints, least: _Floats, crossings: _Ints
    ) -> _Floats: ...
    def cuts(self, paths: _Floats, where: _Ints) -> tuple[_Ints, _Floats]: ...

class Springs:
    node: _Ints
    num_nodes: int
    key: _Keys
    dofs: _Ints
    force: _Floats
    energy: _Floats
    def __init__(
        self, node: _Ints, key: _Keys, dofs: _Ints, force: _Floats, energy: _Floats
    ) -> None: ...

class ElementKernel:
    def __init__(self, address: int, takes_data: bool) -> None: ...

class BatchKernel:
    def __init__(self, address: int, lanes: int, is_single: bool) -> None: ...

class CellIntegral:
    def __init__(
        self,
        kernels: Sequence[ElementKernel] | Sequence[BatchKernel],
        X: _Floats,
        vertices: _Ints,
        nodes: _Ints,
        functions: Sequence[_Floats],
        first: Sequence[int],
        constants: Sequence[_Floats],
        places: _Ints,
        width: int,
        components: int,
        rows: _Ints,
        length: int,
    ) -> None: ...
    def add(self, cells: _Ints, packed: _Floats, b: _Floats, sums: _Floats) -> None: ...

class NodeFacets:
    def __init__(
        self,
        vertices: _Ints,
        orientation: _Floats,
        first: _Ints,
        facets: _Ints,
        corner: _Ints,
        angle: _Floats,
        group: _Ints | None = None,
    ) -> None: ...

class Segments:
    num_trees: int
    def __init__(
        self, vertices: _Ints, orientation: _Floats, key: _Keys, first: _Ints | None = None
    ) -> None: ...
    def find(self, keys: _Keys, group: _Ints | None = None) -> _Ints: ...
    def pair(
        self,
        x_node: _Floats,
        current: _Ints,
        slack: float,
        reach: float | _Floats,
        x: _Floats,
        facets: NodeFacets,
        x_facets: _Floats,
        numbers: _Ints,
        thickness: _Floats,
    ) -> _Paired: ...
    def follow(
        self,
        x_node_n: _Floats,
        x_node: _Floats,
        row: _Ints,
        inside: _Ints,
        x_n: _Floats,
        x: _Floats,
        facets: NodeFacets,
        x_facets: _Floats,
        numbers: _Ints,
    ) -> tuple[_Ints, npt.NDArray[np.bool_], _Floats, _Floats, _Floats, _Floats]: ...
    def near(
        self, x_node: _Floats, reach: float, x: _Floats, group: _Ints | None = None
    ) -> _Ints: ...
    def hold_in_dents(self, held: bool) -> None: ...
    def sink(self, depth: _Floats) -> None: ...
    def pair_own(
        self,
        x_node: _Floats,
        current: _Ints,
        slack: float,
        reach: float,
        x: _Floats,
        normal: _Floats,
        X_node: _Floats,
        N_node: _Floats,
        X: _Floats,
        thickness: _Floats,
    ) -> _Paired: ...

class IncompleteFactors:
    def __init__(self) -> None: ...
    def factorise(
        self,
        start: _Keys,
        column: _Ints,
        value: _Floats,
        order: _Ints,
        fill: bool = False,
        behind: _Floats | None = None,
    ) -> bool: ...
    def apply(self, b: _Floats, x: _Floats, behind: _Floats | None = None) -> None: ...
    def apply_at(
        self, places: _Ints, b: _Floats, x: _Floats, behind: _Floats | None = None
    ) -> None: ...

class CompleteFactors:
    entries: int
    def __init__(self, start: _Keys, column: _Ints, X: _Floats) -> None: ...
    def factorise(self, start: _Keys, column: _Ints, value: _Floats) -> bool: ...
    def apply(self, b: _Floats, x: _Floats) -> None: ...

class SingleMatrix:
    def __init__(self, start: _Keys, column: _Ints, value: _Floats) -> None: ...
    def multiply(self, x: _Floats, y: _Floats) -> None: ...

def largest_size(a: _Floats) -> float: ...
def largest_difference(a: _Floats, b: _Floats) -> float: ...
def largest_violation(excess: _Floats, rank: _Ints) -> float: ...
def slopes_at_nodes(
    start: _Keys, gradients: _Floats, columns: _Floats, slopes: _Floats
) -> _Floats: ...
def at_nodes(
    start: _Keys, keeps: _Flags, gradients: _Floats, columns: _Floats, components: int
) -> tuple[_Keys, _Floats, _Floats]: ...
def large_blocks(blocks: _Floats, size: float) -> _Flags: ...
def essential_nodes(
    start: _Keys,
    rank: _Ints,
    gradients: _Floats,
    columns: _Floats,
    slopes: _Floats,
    size: float,
    stiffness: float,
) -> npt.NDArray[np.bool_]: ...
def num_moved(
    m: int, same: npt.NDArray[np.bool_], now: _Floats, before: _Floats, limit: float
) -> int: ...

class Elimination:
    def __init__(
        self,
        start: _Keys,
        nodes: _Ints,
        rank: _Ints,
        normal: _Floats,
        gradients: _Floats,
        columns: _Floats,
        slopes: _Floats,
        tangent_nodes: _Ints,
        tangent: _Floats,
    ) -> None: ...
    def constrain(self, values: _Floats, x: _Floats, ghosts: _Floats) -> None: ...
    def act(self, x: _Floats, x_ghosts: _Floats, y: _Floats, y_ghosts: _Floats) -> _Floats: ...
    def missing(self, values: _Floats, x: _Floats, ghosts: _Floats) -> _Floats: ...
    def remove(self, multipliers: _Floats, y: _Floats, ghosts: _Floats) -> None: ...
    def add_tangent(self, x: _Floats, x_ghosts: _Floats, y: _Floats, y_ghosts: _Floats) -> None: ...

class FlexibleGmres:
    def __init__(self, b: _Floats, sums: Callable[[_Floats], _Floats] | None) -> None: ...
    @property
    def residual(self) -> float: ...
    @property
    def vector(self) -> _Floats: ...
    def add(self, z: _Floats, w: _Floats) -> float: ...
    def solution(self) -> _Floats: ...

class ContactSchwarz:
    def __init__(self, start: _Keys, column: _Ints, value: _Floats, places: _Ints) -> None: ...
    def clear(self) -> None: ...
    def add(self, contacts: Elimination) -> None: ...
    def build(self, *, wide: bool = False) -> bool: ...
    def correct(self, r: _Floats, z: _Floats, ghosts: _Floats) -> None: ...
    @property
    def size(self) -> int: ...

def counts_of_parts(flags: _Flags, number: _Ints, ends: _Keys) -> _Keys: ...

class NodalFriction:
    def __init__(
        self,
        has_springs: bool,
        on_axis: _Flags,
        rounding: _Floats,
        sliding: _Flags,
        flips: _Ints,
        traction: _Floats,
        explicit: _Floats,
        direction: _Floats,
        stiffness: _Floats,
        heading: _Floats,
        present: _Floats,
        modelled: _Floats,
        frame: _Floats,
    ) -> None: ...
    def turn(self, node: _Ints, frame: _Floats) -> None: ...
    def sticks(self, node: _Ints, active: _Flags) -> _Flags: ...
    def judge(
        self,
        node: _Ints,
        is_new: _Flags,
        limit: _Floats,
        trial: _Floats,
        motion: _Floats,
    ) -> tuple[_Floats, _Flags]: ...
    def accept(
        self,
        node: _Ints,
        active: _Flags,
        sliding: _Flags,
        p: _Floats,
        slip: _Floats,
        explicit: _Floats,
        direction: _Floats,
        stiffness: _Floats,
        lags: _Flags | None,
        limiting: _Floats,
    ) -> None: ...
    def known(
        self, node: _Ints, active: _Flags, not_own: _Flags, dim: int
    ) -> tuple[_Ints, _Floats, _Floats]: ...
    def balance(
        self,
        node: _Ints,
        active: _Flags,
        rank: _Ints,
        multipliers: _Floats,
        known: _Floats,
    ) -> None: ...
    def add_to(
        self,
        node: _Ints,
        active: _Flags,
        rows: _Floats,
        columns: _Floats,
        force: _Floats,
    ) -> tuple[_Floats, _Floats]: ...
