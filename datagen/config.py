"""Recipes: every constant that decides what a dataset holds, as frozen dataclasses loaded from `assets/recipes/*.toml`.

A recipe file names only what differs from the defaults below. `moving` is the default for everything.
"""

import dataclasses
import functools
import tomllib
import typing
from dataclasses import dataclass
from typing import Any, Literal

import assets
from datagen.errors import UsageError, unknown_name
from datagen.recipe_rules import constants, problems

OF_THE_WHOLE = ("name", "description", "resolution", "parts", "overrides")
"""What the parts of a recipe do not take over from it."""


@dataclass(frozen=True)
class Objects:
    """Which objects there are."""

    minimum: int = 2
    """Fewest objects in a scene."""
    maximum: int = 4
    """Most objects in a scene."""
    categories: tuple[str, ...] = ()
    """Names from the catalog that objects are drawn from; empty means all tabletop categories."""
    size: tuple[float, float] = (0.03, 0.16)
    """Shortest and longest allowed longest side, metres."""
    sizes: tuple[float, ...] = ()
    """Where not empty, every longest side is one of these, metres; `size` is then not used."""
    size_skew: float = 0.7
    """Power of a uniform draw between the sizes: 1 is even, below 1 favours large objects."""
    shape_pool: int = 0
    """Where positive: train and val draw shapes 0 to N-1 of each category, test draws shapes N to 2N-1; 0: no pool."""
    density: tuple[float, float] = (300.0, 1500.0)
    """Kilograms per cubic metre, drawn evenly on a logarithmic scale."""
    friction: tuple[float, float] = (0.4, 0.9)
    """Coulomb coefficient; that of a contact is the product of both bodies'."""
    restitution: tuple[float, float] = (0.1, 0.7)
    """Bounciness; that of a contact is the product of both bodies'."""


@dataclass(frozen=True)
class Layout:
    """Where objects start."""

    placement: Literal["scattered", "touching", "stacked"] = "scattered"
    """`scattered`: apart; `touching`: some in contact that move as one; `stacked`: towers, and drops onto others."""
    stack_share: float = 0.4
    """Chance that an object of a group or tower lies on top of another instead of beside it."""
    center: tuple[float, float] = (-0.03, 0.0)
    """Middle of the region where objects start, metres on the table."""
    half_extent: tuple[float, float] = (0.18, 0.2)
    """Half sides of that region, metres."""
    gap: float = 0.008
    """Least distance between scattered objects, metres."""
    upright_share: float = 0.6
    """Chance that an object that starts on the table stands on its base and not on any face that would carry it."""
    tries: int = 60
    """Places tried for one object before the scene's sample is given up."""
    workspace_half_extent: tuple[float, float] = (0.33, 0.33)
    """Half sides of the region around `center` that no object may leave, metres."""
    table_size: float = 2.0
    """Side of the square table, metres."""


@dataclass(frozen=True)
class MotionWeights:
    """How often each motion is drawn, relative to the others."""

    rest: float = 1.0
    """Lies still until something hits it."""
    drop: float = 1.2
    """Falls from rest, tumbling where it lands."""
    slide: float = 1.5
    """Starts on the table with a velocity."""
    roll: float = 4.0
    """Rolls without slipping; drawn for round shapes only."""
    push: float = 1.0
    """Starts at rest; a horizontal force drives it for a while."""
    throw: float = 0.6
    """Flies in an arc."""


@dataclass(frozen=True)
class MotionConfig:
    """What objects do."""

    moving: bool = True
    """Whether objects move in the clip; if not, they rest from the first frame on."""
    weights: MotionWeights = MotionWeights()
    speed: tuple[float, float] = (0.4, 1.1)
    """Initial speed of what slides, rolls or is thrown, and what a push reaches without friction, m/s."""
    drop_height: tuple[float, float] = (0.03, 0.15)
    """Free height under what drops or is thrown, metres."""
    spin: float = 6.0
    """Largest angular speed of what drops or is thrown, rad/s."""
    push_start: tuple[float, float] = (0.0, 0.25)
    """Seconds after frame 0."""
    push_duration: tuple[float, float] = (0.1, 0.3)
    """Seconds."""
    aim_share: float = 0.6
    """Chance that what slides, rolls, flies or is pushed is aimed at another object."""
    least_travel: float = 0.03
    """At least one object of a clip travels this far between its first and last frame, metres."""
    contact_gap: float = 0.005
    """Where the placement is `touching`: the gap below which two objects count as touching, metres."""
    contact_share: float = 0.8
    """Where the placement is `touching`: share of the frames in which at least one pair touches."""
    rest_speed: float = 0.01
    """Where nothing moves: the fastest any surface point may be when the picture is taken, m/s."""


