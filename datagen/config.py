"""Recipes: every constant that decides what a dataset holds, as frozen dataclasses loaded from `assets/recipes/*.toml`.

A recipe file lists only the values that differ from the defaults below, which are those of the recipe `moving`.
"""

import dataclasses
import functools
import tomllib
from dataclasses import dataclass
from typing import Any, Literal

import assets
from datagen.errors import UsageError, unknown_name
from datagen.recipe_rules import OPTIONAL_RANGES, constants, problems

ADDED_LATER = (
    *OPTIONAL_RANGES,
    "layout.container_share",
    "lighting.exposure",
    "lighting.tint",
    *(f"rig.{name}" for name in ("motion", "orbit", "travel", "shake", "sway")),
    *(f"sensor.{name}" for name in ("device", "depth_step", "nearest", "farthest")),
)
"""Constants that datasets may lack: left out at their defaults, so that older datasets keep their identity."""

OF_THE_WHOLE = ("name", "description", "resolution", "parts", "overrides")
"""Fields of a recipe that its parts do not inherit."""


MESH_PREFIX = "mesh:"
"""Prefix of the names of meshes in `objects.categories`."""


@dataclass(frozen=True)
class Objects:
    """Number, categories, sizes and physical properties of the objects."""

    minimum: int = 2
    """Fewest objects in a scene; 0 allows empty scenes."""
    maximum: int = 4
    """Most objects in a scene."""
    categories: tuple[str, ...] = ()
    """Names from the catalog, or `mesh:NAME` of --assets, that objects are drawn from; empty means all of either."""
    size: tuple[float, float] = (0.03, 0.16)
    """Range of an object's longest side, metres."""
    sizes: tuple[float, ...] = ()
    """Allowed values of an object's longest side, metres; if not empty, they replace `size`, except for containers."""
    size_skew: float = 0.7
    """Exponent of the uniform draw between the sizes: 1 is uniform, below 1 favours large objects."""
    shape_pool: int = 0
    """Size N of each category's shape pool: train and val draw shapes 0 to N-1, test draws N to 2N-1; 0: no pool."""
    density: tuple[float, float] = (300.0, 1500.0)
    """Range of the density, kg/m^3, drawn evenly on a logarithmic scale."""
    friction: tuple[float, float] = (0.4, 0.9)
    """Range of the Coulomb friction coefficient; a contact uses the product of both bodies' coefficients."""
    restitution: tuple[float, float] = (0.1, 0.7)
    """Range of the coefficient of restitution; a contact uses the product of both bodies' coefficients."""


@dataclass(frozen=True)
class Layout:
    """Initial placement of the objects."""

    placement: Literal["scattered", "touching", "stacked"] = "scattered"
    """`scattered`: apart; `touching`: a group in contact moving as one; `stacked`: towers, and drops onto others."""
    stack_share: float = 0.4
    """Probability that an object of a group or tower lies on top of another instead of beside it."""
    center: tuple[float, float] = (-0.03, 0.0)
    """Middle of the region where objects start, metres on the table."""
    half_extent: tuple[float, float] = (0.18, 0.2)
    """Half sides of that region, metres."""
    container_share: float = 0.0
    """Probability that a bowl or an open box replaces an object, and others drop into it; not if `touching`. It is half
    to all of `objects.size[1]` long."""
    gap: float = 0.008
    """Least distance between scattered objects, metres."""
    upright_share: float = 0.6
    """Probability that an object on the table starts on its base; otherwise it starts on any face that carries it."""
    tries: int = 60
    """Places tried for one object before the sampled scene is rejected."""
    workspace_half_extent: tuple[float, float] = (0.33, 0.33)
    """Half sides of the region around `center` that no object may leave, metres."""
    table_size: float = 2.0
    """Side of the square table, metres."""
    table_sizes: tuple[float, ...] = ()
    """Least and greatest side of the table, metres; each scene draws its own. If empty, all have `table_size`."""


