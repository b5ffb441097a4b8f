"""Scenes as plain frozen values that depend on no engine and survive a round trip through JSON.

A `Scene` describes everything before time starts. A `Trajectory` holds the poses of all objects in every frame.
Together they are all that a renderer needs.
"""

import dataclasses
import json
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from datagen.geometry import intrinsics, look_at, rigid
from datagen.storage.safe_io import parse_json
from datagen.storage.structure import strict_converter, structure

_MOST = 1e6
"""Largest number in the description of a scene."""
_MOST_FORCE = 1e13
"""Largest force in newton: recipes allow objects of 10 m and 30,000 kg/m^3 that reach 100 m/s in a millisecond."""
_MOST_PARAMETER = 10.0
"""Largest number in the parameters of a shape, be it metres or a number of parts; recipes allow no larger objects."""
_MOST_PARAMETERS = 1000
"""Largest number of values in one parameter of a shape."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Pattern = Literal["plain", "two-tone", "checker", "stripes", "noise", "wood", "dots", "image"]
Motion = Literal["rest", "drop", "slide", "roll", "push", "throw"]


@dataclass(frozen=True)
class Material:
    """Appearance of a surface. Colours are sRGB in 0..1."""

    name: str
    """Name of the material, such as `rubber` or `metal`."""
    color: Vector
    """The first colour."""
    color2: Vector = (0.0, 0.0, 0.0)
    """The second colour, used by patterns with two colours."""
    pattern: Pattern = "plain"
    """Arrangement of the two colours, a solid texture in the object frame; `image`: the mesh's own colours."""
    period: float = 0.02
    """Period of the pattern, metres."""
    axis: Vector = (0.0, 0.0, 1.0)
    """Unit vector in the object frame: normal of the two-tone plane, direction across the stripes."""
    roughness: float = 0.5
    """Roughness from 0 (mirror) to 1 (chalk)."""
    metalness: float = 0.0
    """Metalness: 0 for dielectrics, 1 for metals."""


@dataclass(frozen=True)
class ShapeSpec:
    """A name from the catalog with the parameters that make one member of that family."""

    family: str
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Push:
    """A constant force on an object's centre of mass for a while."""

    start: float
    """Start of the push, seconds after frame 0."""
    duration: float
    """Duration of the push, seconds."""
    force: Vector
    """Force vector, newton, world frame."""


@dataclass(frozen=True)
class Body:
    """One object: its shape, material and state when time starts (world frame, metres, seconds, kilograms)."""

    category: str
    shape: ShapeSpec
    material: Material
    density: float
    """Density of the solid, kg/m^3."""
    friction: float
    restitution: float
    motion: Motion
    """Motion that the sampler intended for the object."""
    position: Vector
    """Position of the centre of mass, which is the origin of the object frame."""
    quaternion_wxyz: Quaternion
    linear_velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)
    push: Push | None = None
    touches: int | None = None
    """Row of an earlier object; the physics engine brings this one into contact with it before time starts."""
    shape_id: int | None = None
    """Number of the shape in its category's pool; None if the recipe has no pool."""


@dataclass(frozen=True)
class Lens:
    """Camera matrix for images of one size; other sizes scale it along each axis."""

    width: int
    height: int
    """Size of the images that the other numbers refer to, pixels."""
    fx: float
    fy: float
    """Focal lengths, pixels."""
    cx: float
    cy: float
    """Principal point, pixels; the centre of pixel (0, 0) is at 0.5."""


@dataclass(frozen=True)
class CameraPose:
    """Pose of a camera in one frame, OpenCV axes, world frame."""

    position: Vector
    """Position, metres."""
    quaternion_wxyz: Quaternion


