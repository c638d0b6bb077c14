r"""Frames in which nodes see what they face: space, or a rigid obstacle that moves.

Contact with a moving obstacle is evaluated in coordinates :math:`X` that the obstacle carries
along, where it is at rest: :math:`x = \varphi + R (X - c)`, with the place :math:`\varphi` of the
centre c and the rotation R at each end of a step. A force :math:`f` there is the force
:math:`R_m f` in space, with the mean :math:`R_m` of both rotations. With the Cayley vector
:math:`\theta` of the turn, :math:`R_{n+1} - R_n = \hat\theta R_m`, its work is

.. math:: f \cdot (X_{n+1} - X_n) = R_m f \cdot (\Delta x - \Delta\varphi
   - \theta \times (x_m - \varphi_m)),

so that the work of a contact force is what it was at rest, plus the work of force and moment
on the obstacle, exactly.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.kinematics import ContactKinematics, Slip

__all__ = ["Frame", "MovingFrame", "Placement", "rotation_by"]

# Turn [rad] of which a point at rest goes nearly straight in a frame: its way lies off the chord
# by 2e-4 of the distance from the axis.
_STRAIGHT = np.radians(2.5)


class Placement(NamedTuple):
    """Where an obstacle is at one time.

    Attributes:
        centre: Position of the centre of its motion, shape ``(3,)`` [m].
        rotation: Rotation since it was declared, shape ``(3, 3)`` [-].
    """

    centre: Floats
    rotation: Floats

    def angle_to(self, other: "Placement") -> float:
        """Angle between two placements, from 0 to pi [rad]. Local."""
        turn = other.rotation @ self.rotation.T
        return float(np.arctan2(np.linalg.norm(_axial(turn)), (np.trace(turn) - 1) / 2))

    def way_to(self, other: "Placement") -> tuple[Floats, Floats]:
        """Shift of the centre [m] and rotation vector [rad] of the way to another one. Local."""
        sine = _axial(other.rotation @ self.rotation.T)
        length = float(np.linalg.norm(sine))
        turn = self.angle_to(other) / length * sine if length else sine
        return other.centre - self.centre, turn


class Frame:
    """Space as the frame of a step: what nodes face is at rest, or has unknowns. Local.

    In the methods ``x`` are positions in space and ``X`` those in the frame, both of shape
    ``(..., 3)`` [m]; ``x_n`` and ``X_n`` are those at t_n.

    Attributes:
        moves: Whether the frame moves in the step.
        centre: Point in the middle of the step about which moments are taken, ``(3,)`` [m].
        angle: Angle by which the frame turns in the step [rad].
        stays_on_axis: Whether it has only moved along y since it was declared.
        turn: Cayley vector of this, 2 tan(angle/2) along the axis, shape ``(3,)`` [-].
        end: Where it is at t_{n+1}.
    """

    moves, stays_on_axis = False, True
    end = Placement(np.zeros(3), np.eye(3))
    centre: Floats = np.zeros(3)
    turn: Floats = np.zeros(3)
    angle = 0.0

    def go(self, part: float) -> None:
        """Take as the end of the step where the frame is after a part of its way, from 0 to 1."""

    def on_the_way(self, part: float, x: Floats) -> Floats:
        """Positions in the frame where it is after a part of the whole way of its step."""
        return x

    def ahead(self, X: Floats) -> tuple[Floats, Floats]:
        """What is left of the step: ways of the frame's points, in space and to first order.

        Also returns the rotation that is left, axis times angle, shape ``(3,)`` [rad].
        """
        return np.zeros_like(X), np.zeros(3)

    def way_from(self, end: Placement, x: Floats) -> Floats:
        """Ways in space, to first order, of the frame's points that were at x at another end."""
        return np.zeros_like(x)

    def at_start(self, x_n: Floats) -> Floats:
        """Positions in the frame at t_n."""
        return x_n

    def at_end(self, x: Floats) -> Floats:
        """Positions in the frame at t_{n+1}."""
        return x

    def in_space(self, X: Floats) -> Floats:
        """Positions in space at t_{n+1}."""
        return X

    def ways(
        self, X_n: Floats, X: Floats, unturned: Callable[[Floats, Floats], Floats | None]
    ) -> list[Floats]:
        """Positions in the frame of points that go straight in space, from X_n to X.

        They are so many that ways between them are nearly straight in the frame, too.

        Args:
            X_n: Positions at t_n.
            X: Positions at t_{n+1}.
            unturned: Takes back turns that do not matter, see `Obstacle.unturned`.
        """
        return [X_n, X]

    def relative(self, X_n: Floats, X: Floats) -> Floats:
        """Displacement in space relative to the frame, on which contact forces do work."""
        return X - X_n

    def carried(self, X_n: Floats, X: Floats) -> Floats:
        """Displacement in space of the frame's points in the middle of X_n and X."""
        return np.zeros_like(X)

    def drag(self, x: Floats) -> Floats:
        """How far the frame has carried its points that are at x now, shape ``(...)`` [m]."""
        return np.zeros(x.shape[:-1])

    def turned(self, scheme: str, contact: ContactKinematics) -> ContactKinematics:
        """Bring forces and their derivatives from the frame into space.

        Args:
            scheme: Kernel of the contact force, see `Candidates.contact`.
            contact: Kinematics of pairs whose nodes all have unknowns.
        """
        return contact

    def turned_slip(self, slip: Slip) -> Slip:
        """Bring forces, their derivatives and tangents from the frame into space."""
        return slip


