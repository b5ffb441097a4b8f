"""What a scene is: plain frozen values, free of any engine, that survive a round trip through JSON.

A `Scene` says what is there before time starts; a `Trajectory` says where everything is in every frame. The two
together are all that a renderer needs.
"""

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from datagen.geometry import intrinsics, look_at, rigid

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Pattern = Literal["plain", "two-tone", "checker", "stripes", "noise", "wood", "dots"]
Motion = Literal["rest", "drop", "slide", "roll", "push", "throw"]


@dataclass(frozen=True)
class Material:
    """How a surface looks. Colours are sRGB in 0..1."""

    name: str
    """What it is meant to be, such as `rubber` or `metal`."""
    color: Vector
    """The first colour."""
    color2: Vector = (0.0, 0.0, 0.0)
    """The second colour, where the pattern has two."""
    pattern: Pattern = "plain"
    """How the two colours are laid out, as a solid texture in the object frame."""
    period: float = 0.02
    """Metres after which the pattern repeats."""
    axis: Vector = (0.0, 0.0, 1.0)
    """Unit vector in the object frame: normal of the two-tone plane, direction across the stripes."""
    roughness: float = 0.5
    """0 is a mirror, 1 is chalk."""
    metalness: float = 0.0
    """0 for dielectrics, 1 for metals."""


@dataclass(frozen=True)
class ShapeSpec:
    """A name from the catalog with the parameters that make one member of that family."""

    family: str
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Push:
    """A constant force on an object's centre of mass for a while."""

    start: float
    """Seconds after frame 0."""
    duration: float
    """Seconds."""
    force: Vector
    """Newton, world frame."""


@dataclass(frozen=True)
class Body:
    """One object: its shape, material and state when time starts (world frame, metres, seconds, kilograms)."""

    category: str
    shape: ShapeSpec
    material: Material
    density: float
    """Kilograms per cubic metre of solid."""
    friction: float
    restitution: float
    motion: Motion
    """What the sampler meant the object to do."""
    position: Vector
    """Of the centre of mass, the origin of the object frame."""
    quaternion_wxyz: Quaternion
    linear_velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)
    push: Push | None = None
    touches: int | None = None
    """Row of an earlier object that physics brings this one into contact with before time starts."""
    shape_id: int | None = None
    """Number of the shape in its category's pool, where the recipe draws from a pool."""


@dataclass(frozen=True)
class Camera:
    """An ideal camera; its image size is chosen when rendering.

    It is aimed at a frame, `field_of_view` wide and `aspect` times as wide as high. An image of that aspect shows this
    frame exactly, a wider one also what lies beside it, a higher one what lies above and below.
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
    """Radians; the softness of its shadows."""
    casts_shadow: bool = True


@dataclass(frozen=True)
class Table:
    """A square slab whose top is the plane z = 0, centred on the world's origin."""

    size: float
    """Side length in metres; beyond it there is nothing, and rays return no depth."""
    material: Material


@dataclass(frozen=True)
class Scene:
    """Everything that is there when time starts."""

    bodies: tuple[Body, ...]
    table: Table
    cameras: tuple[Camera, ...]
    lights: tuple[Light, ...]
    """The first one casts the shadow."""
    ambient: Vector
    """Linear RGB of the light that comes from everywhere."""
    backdrop: Vector
    """sRGB of what lies beyond the table."""
    frames: int
    fps: float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where the objects of a scene are in every frame. Rows of objects follow `Scene.bodies`; world frame."""

    position: Float[np.ndarray, "frame object 3"]
    """Of the centre of mass, metres, float32: renderers and labels use these very values."""
    quaternion_wxyz: Float[np.ndarray, "frame object 4"]
    linear_velocity: Float[np.ndarray, "frame object 3"]
    angular_velocity: Float[np.ndarray, "frame object 3"]
    contact_gap: Float[np.ndarray, "frame object+1 object+1"]
    """Distance in metres of the convex hulls that physics uses, negative where they overlap, inf beyond 2 cm.

    Within 3 mm of the distance of the true surfaces, exact for primitives; row and column 0 are the table.
    """
    contact_impulse: Float[np.ndarray, "frame object+1 object+1"]
    """Normal impulse exchanged since the frame before, newton seconds."""

    @property
    def world_from_object(self) -> Float[np.ndarray, "frame object 4 4"]:
        """Poses as float64 matrices."""
        return rigid(self.position, self.quaternion_wxyz)


def scene_to_json(scene: Scene) -> str:
    """Canonical text of a scene: equal scenes give equal text, and reading it back gives an equal scene."""
    return json.dumps(dataclasses.asdict(scene), separators=(",", ":"), allow_nan=False)


def scene_from_json(text: str) -> Scene:
    """Read what `scene_to_json` wrote.

    Raises:
        ValueError, KeyError or TypeError: the text is not the description of a scene.
    """
    data = json.loads(text)
    return Scene(
        bodies=tuple(_body(body) for body in data["bodies"]),
        table=Table(data["table"]["size"], _material(data["table"]["material"])),
        cameras=tuple(
            Camera(tuple(c["position"]), tuple(c["target"]), c["field_of_view"], c["aspect"]) for c in data["cameras"]
        ),
        lights=tuple(
            Light(tuple(x["direction"]), tuple(x["radiance"]), x["angular_radius"], x["casts_shadow"])
            for x in data["lights"]
        ),
        ambient=tuple(data["ambient"]),
        backdrop=tuple(data["backdrop"]),
        frames=data["frames"],
        fps=data["fps"],
    )


def _body(data: dict[str, Any]) -> Body:
    vectors = {
        name: tuple(data[name]) for name in ("position", "quaternion_wxyz", "linear_velocity", "angular_velocity")
    }
    push = data["push"]
    return Body(
        **{
            **data,
            **vectors,
            "shape": ShapeSpec(**data["shape"]),
            "material": _material(data["material"]),
            "push": push and Push(push["start"], push["duration"], tuple(push["force"])),
        }
    )


def _material(data: dict[str, Any]) -> Material:
    return Material(**{**data, **{name: tuple(data[name]) for name in ("color", "color2", "axis")}})
