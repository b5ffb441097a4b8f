"""Orientations in which an object can stand, lie, roll or tumble, and its supporting points in each of them."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float

from datagen.geometry import cross, rotation_from_quaternion
from datagen.shapes.shape import Shape

_SUPPORT_DEPTH = 3e-4
"""Height above the lowest point up to which points carry the object, metres."""

_ANGLES = 2 * np.pi * np.arange(24) / 24
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])

_UPRIGHT = np.cos(np.radians(20))
"""Cosine of the largest tilt of a mesh that still counts as upright."""

STEADY = 0.004
"""Least distance of a steady object's centre of mass from the edge of its base, seen from above, metres."""


@dataclass(frozen=True, eq=False)
class Stance:
    """A shape in one orientation; lengths in metres, relative to its centre of mass."""

    shape: Shape
    rotation: Float[np.ndarray, "3 3"]
    """Rotation from the object frame to the world's axes."""

    @cached_property
    def points(self) -> Float[np.ndarray, "corner 3"]:
        """Corners of the turned shape."""
        return np.concatenate(self.shape.convex_parts) @ self.rotation.T

    @cached_property
    def bottom(self) -> float:
        """Height of the lowest point."""
        return float(np.min(self.points[:, 2]))

    @cached_property
    def top(self) -> float:
        """Height of the highest point."""
        return float(np.max(self.points[:, 2]))

    @cached_property
    def reach(self) -> float:
        """Radius of the upright cylinder around the centre of mass that holds the shape."""
        return float(np.sqrt(np.max(np.sum(self.points[:, :2] ** 2, axis=1))))

    @cached_property
    def base(self) -> Float[np.ndarray, "corner 2"]:
        """The lowest points, seen from above."""
        return self.points[self.points[:, 2] < self.bottom + _SUPPORT_DEPTH, :2]

    @cached_property
    def roof(self) -> Float[np.ndarray, "corner 2"]:
        """The highest points, seen from above."""
        return self.points[self.points[:, 2] > self.top - _SUPPORT_DEPTH, :2]

    @property
    def is_steady(self) -> bool:
        """Whether the shape keeps this orientation when set down."""
        return depth_inside(self.base, np.zeros(2)) > STEADY

    def turned(self, yaw: float) -> "Stance":
        """Copy of this stance, turned about the vertical by `yaw` radians."""
        return Stance(self.shape, about_vertical(yaw) @ self.rotation)


def depth_inside(outline: Float[np.ndarray, "corner 2"], point: Float[np.ndarray, "2"]) -> float:
    """Distance of a point from the edge of the convex hull of some corners, metres; negative outside."""
    return float(np.min(np.max((outline - point) @ _DIRECTIONS, axis=0)))


def extent(stance: Stance, direction: Float[np.ndarray, "2"]) -> float:
    """Largest extent of a shape from its centre of mass along a horizontal unit vector, metres."""
    return float(np.max(stance.points[:, :2] @ direction))


def upright(shape: Shape) -> Stance:
    """The shape with its main axis up; a mesh is tilted a little if it rests on a facet of its hull then."""
    for stance in steady_stances(shape) if shape.resting else ():
        if stance.rotation[2, 2] > _UPRIGHT:
            # The smallest rotation that does it keeps the heading.
            return Stance(shape, _tilted(stance.rotation[2]))
    return Stance(shape, np.eye(3))


@lru_cache(maxsize=64)
def steady_stances(shape: Shape) -> list[Stance]:
    """All steady orientations in which an axis of the object frame or of the smallest box points down."""
    if shape.resting:
        return _resting_stances(shape)
    axes = np.eye(3)
    if not np.allclose(np.abs(shape.minimum_box.rotation).max(axis=0), 1):
        axes = np.concatenate([axes, shape.minimum_box.rotation.T])
    stances = [Stance(shape, _with_up(sign * axis)) for axis in axes for sign in (1.0, -1.0)]
    return [stance for stance in stances if stance.is_steady]


def _resting_stances(shape: Shape) -> list[Stance]:
    """Steady orientations of a mesh, the most upright first."""
    stances = [Stance(shape, _with_up(-np.array(down))) for down in shape.resting]
    return sorted((x for x in stances if x.is_steady), key=lambda stance: -stance.rotation[2, 2])


def can_roll(shape: Shape) -> bool:
    """Whether the shape is round about its main axis and, laid on its side, touches the ground beside its middle."""
    if shape.symmetry == "SO3":
        return True
    if not shape.symmetry.endswith("inf"):
        return False
    along_axis = rolling_stance(shape).base[:, 1]
    return bool(np.min(along_axis) < 1e-3 and np.max(along_axis) > -1e-3)


def rolling_stance(shape: Shape) -> Stance:
    """The shape on its side, ready to roll along x."""
    return Stance(shape, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))


def tumbled(shape: Shape, rng: np.random.Generator) -> Stance:
    """The shape in any orientation, all equally likely."""
    return Stance(shape, rotation_from_quaternion(rng.normal(size=4)))


def about_vertical(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about world z by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _tilted(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation that brings a unit vector of the object frame to world z."""
    x, y, z = axis
    cross = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + z)


def _with_up(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A rotation that brings a unit vector of the object frame to world z."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    first = cross(helper, axis)
    first /= np.sqrt(np.sum(first**2))
    return np.stack([first, cross(axis, first), axis])