class MovingFrame(Frame):
    """Frame of an obstacle that moves in a step, see `Frame`.

    Args:
        origin: Centre of the motion where the obstacle was declared, shape ``(3,)`` [m].
        start: Where the obstacle is at t_n.
        middle: Where it is half-way.
        end: Where it is at t_{n+1}.
    """

    def __init__(self, origin: Floats, start: Placement, middle: Placement, end: Placement) -> None:
        self._origin, self._start, self._goal = origin, start, end
        self.go(1.0)
        self.angle = start.angle_to(middle) + middle.angle_to(end)
        self.moves = bool(np.any(self._shift) or np.any(start.rotation != end.rotation))
        is_turned = bool(np.any(end.rotation != np.eye(3)))
        self.stays_on_axis = not is_turned and bool(end.centre[0] == origin[0])

    def go(self, part: float) -> None:
        """Go a part of the way, see `Frame.go`: straight, and about one axis."""
        start, end = self._start, self._place(part)
        shift, turn = start.way_to(self._goal)
        self.end = end
        self._ahead = (1 - part) * shift, (1 - part) * turn
        self._mean: Floats = (start.rotation + end.rotation) / 2
        turned = end.rotation @ start.rotation.T
        # Without end for half a turn.
        self.turn = 4 * _axial(turned) / max(1 + np.trace(turned), np.finfo(float).eps)
        self._shift: Floats = end.centre - start.centre
        self.centre = (start.centre + end.centre) / 2

    def on_the_way(self, part: float, x: Floats) -> Floats:
        return self._seen_from(self._place(part), x)

    def ahead(self, X: Floats) -> tuple[Floats, Floats]:
        shift, turn = self._ahead
        way: Floats = shift + np.cross(turn, (X - self._origin) @ self.end.rotation.T)
        return way, turn

    def way_from(self, end: Placement, x: Floats) -> Floats:
        shift, turn = end.way_to(self.end)
        way: Floats = shift + np.cross(turn, x - end.centre)
        return way

    def at_start(self, x_n: Floats) -> Floats:
        return self._seen_from(self._start, x_n)

    def at_end(self, x: Floats) -> Floats:
        return self._seen_from(self.end, x)

    def in_space(self, X: Floats) -> Floats:
        x: Floats = (X - self._origin) @ self.end.rotation.T + self.end.centre
        return x

    def ways(
        self, X_n: Floats, X: Floats, unturned: Callable[[Floats, Floats], Floats | None]
    ) -> list[Floats]:
        """Positions on the way, see `Frame.ways`: the frame moves as in `go`."""
        start, (shift, turn) = self._start, self._start.way_to(self.end)
        if (straight := unturned(X, self.turn @ start.rotation)) is not None:
            return [X_n, straight]
        x_n = (X_n - self._origin) @ start.rotation.T + start.centre
        way = self.in_space(X) - x_n
        number = max(1, math.ceil(float(np.linalg.norm(turn)) / _STRAIGHT))
        between = [
            (x_n + part * way - start.centre - part * shift)
            @ (rotation_by(part * turn) @ start.rotation)
            + self._origin
            for part in np.arange(1, number) / number
        ]
        return [X_n, *between, X]

    def relative(self, X_n: Floats, X: Floats) -> Floats:
        y_n, y = self._arms(X_n, X)
        way: Floats = y - y_n - np.cross(self.turn, (y_n + y) / 2)
        return way

    def carried(self, X_n: Floats, X: Floats) -> Floats:
        y_n, y = self._arms(X_n, X)
        way: Floats = self._shift + np.cross(self.turn, (y_n + y) / 2)
        return way

    def _place(self, part: float) -> Placement:
        """Where the frame is after a part of its way."""
        if part == 1:
            return self._goal
        shift, turn = self._start.way_to(self._goal)
        rotation = rotation_by(part * turn) @ self._start.rotation
        return Placement(self._start.centre + part * shift, rotation)

    def _seen_from(self, place: Placement, x: Floats) -> Floats:
        """Positions in the frame when it is at a place."""
        X: Floats = (x - place.centre) @ place.rotation + self._origin
        return X

    def _arms(self, X_n: Floats, X: Floats) -> tuple[Floats, Floats]:
        """Positions relative to the centre at both ends of the step, ``(..., 3)`` [m]."""
        return (
            (X_n - self._origin) @ self._start.rotation.T,
            (X - self._origin) @ self.end.rotation.T,
        )

    def drag(self, x: Floats) -> Floats:
        y = (x - self.end.centre) @ self.end.rotation @ self._start.rotation.T
        way: Floats = np.linalg.norm(x - self._start.centre - y, axis=-1)
        return way

    def turned(self, scheme: str, contact: ContactKinematics) -> ContactKinematics:
        """Bring forces into space, see `Frame.turned`; static ones by the rotation at the end."""
        end = _of_all(self.end.rotation, contact.force)
        of_force = end if scheme == "static" else _of_all(self._mean, contact.force)
        return contact._replace(
            force=contact.force @ of_force.T,
            gradient=contact.gradient @ end.T,
            tangent=of_force @ contact.tangent @ end.T,
        )

    def turned_slip(self, slip: Slip) -> Slip:
        return _TurnedSlip(slip, self._start.rotation, self._mean, self.end.rotation)