@dataclass(frozen=True)
class MotionWeights:
    """Relative frequency of each motion."""

    rest: float = 1.0
    """Weight of objects that lie still until something hits them."""
    drop: float = 1.2
    """Weight of objects that fall from rest and tumble when they land."""
    slide: float = 1.5
    """Weight of objects that start on the table with a velocity."""
    roll: float = 4.0
    """Weight of objects that roll without slipping; drawn for round shapes only."""
    push: float = 1.0
    """Weight of objects that start at rest and are driven by a horizontal force for a while."""
    throw: float = 0.6
    """Weight of objects that fly in an arc."""


@dataclass(frozen=True)
class MotionConfig:
    """Motion of the objects."""

    moving: bool = True
    """Whether objects move in the clip; if not, they rest from the first frame on."""
    weights: MotionWeights = MotionWeights()
    speed: tuple[float, float] = (0.4, 1.1)
    """Range of the initial speed for slide, roll and throw, and of the frictionless final speed of a push, m/s."""
    drop_height: tuple[float, float] = (0.03, 0.15)
    """Range of the free height under dropped or thrown objects, metres."""
    spin: float = 6.0
    """Largest angular speed of dropped or thrown objects, rad/s."""
    push_start: tuple[float, float] = (0.0, 0.25)
    """Range of the start of a push, seconds after frame 0."""
    push_duration: tuple[float, float] = (0.1, 0.3)
    """Range of the duration of a push, seconds."""
    aim_share: float = 0.6
    """Probability that a sliding, rolling, thrown or pushed object is aimed at another object."""
    least_travel: float = 0.03
    """Least distance that at least one object of a clip travels between its first and last frame, metres."""
    contact_gap: float = 0.005
    """Gap below which two objects count as touching, metres; used if the placement is `touching`."""
    contact_share: float = 0.8
    """Share of frames in which one and the same pair of objects must touch; used if the placement is `touching`."""
    rest_speed: float = 0.01
    """Largest speed of any surface point when the picture is taken, m/s; used if `moving` is false."""


@dataclass(frozen=True)
class Appearance:
    """Appearance of objects and table."""

    style: Literal["varied", "same-colour", "two-colour", "textured"] = "varied"
    """Style of the scenes: `varied` mixes all looks; the others serve the recipes of the same names."""
    one_hue_share: float = 0.0
    """Share of scenes in which all objects share one narrow hue."""
    hue_width: float = 0.03
    """Width of that hue range as a share of the colour circle."""
    metal_share: float = 0.2
    """Share of objects made of metal."""
    pattern_share: float = 0.4
    """Share of objects with two colours if the style is `varied`."""
    table_textures: bool = True
    """Whether tables may have a pattern."""
    table_color: str = ""
    """Colour of every table, such as `#808080`; empty means a random one."""
    palette: tuple[str, ...] = ()
    """Allowed colours of objects, such as `#ad2323`; empty means random ones."""
    finishes: tuple[Literal["rubber", "plastic", "ceramic"], ...] = ("rubber", "plastic", "ceramic")
    """Materials of the objects that are not metal."""


@dataclass(frozen=True)
class Rig:
    """Cameras of a scene."""

    distance: float = 1.03
    """Distance from the camera to the point it looks at, metres; nothing may come nearer to the camera than 5 cm."""
    elevation: float = 55.0
    """Angle by which the camera looks down, degrees; the camera must stand above the table's top."""
    field_of_view: float = 40.0
    """Horizontal angle of a frame with the aspect of `visibility_resolution`, degrees; other aspects show more."""
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point the first camera looks at, metres; other views are the first one, turned about the world's z axis."""
    azimuth: float = 0.0
    """Angle of the first camera about the world's z axis, seen from its target, degrees; at 0 it looks along -x."""
    jitter: float = 0.0
    """Standard deviation of each camera's position along each axis, metres."""
    distances: tuple[float, ...] = ()
    """Least and greatest distance, metres; each scene draws its own. If empty, all have `distance`."""
    elevations: tuple[float, ...] = ()
    """Least and greatest elevation, degrees; each scene draws its own. If empty, all have `elevation`."""
    azimuths: tuple[float, ...] = ()
    """Least and greatest azimuth, degrees; each scene draws its own. If empty, all have `azimuth`."""
    fields_of_view: tuple[float, ...] = ()
    """Least and greatest field of view, degrees; each scene draws its own. If empty, all have `field_of_view`."""
    motion: Literal["still", "orbit", "linear", "handheld"] = "still"
    """Motion of the cameras in a clip: none, around the vertical through their target, straight, or a hand's tremor."""
    orbit: float = 30.0
    """Angle that an orbit covers from the first to the last frame, degrees; negative is clockwise from above."""
    travel: tuple[float, float, float] = (0.0, 0.2, 0.0)
    """Straight way from the first to the last frame, metres; the camera keeps looking at its target."""
    shake: float = 0.01
    """Standard deviation of a handheld camera's position along each axis, metres, in waves of 0.3 to 2 Hz."""
    sway: float = 1.0
    """Standard deviation of a handheld camera's rotation about each axis, degrees."""


