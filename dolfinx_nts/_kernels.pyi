"""Types of the compiled module; shapes are in its docstrings."""

import numpy as np
import numpy.typing as npt

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int32]
_Keys = npt.NDArray[np.int64]
_Status = npt.NDArray[np.int8]
_Springs = tuple[_Ints, _Keys, _Ints, _Floats, _Floats, _Floats]
_Contact = tuple[_Floats, _Floats, _Floats, _Floats, _Floats, _Floats, _Status]

DEEPEST: float

def project(x_pair: _Floats, orientation: _Floats) -> tuple[_Floats, _Floats, _Floats, _Status]: ...
def gap_gradient(x_pair: _Floats, orientation: _Floats) -> _Floats: ...
def gap_hessian(x_pair: _Floats, orientation: _Floats) -> _Floats: ...
def invariants(x_pair: _Floats, normal: _Floats, xi: _Floats, slack: _Floats) -> _Floats: ...
def constraints(invariants: _Floats) -> _Floats: ...
def constraints_gradient(invariants: _Floats) -> _Floats: ...
def average_gradient(invariants_n: _Floats, invariants: _Floats) -> _Floats: ...
def contact_midpoint(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def contact_static(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def contact_conserving(x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats) -> _Contact: ...
def pair_nodes(
    x_node: _Floats,
    current: _Ints,
    reach: float,
    x_segment: _Floats,
    orientation: _Floats,
    key: _Keys,
) -> tuple[_Ints, _Floats, _Floats, _Floats]: ...
def pair_own_nodes(
    x_node: _Floats,
    current: _Ints,
    reach: float,
    x_segment: _Floats,
    orientation: _Floats,
    key: _Keys,
    normal: _Floats,
    X_node: _Floats,
    N_node: _Floats,
    X_segment: _Floats,
    thickness: _Floats,
) -> tuple[_Ints, _Floats, _Floats, _Floats]: ...
def slip(
    x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, _Floats, _Floats]: ...
def convective_slip(
    x_pair_n: _Floats, x_pair: _Floats, orientation: _Floats
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, _Floats]: ...
def constrain(
    dofs: _Ints,
    rank: _Ints,
    normal: _Floats,
    gradients: _Floats,
    values: _Floats,
    x: _Floats,
) -> None: ...
def act(
    dofs: _Ints,
    rank: _Ints,
    normal: _Floats,
    columns: _Floats,
    tangent: _Floats,
    x: _Floats,
    y: _Floats,
) -> None: ...
def balance(normal: _Floats, rest: _Floats, columns: _Floats) -> _Floats: ...
def close_gaps(
    nodes: _Ints,
    moves: npt.NDArray[np.bool_],
    gap: _Floats,
    normal: _Floats,
    gradients: _Floats,
    farthest: float,
    x: _Floats,
) -> None: ...
def drift(dt: float, v: _Floats, a: _Floats, rate: _Floats, u: _Floats, du: _Floats) -> float: ...
def kick(dt: float, mobility: _Floats, force: _Floats, a: _Floats, rate: _Floats) -> None: ...
def cell_lengths(x: _Floats, cells: _Ints) -> _Floats: ...
def press(
    node: _Ints,
    segment: _Ints,
    xi: _Floats,
    gap: _Floats,
    normal: _Floats,
    segments: _Ints,
    stiffness: _Floats,
) -> tuple[_Ints, _Ints, _Floats, _Floats]: ...
def unexplained_work(
    before: _Springs, after: _Springs, lost: _Floats
) -> tuple[float, float, float]: ...
def add_rows(total: _Floats, rows: _Ints, values: _Floats) -> None: ...

class IncompleteFactors:
    def __init__(self) -> None: ...
    def factorise(self, start: _Keys, column: _Ints, value: _Floats, order: _Ints) -> bool: ...
    def apply(self, b: _Floats, x: _Floats) -> None: ...

class Patch:
    def __init__(self, start: _Keys, column: _Ints, value: _Floats) -> None: ...
    def clear(self) -> None: ...
    def add(
        self,
        dofs: _Ints,
        rank: _Ints,
        normal: _Floats,
        gradients: _Floats,
        columns: _Floats,
        tangent: _Floats,
    ) -> None: ...
    def build(self) -> bool: ...
    def correct(self, r: _Floats, z: _Floats) -> None: ...
    @property
    def size(self) -> int: ...