@dataclass(frozen=True)
class Camera:
    """An ideal camera; its image size is chosen when rendering.

    The camera is aimed at a frame with horizontal angle `field_of_view` and ratio `aspect` of width to height. An image
    of that aspect shows exactly this frame. A wider image also shows the sides, a higher one the areas above and below.
    A camera with a `lens` has that camera matrix instead, and one with a `path` has those poses instead.
    """

    position: Vector
    target: Vector
    field_of_view: float
    """Horizontal angle of the frame, radians."""
    aspect: float = 1.0
    """Width over height of the frame."""
    lens: Lens | None = None
    """Camera matrix that replaces `field_of_view` and `aspect`."""
    path: tuple[CameraPose, ...] = ()
    """One pose for all frames, or one for each; they replace `position` and `target`, which are those of frame 0."""

    @property
    def moves(self) -> bool:
        """Whether the camera has a pose for each frame."""
        return len(self.path) > 1

    def at(self, frame: int) -> "Camera":
        """The camera as it is in one frame."""
        return replace(self, path=(self.path[frame],)) if self.moves else self

    @property
    def world_from_camera(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the camera in frame 0, OpenCV axes."""
        if self.path:
            return rigid(np.array(self.path[0].position), np.array(self.path[0].quaternion_wxyz))
        return look_at(np.array(self.position), np.array(self.target))

    def k(self, width: int, height: int) -> Float[np.ndarray, "3 3"]:
        """Camera matrix in pixels for an image of the given size."""
        if self.lens is not None:
            x, y = width / self.lens.width, height / self.lens.height
            row = [self.lens.fx * x, 0.0, self.lens.cx * x], [0.0, self.lens.fy * y, self.lens.cy * y]
            return np.array([*row, [0.0, 0.0, 1.0]])
        k = intrinsics(self.field_of_view, width, height)
        k[:2, :2] *= min(1.0, height * self.aspect / width)
        return k


@dataclass(frozen=True)
class Light:
    """A distant light."""

    direction: Vector
    """Unit vector towards the light, world frame."""
    radiance: Vector
    """Linear RGB irradiance on a surface that faces the light, 1 being white."""
    angular_radius: float
    """Angular radius of the light's disc, radians; larger ones give softer shadows."""
    casts_shadow: bool = True


@dataclass(frozen=True)
class Table:
    """A square slab whose top is the plane z = 0, centred on the world's origin."""

    size: float
    """Side length, metres; rays that miss the table and all objects return no depth."""
    material: Material


@dataclass(frozen=True)
class Scene:
    """Everything in the scene when time starts."""

    bodies: tuple[Body, ...]
    table: Table
    cameras: tuple[Camera, ...]
    lights: tuple[Light, ...]
    """Lights of the scene; the first one casts the shadow."""
    ambient: Vector
    """Linear RGB of the light that comes from everywhere."""
    backdrop: Vector
    """sRGB colour of the background beyond the table."""
    frames: int
    fps: float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses, velocities and contacts of a scene's objects in every frame, world frame; rows follow `Scene.bodies`."""

    position: Float[np.ndarray, "frame object 3"]
    """Position of the centre of mass, metres, float32; renderers and labels use exactly these values."""
    quaternion_wxyz: Float[np.ndarray, "frame object 4"]
    linear_velocity: Float[np.ndarray, "frame object 3"]
    angular_velocity: Float[np.ndarray, "frame object 3"]
    contact_gap: Float[np.ndarray, "frame object+1 object+1"]
    """Distance between the convex hulls that physics uses, metres; negative if they overlap, inf beyond 2 cm.

    The distance of the true surfaces differs by at most 3 mm; for primitives it is equal. Row and column 0: the table.
    """
    contact_impulse: Float[np.ndarray, "frame object+1 object+1"]
    """Normal impulse exchanged since the previous frame, newton seconds."""

    @property
    def world_from_object(self) -> Float[np.ndarray, "frame object 4 4"]:
        """Poses as float64 matrices."""
        return rigid(self.position, self.quaternion_wxyz)


def scene_to_json(scene: Scene) -> str:
    """Serialise a scene to canonical JSON: equal scenes give equal text, and reading it back gives an equal scene."""
    values = plain(scene)
    for camera in values["cameras"]:
        # Descriptions of cameras without a lens or a path keep the text that they had before there were any.
        for name in ("lens", "path"):
            if not camera[name]:
                del camera[name]
    return json.dumps(values, separators=(",", ":"), allow_nan=False)


def plain(value: Any) -> Any:
    """Dicts of the fields of a dataclass and of those in it: `dataclasses.asdict` without copies of the values."""
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    if dataclasses.is_dataclass(value):
        return {name: plain(item) for name, item in vars(value).items()}
    return value


def scene_from_json(text: str) -> Scene:
    """Parse text written by `scene_to_json`.

    Raises:
        ValueError: the text is not the description of a scene.
    """
    return structure(parse_json(text), Scene, _CONVERTER)


def _check_parameter(value: Any) -> Any:
    """Check a parameter of a shape: a text, a number, or a nested list of these."""
    if isinstance(value, list):
        if len(value) > _MOST_PARAMETERS:
            raise ValueError(f"a parameter of a shape has {len(value)} values, expected at most {_MOST_PARAMETERS}")
        return [_check_parameter(item) for item in value]
    return value if isinstance(value, str) else _PARAMETERS.structure(value, float)


def _shape(values: Any, _kind: type) -> ShapeSpec:
    plain = structure(values, _PlainShape, _CONVERTER)
    if plain.family == "mesh":  # its scale is no length
        return ShapeSpec(plain.family, dict(vars(structure(plain.parameters, _MeshParameters, _CONVERTER))))
    return ShapeSpec(plain.family, {name: _check_parameter(value) for name, value in plain.parameters.items()})


@dataclass(frozen=True)
class _PlainShape:
    """A `ShapeSpec` whose parameters are unchecked."""

    family: str
    parameters: dict[str, Any]


@dataclass(frozen=True)
class _MeshParameters:
    """Parameters of a mesh from a file."""

    file: str
    sha256: str
    scale: float
    up: str


_CONVERTER = strict_converter(_MOST).copy()
_FORCES, _PARAMETERS = strict_converter(_MOST_FORCE), strict_converter(_MOST_PARAMETER)
_CONVERTER.register_structure_hook(Push, lambda values, _kind: structure(values, Push, _FORCES))
_CONVERTER.register_structure_hook(ShapeSpec, _shape)


DIGITS = 6
"""Decimals that a scene's numbers keep, so that its text stays short."""


def rounded(value: float) -> float:
    """Round a number to the digits of a scene's description."""
    return round(float(value), DIGITS)


def vector(values: Iterable[float]) -> Vector:
    """Round three numbers, see `rounded`."""
    x, y, z = (rounded(value) for value in values)
    return x, y, z