@dataclass(frozen=True)
class Appearance:
    """How objects and table look."""

    style: Literal["varied", "same-colour", "two-colour", "textured"] = "varied"
    """`varied`: all of it; the others are what the recipes of these names need."""
    one_hue_share: float = 0.0
    """Share of scenes in which all objects share one narrow hue."""
    hue_width: float = 0.03
    """Width of that hue as a share of the colour circle."""
    metal_share: float = 0.2
    """Share of objects made of metal."""
    pattern_share: float = 0.4
    """Share of objects with two colours where the style is `varied`."""
    table_textures: bool = True
    """Whether tables may have a pattern."""
    table_color: str = ""
    """Where not empty: the colour of every table, such as `#808080`."""
    palette: tuple[str, ...] = ()
    """Where not empty: the colours that objects may have, such as `#ad2323`."""
    finishes: tuple[Literal["rubber", "plastic", "ceramic"], ...] = ("rubber", "plastic", "ceramic")
    """What objects are made of that are not of metal."""


@dataclass(frozen=True)
class Rig:
    """Cameras."""

    distance: float = 1.03
    """From the camera to the point it looks at, metres; nothing may come nearer to the camera than 5 cm."""
    elevation: float = 55.0
    """Degrees that the camera looks down; it must stand above the table's top."""
    field_of_view: float = 40.0
    """Horizontal, degrees, of a frame with the aspect of `visibility_resolution`; other images show more than that."""
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The point that the first camera looks at, metres; other views are this one, turned about the world's z axis."""
    azimuth: float = 0.0
    """Degrees about the world's z axis of the first camera as seen from its target; 0 looks along -x."""
    jitter: float = 0.0
    """Standard deviation of each camera's position along each axis, metres."""


@dataclass(frozen=True)
class Lighting:
    """Light."""

    shadows: bool = True
    """Whether the key light casts shadows."""
    softness: float = 2.5
    """Angular radius of the key light, degrees."""
    elevation: tuple[float, float] = (40.0, 75.0)
    """Range of the key light's height above the horizon, degrees."""
    key: tuple[float, float] = (0.75, 1.0)
    """Range of the key light's irradiance; 1 makes a white surface that faces it white."""
    fill: tuple[float, float] = (0.1, 0.25)
    """Range of the fill light's irradiance; it casts no shadow."""
    ambient: tuple[float, float] = (0.2, 0.3)
    """Range of the light from everywhere."""


@dataclass(frozen=True)
class Physics:
    """The simulator's constants."""

    step: float = 1 / 480
    """Longest time step, seconds; at 1/240 flat objects that slide dip 5 mm into the table, at 1/480 1 mm."""
    gravity: float = 9.81
    """m/s^2."""
    table_friction: float = 0.5
    """Coulomb coefficient of the table; that of a contact is the product of both bodies'."""
    table_restitution: float = 0.7
    """Bounciness of the table."""
    rolling_friction: float = 0.0005
    """Metres; the torque against rolling is this times the normal force times the sum of both Coulomb coefficients."""
    spinning_friction: float = 0.001
    """Metres; the same against spinning about the contact's normal."""
    deepest_overlap: float = 0.001
    """Two bodies may overlap by so much at the start, metres."""
    deepest_in_motion: float = 0.002
    """Two bodies, or one and the table, may overlap by so much in any later frame, metres."""
    settle_seconds: float = 0.0
    """Simulated before frame 0 so that what is stacked or dropped comes to rest."""


@dataclass(frozen=True)
class Sensor:
    """A depth camera's defects; see `datagen.sensor` for the model."""

    enabled: bool = False
    """Whether `sensor_depth` and `sensor_valid` are stored."""
    axial_noise: float = 0.0019
    """Standard deviation of depth at 1 m, metres; grows with the square of depth."""
    edge_dropout: float = 0.5
    """Share of pixels beside a depth edge that return nothing."""
    grazing_angle: float = 75.0
    """Degrees between ray and surface normal from which on returns fade, 0 to 90."""
    dark_reflectance: float = 0.05
    """Linear reflectance below which returns fade."""
    quantisation: float = 0.001
    """Depth step at 1 m, metres; grows with the square of depth."""


