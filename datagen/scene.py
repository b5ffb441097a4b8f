"""Scenes as plain frozen values that depend on no engine and survive a round trip through JSON.

A `Scene` describes everything before time starts. A `Trajectory` holds the poses of all objects in every frame.
Together they are all that a renderer needs.
"""

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from datagen.geometry import intrinsics, look_at, rigid
from datagen.storage.safe_io import parse_json

_MOST = 1e6
"""Largest number in the description of a scene."""
_MOST_FORCE = 1e13
"""Largest force in newton: recipes allow objects of 10 m and 30,000 kg/m^3 that reach 100 m/s in a millisecond."""
_MOST_PARAMETER = 10
"""Largest number in the parameters of a shape, be it metres or a number of parts; recipes allow no larger objects."""
_MOST_PARAMETERS = 1000
"""Largest number of values in one parameter of a shape."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Pattern = Literal["plain", "two-tone", "checker", "stripes", "noise", "wood", "dots"]
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
    """Arrangement of the two colours, a solid texture in the object frame."""
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
class Camera:
    """An ideal camera; its image size is chosen when rendering.

    The camera is aimed at a frame with horizontal angle `field_of_view` and ratio `aspect` of width to height. An image
    of that aspect shows exactly this frame. A wider image also shows the sides, a higher one the areas above and below.
    """

    position: Vector
    target: Vector
    field_of_view: float
    """Horizontal angle of the frame, radians."""
    aspect: float = 1.0
    """Width over height of the frame."""

    @property
    def world_from_camera(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the camera, OpenCV axes."""
        return look_at(np.array(self.position), np.array(self.target))

    def k(self, width: int, height: int) -> Float[np.ndarray, "3 3"]:
        """Camera matrix in pixels for an image of the given size."""
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
    return json.dumps(dataclasses.asdict(scene), separators=(",", ":"), allow_nan=False)


def scene_from_json(text: str) -> Scene:
    """Parse text written by `scene_to_json`.

    Raises:
        ValueError, KeyError or TypeError: the text is not the description of a scene.
    """
    data = parse_json(text)
    return Scene(
        bodies=tuple(_body(body) for body in data["bodies"]),
        table=Table(_number(data["table"]["size"]), _material(data["table"]["material"])),
        cameras=tuple(
            Camera(
                _numbers(c["position"], 3), _numbers(c["target"], 3), _number(c["field_of_view"]), _number(c["aspect"])
            )
            for c in data["cameras"]
        ),
        lights=tuple(
            Light(
                _numbers(x["direction"], 3),
                _numbers(x["radiance"], 3),
                _number(x["angular_radius"]),
                bool(x["casts_shadow"]),
            )
            for x in data["lights"]
        ),
        ambient=_numbers(data["ambient"], 3),
        backdrop=_numbers(data["backdrop"], 3),
        frames=int(_number(data["frames"])),
        fps=_number(data["fps"]),
    )


def _body(data: dict[str, Any]) -> Body:
    sizes = {"position": 3, "quaternion_wxyz": 4, "linear_velocity": 3, "angular_velocity": 3}
    numbers = {name: _number(data[name]) for name in ("density", "friction", "restitution")}
    rows = {name: data[name] if data[name] is None else int(_number(data[name])) for name in ("touches", "shape_id")}
    push = data["push"]
    return Body(
        **{
            **data,
            **rows,
            **{name: _numbers(data[name], size) for name, size in sizes.items()},
            **numbers,
            "category": _word(data["category"]),
            "shape": _shape(data["shape"]),
            "material": _material(data["material"]),
            "motion": _one_of(data["motion"], Motion),
            "push": push and _push(push),
        }
    )


def _push(data: dict[str, Any]) -> Push:
    return Push(_number(data["start"]), _number(data["duration"]), _numbers(data["force"], 3, _MOST_FORCE))


def _shape(data: dict[str, Any]) -> ShapeSpec:
    spec = ShapeSpec(**data)
    _word(spec.family)
    for value in spec.parameters.values():
        _check_parameter(value)
    return spec


def _check_parameter(value: Any) -> None:
    if isinstance(value, list):
        if len(value) > _MOST_PARAMETERS:
            raise ValueError(f"a parameter of a shape has {len(value)} values, expected at most {_MOST_PARAMETERS}")
        for item in value:
            _check_parameter(item)
    elif not isinstance(value, str):
        _number(value, _MOST_PARAMETER)


def _material(data: dict[str, Any]) -> Material:
    numbers = {name: _number(data[name]) for name in ("period", "roughness", "metalness")}
    vectors = {name: _numbers(data[name], 3) for name in ("color", "color2", "axis")}
    names = {"name": _word(data["name"]), "pattern": _one_of(data["pattern"], Pattern)}
    return Material(**{**data, **numbers, **vectors, **names})


def _number(value: Any, most: int | float = _MOST) -> Any:
    if type(value) not in (int, float) or not abs(value) <= most:
        raise ValueError(f"it holds {value!r:.40}, expected a number up to {most:g}")
    return value


def _numbers(values: Any, count: int, most: int | float = _MOST) -> Any:
    if type(values) is not list or len(values) != count:
        raise ValueError(f"it holds {values!r:.40}, expected {count} numbers")
    return tuple(_number(value, most) for value in values)


def _word(value: Any) -> str:
    if type(value) is not str:
        raise ValueError(f"it holds {value!r:.40}, expected a text")
    return value


def _one_of(value: Any, literal: Any) -> Any:
    if value not in get_args(literal):
        raise ValueError(f"it holds {value!r:.40}, expected one of {', '.join(get_args(literal))}")
    return value
