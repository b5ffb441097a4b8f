"""Recipes: every constant that decides what a dataset holds, as frozen dataclasses loaded from `assets/recipes/*.toml`.

A recipe file names only what differs from the defaults below. `moving` is the default for everything.
"""

import dataclasses
import difflib
import tomllib
import typing
from dataclasses import dataclass
from typing import Any, Literal

import assets
from datagen.errors import UsageError


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
    shape_pool: int = 0
    """Where positive: train and val draw shapes 0 to N-1 of each category, test draws shapes N to 2N-1; 0: no pool."""


@dataclass(frozen=True)
class Layout:
    """Where objects start."""

    placement: Literal["scattered", "touching", "stacked"] = "scattered"
    """`scattered`: apart; `touching`: at least one pair in contact; `stacked`: some on top of others."""
    center: tuple[float, float] = (0.28, 0.0)
    """Middle of the region where objects start, metres on the table."""
    half_extent: tuple[float, float] = (0.2, 0.22)
    """Half sides of that region, metres."""
    gap: float = 0.01
    """Least distance between scattered objects, metres."""
    workspace_half_extent: tuple[float, float] = (0.33, 0.36)
    """Half sides of the region around `center` that no object may leave, metres."""


@dataclass(frozen=True)
class MotionConfig:
    """What objects do."""

    moving: bool = True
    """Whether objects move in the clip; if not, they rest from the first frame on."""
    weights: dict[str, float] = dataclasses.field(
        default_factory=lambda: {"rest": 0.2, "drop": 0.2, "slide": 0.2, "roll": 0.15, "push": 0.15, "throw": 0.1}
    )
    """How often each motion is drawn."""
    speed: tuple[float, float] = (0.25, 0.8)
    """Initial speed of what slides, rolls or is thrown, m/s."""
    drop_height: tuple[float, float] = (0.03, 0.15)
    """Free height under what drops, metres."""
    least_travel: float = 0.03
    """At least one object of a clip travels this far between its first and last frame, metres."""
    together: bool = False
    """Whether objects that touch share one velocity."""


@dataclass(frozen=True)
class Appearance:
    """How objects and table look."""

    style: Literal["varied", "same-colour", "two-colour", "textured", "clevr"] = "varied"
    """`varied`: all of it; the others are what the recipes of these names need."""
    one_hue_share: float = 0.0
    """Share of scenes in which all objects share one narrow hue."""
    metal_share: float = 0.2
    """Share of objects made of metal."""
    table_textures: bool = True
    """Whether tables may have a pattern."""


@dataclass(frozen=True)
class Rig:
    """Cameras."""

    distance: float = 1.03
    """From the camera to the point it looks at, metres."""
    elevation: float = 55.0
    """Degrees that the camera looks down."""
    field_of_view: float = 40.0
    """Horizontal, degrees."""
    target: tuple[float, float, float] = (0.28, 0.0, 0.0)
    """The point that the camera looks at, metres."""
    azimuth: float = 0.0
    """Degrees about the world's z axis of the first camera as seen from its target; 0 looks along -x."""
    jitter: float = 0.0
    """Standard deviation of each camera's position, metres."""


@dataclass(frozen=True)
class Lighting:
    """Light."""

    shadows: bool = True
    """Whether the key light casts shadows."""
    softness: float = 2.5
    """Angular radius of the key light, degrees."""


@dataclass(frozen=True)
class Physics:
    """The simulator's constants."""

    step: float = 1 / 240
    """Seconds."""
    gravity: float = 9.81
    """m/s^2."""
    table_friction: float = 0.5
    """Coulomb coefficient of the table."""
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
    """Degrees between ray and surface normal from which on returns fade."""
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
    """Frames in a clip."""
    fps: float = 12.0
    """Frames per second."""
    views: int = 1
    """Cameras; more than one are spread evenly around the world's z axis."""
    resolution: tuple[int, int] = (128, 128)
    """Width and height in pixels."""
    least_visible_pixels: int = 20
    """Every object shows at least this many pixels in frame 0 at 128x128."""
    attempts: int = 200
    """Samples drawn for one scene before the recipe counts as impossible."""
    parts: tuple[str, ...] = ()
    """Recipes that scenes are drawn from in turn: scene i from part i mod their number."""
    objects: Objects = Objects()
    layout: Layout = Layout()
    motion: MotionConfig = MotionConfig()
    appearance: Appearance = Appearance()
    rig: Rig = Rig()
    lighting: Lighting = Lighting()
    physics: Physics = Physics()
    sensor: Sensor = Sensor()

    @property
    def video(self) -> bool:
        """Whether clips have more than one frame."""
        return self.frames > 1

    def for_scene(self, index: int) -> "Recipe":
        """The recipe that scene `index` of a split follows: itself, or one of its parts at this recipe's sizes."""
        if not self.parts:
            return self
        part = load_recipe(self.parts[index % len(self.parts)])
        shared = {name: getattr(self, name) for name in ("frames", "fps", "views", "resolution", "attempts")}
        return dataclasses.replace(part, **shared)


def recipe_names() -> list[str]:
    """Names of all recipes that ship with the package."""
    return sorted(path.stem for path in assets.RECIPES.glob("*.toml"))


def load_recipe(name: str) -> Recipe:
    """The recipe of that name.

    Raises:
        UsageError: there is none; suggests the nearest names.
    """
    if name not in recipe_names():
        near = difflib.get_close_matches(name, recipe_names(), n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise UsageError(f"Unknown recipe {name!r}; {hint}There are: {', '.join(recipe_names())}.")
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