@dataclass(frozen=True)
class Lighting:
    """Lights of a scene."""

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
    """Range of the ambient light, which comes from everywhere."""
    exposure: tuple[float, float] = (1.0, 1.0)
    """Range of the factor of all light, drawn evenly on a logarithmic scale: the exposure of the cameras."""
    tint: float = 0.0
    """Standard deviation of the logarithm of a factor of each colour of all light: errors of the white balance."""


@dataclass(frozen=True)
class Physics:
    """The simulator's constants."""

    step: float = 1 / 480
    """Longest time step, seconds; at 1/240 flat objects that slide dip 5 mm into the table, at 1/480 1 mm."""
    gravity: float = 9.81
    """Gravitational acceleration, m/s^2."""
    table_friction: float = 0.5
    """Coulomb coefficient of the table; a contact uses the product of both bodies' coefficients."""
    table_restitution: float = 0.7
    """Bounciness of the table."""
    rolling_friction: float = 0.0005
    """Coefficient in metres: torque against rolling = this x normal force x sum of both Coulomb coefficients."""
    spinning_friction: float = 0.001
    """Coefficient in metres: torque against spinning = this x normal force x sum of both Coulomb coefficients."""
    deepest_overlap: float = 0.001
    """Deepest allowed overlap of two bodies at the start, metres."""
    deepest_in_motion: float = 0.002
    """Deepest allowed overlap of two bodies, or of a body and the table, in any later frame, metres."""
    settle_seconds: float = 0.0
    """Seconds simulated before frame 0, so that stacked or dropped objects come to rest."""


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
    """Angle between ray and surface normal above which returns become less likely, degrees, 0 to 90."""
    dark_reflectance: float = 0.05
    """Linear reflectance below which returns become less likely."""
    quantisation: float = 0.001
    """Depth step at 1 m, metres; grows with the square of depth."""
    device: str = ""
    """Name of the preset that these constants come from; see `datagen.sensor_presets`."""
    depth_step: float = 0.0
    """Depth step at any distance, metres, such as 0.001 for whole millimetres; 0: none."""
    nearest: float = 0.0
    """Depth up to which nothing returns, metres."""
    farthest: float = 10.0
    """Depth from which nothing returns, metres."""