@dataclass(frozen=True)
class Recipe:
    """One kind of dataset."""

    name: str = "moving"
    """Name of the recipe."""
    description: str = ""
    """What it is for."""
    frames: int = 10
    """Frames in a clip, 1 to 10,000; the limits of all constants are in docs/dataset.md."""
    fps: float = 12.0
    """Frames per second."""
    views: int = 1
    """Cameras, 1 to 360; more than one are spread evenly around the world's z axis."""
    resolution: tuple[int, int] = (128, 128)
    """Width and height in pixels."""
    least_visible_pixels: int = 20
    """Every object shows at least this many pixels in every view of frame 0."""
    visibility_resolution: tuple[int, int] = (128, 128)
    """Width and height at which these pixels are counted, whatever the resolution of the dataset is.

    Cameras are aimed at a frame of this aspect, and every image shows all of that frame.
    """
    attempts: int = 200
    """Samples drawn for one scene before the recipe counts as impossible."""
    parts: tuple[str, ...] = ()
    """Recipes that scenes are drawn from in turn: scene i from part i mod their number."""
    overrides: tuple[str, ...] = ()
    """Dotted names of constants that parts take over even if they are the defaults, `rig.distance` being one."""
    objects: Objects = Objects()
    layout: Layout = Layout()
    motion: MotionConfig = MotionConfig()
    appearance: Appearance = Appearance()
    rig: Rig = Rig()
    lighting: Lighting = Lighting()
    physics: Physics = Physics()
    sensor: Sensor = Sensor()

    def __post_init__(self) -> None:
        if wrong := list(problems(dataclasses.asdict(self))):
            raise UsageError(f"Recipe {self.name!r} is impossible: {'; '.join(wrong)}.")

    @property
    def video(self) -> bool:
        """Whether clips have more than one frame."""
        return self.frames > 1

    def for_scene(self, index: int) -> "Recipe":
        """The recipe that scene `index` of a split follows: itself, or one of its parts.

        What differs from the defaults in this recipe, and what its `overrides` name, holds for its parts too.
        """
        return _part(self, self.parts[index % len(self.parts)]) if self.parts else self


@functools.lru_cache(maxsize=64)
def _part(whole: Recipe, name: str) -> Recipe:
    own = _difference(recipe_to_dict(whole), recipe_to_dict(Recipe()), set(whole.overrides))
    own = {key: value for key, value in own.items() if key not in OF_THE_WHOLE}
    return recipe_from_dict(_merge(recipe_to_dict(load_recipe(name)), own))


def _difference(values: dict[str, Any], defaults: dict[str, Any], kept: set[str], prefix: str = "") -> dict[str, Any]:
    """What differs from the defaults or is named in `kept`, nested in the same way."""
    changed = {}
    for key, value in values.items():
        if isinstance(value, dict):
            changed[key] = _difference(value, defaults[key], kept, f"{prefix}{key}.")
        elif value != defaults[key] or prefix + key in kept:
            changed[key] = value
    return changed


def _merge(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = {k: _merge(values[k], v) if isinstance(v, dict) else v for k, v in changes.items()}
    return {**values, **merged}


def constant_names(recipe: Recipe) -> list[str]:
    """Dotted names of all constants that parts may take over."""
    return [name for name, _ in constants(recipe_to_dict(recipe)) if name not in OF_THE_WHOLE]


def recipe_names() -> list[str]:
    """Names of all recipes that ship with the package."""
    return sorted(path.stem for path in assets.RECIPES.glob("*.toml"))


@functools.cache
def load_recipe(name: str) -> Recipe:
    """The recipe of that name.

    Raises:
        UsageError: there is none; suggests the nearest names.
    """
    if name not in recipe_names():
        raise unknown_name("recipe", name, recipe_names())
    text = (assets.RECIPES / f"{name}.toml").read_text(encoding="utf-8")
    return recipe_from_dict({"name": name, **tomllib.loads(text)})


def recipe_from_dict(data: dict[str, Any]) -> Recipe:
    """A recipe from nested plain values; what is not named keeps its default.

    Raises:
        UsageError: a key is not one of a recipe's.
    """
    return _from_dict(Recipe, data, "recipe")


def recipe_to_dict(recipe: Recipe) -> dict[str, Any]:
    """Plain values that `recipe_from_dict` turns into an equal recipe, and JSON into equal text."""
    return dataclasses.asdict(recipe)


def _from_dict(kind: type, data: dict[str, Any], where: str) -> Any:
    hints = typing.get_type_hints(kind)
    if unknown := sorted(set(data) - set(hints)):
        raise UsageError(f"Unknown keys in {where}: {', '.join(unknown)}; expected some of {', '.join(hints)}.")
    values = {}
    for key, value in data.items():
        if dataclasses.is_dataclass(hints[key]):
            value = _from_dict(typing.cast(type, hints[key]), value, f"{where}.{key}")
        elif isinstance(value, list):
            value = tuple(value)
        values[key] = value
    return kind(**values)