class _TurnedSlip(Slip):
    """Slip relative to a frame that turns, with the rotations at t_n, mean and at t_{n+1}."""

    def __init__(self, slip: Slip, start: Floats, mean: Floats, end: Floats) -> None:
        self._slip, self.value = slip, slip.value
        self._start, self._mean, self._end = start, mean, end
        of_force, of_gradient = (_of_all(turn, slip.force) for turn in (mean, end))
        self.force, self.gradient = slip.force @ of_force.T, slip.gradient @ of_gradient.T
        self.frame_n, self.normal_n = slip.frame_n @ start.T, slip.normal_n @ start.T
        self.frame, self.normal = slip.frame @ end.T, slip.normal @ end.T

    def at_end(self) -> "_TurnedSlip":
        return _TurnedSlip(self._slip.at_end(), self._start, self._end, self._end)

    def tangent(self, t: Floats) -> Floats:
        mean, end = (_of_all(turn, self._slip.force) for turn in (self._mean, self._end))
        tangent: Floats = mean @ self._slip.tangent(t) @ end.T
        return tangent


def _of_all(rotation: Floats, force: Floats) -> Floats:
    """Rotation of all nodes of pairs with forces of shape ``(..., d)``, shape ``(d, d)``."""
    all_of_them = np.kron(np.eye(force.shape[-1] // 3), rotation).astype(np.float64)
    return all_of_them


def _axial(turn: Floats) -> Floats:
    """Half of the axial vector of a rotation: its axis times the sine of its angle."""
    twice = (turn - turn.T)[[2, 0, 1], [1, 2, 0]]
    return twice / 2


def rotation_by(turn: Floats) -> Floats:
    """Rotation by a vector, axis times angle (Rodrigues), shape ``(3, 3)``. Local."""
    half = np.linalg.norm(turn) / 2
    w = np.cross(np.eye(3), turn)  # w @ y is turn x y
    sine, factor = np.sinc(2 * half / np.pi), np.sinc(half / np.pi)
    rotation: Floats = np.eye(3) + sine * w + factor**2 / 2 * w @ w
    return rotation