@dataclass(frozen=True)
class Recipe:
    """One kind of dataset."""

    name: str = "moving"
    """Name of the recipe."""
    description: str = ""
    """Purpose of the recipe."""
    frames: int = 10
    """Frames in a clip, 1 to 10,000; the limits of all constants are in docs/dataset.md."""
    fps: float = 12.0
    """Frames per second."""
    views: int = 1
    """Cameras, 1 to 360; more than one are spread evenly around the world's z axis."""
    resolution: tuple[int, int] = (128, 128)
    """Width and height in pixels."""
    least_visible_pixels: int = 20
    """Fewest pixels that every object must show in every view of frame 0."""
    visibility_resolution: tuple[int, int] = (128, 128)
    """Width and height at which `least_visible_pixels` are counted, whatever the resolution of the dataset.

    Cameras are aimed at a frame of this aspect, and every image shows all of that frame.
    """
    attempts: int = 200
    """Samples drawn for one scene before the recipe counts as impossible."""
    parts: tuple[str, ...] = ()
    """Recipes that scenes are drawn from in turn: scene i from part i mod their number."""
    overrides: tuple[str, ...] = ()
    """Dotted names, such as `rig.distance`, of constants that parts inherit even if they equal the defaults."""
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
    def needs_meshes(self) -> bool:
        """Whether the recipe names meshes, which the user has to provide."""
        return any(name.startswith(MESH_PREFIX) for name in self.objects.categories)

    @property
    def video(self) -> bool:
        """Whether clips have more than one frame."""
        return self.frames > 1

    @property
    def most_objects(self) -> int:
        """Largest number of objects of a scene of the recipe or its parts."""
        return max(self.for_scene(index).objects.maximum for index in range(max(1, len(self.parts))))

    def for_scene(self, index: int) -> "Recipe":
        """The recipe that scene `index` of a split follows: itself, or one of its parts.

        Constants of this recipe that differ from the defaults, or that its `overrides` name, apply to its parts too.
        """
        return _part(self, self.parts[index % len(self.parts)]) if self.parts else self


@functools.lru_cache(maxsize=64)
def _part(whole: Recipe, name: str) -> Recipe:
    own = _difference(dataclasses.asdict(whole), dataclasses.asdict(Recipe()), set(whole.overrides))
    own = {key: value for key, value in own.items() if key not in OF_THE_WHOLE}
    return recipe_from_dict(_merge(dataclasses.asdict(load_recipe(name)), own))


def _difference(values: dict[str, Any], defaults: dict[str, Any], kept: set[str], prefix: str = "") -> dict[str, Any]:
    """Nested dict of the values that differ from the defaults or whose dotted name is in `kept`."""
    changed = {}
    for key, value in values.items():
        if isinstance(value, dict):
            changed[key] = _difference(value, defaults[key], kept, f"{prefix}{key}.")
        elif value != defaults.get(key) or prefix + key in kept:
            changed[key] = value
    return changed


def _merge(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = {k: _merge(values[k], v) if isinstance(v, dict) else v for k, v in changes.items()}
    return {**values, **merged}


def constant_names(recipe: Recipe) -> list[str]:
    """Dotted names of all constants that parts may inherit."""
    return [name for name, _ in constants(dataclasses.asdict(recipe)) if name not in OF_THE_WHOLE]


def recipe_names() -> list[str]:
    """Names of all recipes that ship with the package."""
    return sorted(path.stem for path in assets.RECIPES.glob("*.toml"))


def names_without_meshes() -> list[str]:
    """Names of the recipes that need no files of the user."""
    return [name for name in recipe_names() if not load_recipe(name).needs_meshes]


@functools.cache
def load_recipe(name: str) -> Recipe:
    """Load the recipe of a given name.

    Raises:
        UsageError: there is no such recipe; suggests the nearest names.
    """
    if name not in recipe_names():
        raise unknown_name("recipe", name, recipe_names())
    text = (assets.RECIPES / f"{name}.toml").read_text(encoding="utf-8")
    return recipe_from_dict({"name": name, **tomllib.loads(text)})


def recipe_from_dict(data: dict[str, Any]) -> Recipe:
    """Build a recipe from nested plain values; missing keys keep their defaults.

    Raises:
        UsageError: a key is not a field of a recipe, or a value is impossible.
        ValueError: a value has another type.
    """
    from datagen.storage.structure import UnknownKeys, strict_converter, structure  # late: readers need no cattrs

    try:
        return structure(data, Recipe, strict_converter(), "recipe")
    except UnknownKeys as error:
        raise UsageError(f"The recipe has unknown constants: {error}.") from None


def recipe_to_dict(recipe: Recipe) -> dict[str, Any]:
    """Convert a recipe to nested plain values; `recipe_from_dict` turns them back into an equal recipe."""
    values, defaults = dataclasses.asdict(recipe), dataclasses.asdict(Recipe())
    for group, _, name in (path.partition(".") for path in ADDED_LATER):
        if values[group][name] == defaults[group][name]:
            del values[group][name]
    return values
