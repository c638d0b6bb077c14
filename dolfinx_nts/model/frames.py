r"""Reference frames of contact: space, or the frame of a moving rigid obstacle.

Contact with a moving obstacle is evaluated in body-fixed coordinates :math:`X`, in which the
obstacle is at rest: :math:`x = \varphi + R (X - c)`, with the position :math:`\varphi` of the
centre c and the rotation R at each end of a step. A force :math:`f` in this frame is the force
:math:`R_m f` in space, with the mean :math:`R_m` of both rotations. With the Cayley vector
:math:`\theta` of the rotation, :math:`R_{n+1} - R_n = \hat\theta R_m`, its work is

.. math:: f \cdot (X_{n+1} - X_n) = R_m f \cdot (\Delta x - \Delta\varphi
   - \theta \times (x_m - \varphi_m)),

so that the work of a contact force is exactly the work in the frame plus the work of force and
moment on the obstacle.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.kinematics import ContactKinematics, Slip

__all__ = ["Frame", "MovingFrame", "Placement", "TurnedSlip", "rotation_by"]

# Rotation [rad] up to which the path of a fixed point in a rotating frame is replaced by its chord.
# The error is 2e-4 of the distance from the axis. Smaller: more time.
_STRAIGHT = np.radians(2.5)


class Placement(NamedTuple):
    """Position and rotation of an obstacle at one time.

    Attributes:
        centre: Position of the centre of its motion, shape ``(3,)`` [m].
        rotation: Rotation from the declared position, shape ``(3, 3)`` [-].
    """

    centre: Floats
    rotation: Floats

    def angle_to(self, other: "Placement") -> float:
        """Angle between two placements, from 0 to pi [rad]. Local."""
        turn = other.rotation @ self.rotation.T
        return float(np.arctan2(np.linalg.norm(_axial(turn)), (np.trace(turn) - 1) / 2))

    def motion_to(self, other: "Placement") -> tuple[Floats, Floats]:
        """Displacement of the centre [m] and rotation vector [rad] to another placement. Local."""
        sine = _axial(other.rotation @ self.rotation.T)
        length = float(np.linalg.norm(sine))
        turn = self.angle_to(other) / length * sine if length else sine
        return other.centre - self.centre, turn


class Frame:
    """Identity frame of a step, for obstacles at rest and deformable surfaces. Local.

    In the methods ``x`` are positions in space and ``X`` positions in the frame, both of shape
    ``(..., 3)`` [m]; ``x_n`` and ``X_n`` are positions at t_n.

    Attributes:
        moves: Whether the frame moves in the step.
        centre: Reference point of moments in the middle of the step, shape ``(3,)`` [m].
        angle: Angle of the rotation in the step [rad].
        stays_on_axis: Whether the total motion is a translation along y.
        turn: Cayley vector of the rotation, 2 tan(angle/2) along the axis, shape ``(3,)`` [-].
        end: Placement at t_{n+1}.
    """

    moves, stays_on_axis = False, True
    end = Placement(np.zeros(3), np.eye(3))
    centre: Floats = np.zeros(3)
    turn: Floats = np.zeros(3)
    angle = 0.0

    def advance_to(self, part: float) -> None:
        """Set the end of the step to a fraction of the motion, from 0 to 1."""

    def intermediate(self, part: float, x: Floats) -> Floats:
        """Positions in the frame after a fraction of the whole motion of the step."""
        return x

    def remaining(self, X: Floats) -> tuple[Floats, Floats]:
        """Remaining prescribed motion of the step.

        Returns:
            Displacements in space of the points X of the frame, to first order, and the remaining
            rotation vector, shape ``(3,)`` [rad].
        """
        return np.zeros_like(X), np.zeros(3)

    def displacement_from(self, end: Placement, x: Floats) -> Floats:
        """Displacements, to first order, of points fixed in the frame that were at x at ``end``."""
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

    def path(
        self, X_n: Floats, X: Floats, unturned: Callable[[Floats, Floats], Floats | None]
    ) -> list[Floats]:
        """Polygonal path in the frame of points that move straight in space.

        Args:
            X_n: Positions at t_n.
            X: Positions at t_{n+1}.
            unturned: Removes rotations that leave the surface unchanged, see `Obstacle.unturned`.

        Returns:
            Positions at the vertices of the path, from X_n to X.
        """
        return [X_n, X]

    def relative(self, X_n: Floats, X: Floats) -> Floats:
        """Displacement in space relative to the moving frame, work-conjugate to contact forces."""
        return X - X_n

    def carried(self, X_n: Floats, X: Floats) -> Floats:
        """Displacement in space of points fixed in the frame at the mean of X_n and X."""
        return np.zeros_like(X)

    def displacement(self, x: Floats) -> Floats:
        """Displacement in the step of points of the frame that are at x at the end [m]."""
        return np.zeros(x.shape[:-1])

    def turned(self, scheme: str, contact: ContactKinematics) -> ContactKinematics:
        """Transform forces and their derivatives from the frame to space.

        Args:
            scheme: Kernel of the contact force, see `Candidates.contact`.
            contact: Kinematics of pairs, all of whose nodes have unknowns.
        """
        return contact

    def turned_slip(self, slip: Slip) -> Slip:
        """Transform forces, their derivatives and tangents from the frame to space."""
        return slip


class MovingFrame(Frame):
    """Body-fixed frame of an obstacle that moves in a step.

    Args:
        origin: Declared position of the centre of the motion, shape ``(3,)`` [m].
        start: Placement at t_n.
        middle: Placement in the middle of the step.
        end: Placement at t_{n+1}.
    """

    def __init__(self, origin: Floats, start: Placement, middle: Placement, end: Placement) -> None:
        self._origin, self._start, self._final = origin, start, end
        self.advance_to(1.0)
        self.angle = start.angle_to(middle) + middle.angle_to(end)
        self.moves = bool(np.any(self._shift) or np.any(start.rotation != end.rotation))
        is_turned = bool(np.any(end.rotation != np.eye(3)))
        self.stays_on_axis = not is_turned and bool(end.centre[0] == origin[0])

    def advance_to(self, part: float) -> None:
        # The centre moves straight, and the rotation is about one axis.
        start, end = self._start, self._place(part)
        shift, turn = start.motion_to(self._final)
        self.end = end
        self._remaining = (1 - part) * shift, (1 - part) * turn
        self._mean: Floats = (start.rotation + end.rotation) / 2
        turned = end.rotation @ start.rotation.T
        # Finite also for half a turn.
        self.turn = 4 * _axial(turned) / max(1 + np.trace(turned), np.finfo(float).eps)
        self._shift: Floats = end.centre - start.centre
        self.centre = (start.centre + end.centre) / 2

    def intermediate(self, part: float, x: Floats) -> Floats:
        return self._seen_from(self._place(part), x)

    def remaining(self, X: Floats) -> tuple[Floats, Floats]:
        shift, turn = self._remaining
        du: Floats = shift + np.cross(turn, (X - self._origin) @ self.end.rotation.T)
        return du, turn

    def displacement_from(self, end: Placement, x: Floats) -> Floats:
        shift, turn = end.motion_to(self.end)
        du: Floats = shift + np.cross(turn, x - end.centre)
        return du

    def at_start(self, x_n: Floats) -> Floats:
        return self._seen_from(self._start, x_n)

    def at_end(self, x: Floats) -> Floats:
        return self._seen_from(self.end, x)

    def in_space(self, X: Floats) -> Floats:
        x: Floats = (X - self._origin) @ self.end.rotation.T + self.end.centre
        return x

    def path(
        self, X_n: Floats, X: Floats, unturned: Callable[[Floats, Floats], Floats | None]
    ) -> list[Floats]:
        start, (shift, turn) = self._start, self._start.motion_to(self.end)
        if (straight := unturned(X, self.turn @ start.rotation)) is not None:
            return [X_n, straight]
        x_n = (X_n - self._origin) @ start.rotation.T + start.centre
        du = self.in_space(X) - x_n
        number = max(1, math.ceil(float(np.linalg.norm(turn)) / _STRAIGHT))
        between = [
            (x_n + part * du - start.centre - part * shift)
            @ (rotation_by(part * turn) @ start.rotation)
            + self._origin
            for part in np.arange(1, number) / number
        ]
        return [X_n, *between, X]

    def relative(self, X_n: Floats, X: Floats) -> Floats:
        y_n, y = self._arms(X_n, X)
        du: Floats = y - y_n - np.cross(self.turn, (y_n + y) / 2)
        return du

    def carried(self, X_n: Floats, X: Floats) -> Floats:
        y_n, y = self._arms(X_n, X)
        du: Floats = self._shift + np.cross(self.turn, (y_n + y) / 2)
        return du

    def _place(self, part: float) -> Placement:
        """Placement after a fraction of the motion."""
        if part == 1:
            return self._final
        shift, turn = self._start.motion_to(self._final)
        rotation = rotation_by(part * turn) @ self._start.rotation
        return Placement(self._start.centre + part * shift, rotation)

    def _seen_from(self, place: Placement, x: Floats) -> Floats:
        """Positions in the frame at a placement."""
        X: Floats = (x - place.centre) @ place.rotation + self._origin
        return X

    def _arms(self, X_n: Floats, X: Floats) -> tuple[Floats, Floats]:
        """Positions relative to the centre at both ends of the step, ``(..., 3)`` [m]."""
        return (
            (X_n - self._origin) @ self._start.rotation.T,
            (X - self._origin) @ self.end.rotation.T,
        )

    def displacement(self, x: Floats) -> Floats:
        y = (x - self.end.centre) @ self.end.rotation @ self._start.rotation.T
        du: Floats = np.linalg.norm(x - self._start.centre - y, axis=-1)
        return du

    def turned(self, scheme: str, contact: ContactKinematics) -> ContactKinematics:
        # Static schemes use the rotation at the end.
        end = _of_all(self.end.rotation, contact.force)
        of_force = end if scheme == "static" else _of_all(self._mean, contact.force)
        return contact._replace(
            force=contact.force @ of_force.T,
            gradient=contact.gradient @ end.T,
            tangent=of_force @ contact.tangent @ end.T,
        )

    def turned_slip(self, slip: Slip) -> Slip:
        return TurnedSlip(slip, self._start.rotation, self._mean, self.end.rotation)


class TurnedSlip(Slip):
    """Slip relative to a rotating frame.

    Args:
        slip: Slip in the frame.
        start: Rotation of the frame at t_n, shape ``(3, 3)``.
        mean: Mean rotation.
        end: Rotation at t_{n+1}.
    """

    def __init__(self, slip: Slip, start: Floats, mean: Floats, end: Floats) -> None:
        self._slip, self.value = slip, slip.value
        self._start, self._mean, self._end = start, mean, end
        of_force, of_gradient = (_of_all(turn, slip.force) for turn in (mean, end))
        self.force, self.gradient = slip.force @ of_force.T, slip.gradient @ of_gradient.T
        self.frame_n, self.normal_n = slip.frame_n @ start.T, slip.normal_n @ start.T
        self.frame, self.normal = slip.frame @ end.T, slip.normal @ end.T

    def averaged(self, average: Callable[[Slip, Floats], Slip], tangents_n: Floats) -> "TurnedSlip":
        """Average the slip in the frame.

        Args:
            average: Function of a slip and tangents at t_n that returns the averaged slip.
            tangents_n: Tangents at t_n in space, shape ``(m, 2, 3)``.
        """
        slip = average(self._slip, tangents_n @ self._start)
        return TurnedSlip(slip, self._start, self._mean, self._end)

    def at_end(self) -> "TurnedSlip":
        return TurnedSlip(self._slip.at_end(), self._start, self._end, self._end)

    def tangent(self, t: Floats) -> Floats:
        mean, end = (_of_all(turn, self._slip.force) for turn in (self._mean, self._end))
        tangent: Floats = mean @ self._slip.tangent(t) @ end.T
        return tangent


def _of_all(rotation: Floats, force: Floats) -> Floats:
    """Block-diagonal rotation of all nodes for forces ``(..., d)``, shape ``(d, d)``."""
    all_of_them = np.kron(np.eye(force.shape[-1] // 3), rotation).astype(np.float64)
    return all_of_them


def _axial(turn: Floats) -> Floats:
    """Axis of a rotation matrix times the sine of its angle, shape ``(3,)``."""
    twice = (turn - turn.T)[[2, 0, 1], [1, 2, 0]]
    return twice / 2


def rotation_by(turn: Floats) -> Floats:
    """Rotation matrix of a rotation vector (Rodrigues), shape ``(3, 3)``. Local."""
    half = np.linalg.norm(turn) / 2
    w = np.cross(np.eye(3), turn)  # w @ y is turn x y
    sine, factor = np.sinc(2 * half / np.pi), np.sinc(half / np.pi)
    rotation: Floats = np.eye(3) + sine * w + factor**2 / 2 * w @ w
    return rotation
