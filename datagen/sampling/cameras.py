"""Cameras of a scene, their paths (orbits, straight lines and a hand's tremor), and its lights."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from datagen.config import Lighting, Recipe, Rig
from datagen.errors import UsageError
from datagen.geometry import look_at, quaternion_from_rotation
from datagen.recipe_rules import OPTIONAL_RANGES
from datagen.sampling.poses import about_vertical
from datagen.scene import Camera, CameraPose, Light, Scene, rounded, vector


def sample_cameras(recipe: Recipe, rng: np.random.Generator) -> tuple[Camera, ...]:
    """The rig's camera, and the same turned about the world's z axis for every further view.

    Their frame has the aspect in which the recipe judges visibility, whatever the images' aspect will be.
    """
    width, height = recipe.visibility_resolution
    rig = sample_rig(recipe.rig, rng)
    angles = [2 * np.pi * view / recipe.views for view in range(recipe.views)]
    cameras = tuple(_camera(rig, angle, width / height, rng) for angle in angles)
    if rig.motion == "still" or not recipe.video:
        return cameras
    # A child generator, so that scenes with and without motion of the cameras are the same otherwise.
    (own,) = rng.spawn(1)
    return tuple(camera_path(camera, recipe, angle, own) for camera, angle in zip(cameras, angles, strict=True))


def sample_rig(rig: Rig, rng: np.random.Generator) -> Rig:
    """Draw the constants of one scene's rig that have a range."""
    ranges = {name.removeprefix("rig."): default.removeprefix("rig.") for name, default in OPTIONAL_RANGES.items()}
    drawn = {
        default: rounded(rng.uniform(*getattr(rig, name))) for name, default in ranges.items() if getattr(rig, name, ())
    }
    return replace(rig, **drawn)


def _camera(rig: Rig, angle: float, aspect: float, rng: np.random.Generator) -> Camera:
    turn = about_vertical(angle)
    target = np.array(rig.target)
    offset = rig.distance * direction(np.radians(rig.azimuth), np.radians(rig.elevation))
    jitter = rig.jitter * rng.normal(size=3) if rig.jitter else np.zeros(3)
    position, field_of_view = vector(turn @ (target + offset) + jitter), float(np.radians(rig.field_of_view))
    return Camera(position, vector(turn @ target), field_of_view, aspect)


def direction(azimuth: float, elevation: float) -> np.ndarray:
    """Unit vector with an angle about world z and one above the horizon, radians."""
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def sample_lights(lighting: Lighting, rng: np.random.Generator) -> tuple[Light, Light]:
    """A key light from anywhere above, and a weaker, bluer one from across it that casts no shadow."""
    azimuth = rng.uniform(0, 2 * np.pi)
    warmth = rng.uniform(-0.06, 0.06)
    key = rng.uniform(*lighting.key) * np.array([1 + warmth, 1.0, 1 - warmth])
    fill = rng.uniform(*lighting.fill) * np.array([1 - warmth, 1.0, 1 + warmth])
    elevation = np.radians(rng.uniform(*lighting.elevation))
    across = azimuth + np.pi + rng.uniform(-1, 1)
    return (
        Light(
            vector(direction(azimuth, elevation)), vector(key), rounded(np.radians(lighting.softness)), lighting.shadows
        ),
        Light(vector(direction(across, np.radians(rng.uniform(25, 60)))), vector(fill), 0.0, casts_shadow=False),
    )


def sample_ambient(lighting: Lighting, rng: np.random.Generator) -> tuple[float, float, float]:
    """Linear RGB of the light from everywhere."""
    return vector(np.full(3, rng.uniform(*lighting.ambient)))


def exposed(scene: Scene, lighting: Lighting, rng: np.random.Generator) -> Scene:
    """The scene with all light times one factor per colour: the exposure and the white balance of its cameras."""
    if lighting.exposure == (1.0, 1.0) and not lighting.tint:
        return scene
    gain = np.exp(rng.uniform(*np.log(lighting.exposure)) + lighting.tint * rng.normal(size=3))
    backdrop = np.minimum(gain ** (1 / 2.2) * scene.backdrop, 1)
    lights = tuple(replace(light, radiance=vector(gain * light.radiance)) for light in scene.lights)
    return replace(scene, lights=lights, ambient=vector(gain * scene.ambient), backdrop=vector(backdrop))


TREMOR = (0.3, 2.0)
"""Range of the frequencies of a hand's tremor, Hz."""

WAVES = 3
"""Number of waves along and about each axis."""


def camera_path(camera: Camera, recipe: Recipe, angle: float, rng: np.random.Generator) -> Camera:
    """Give a camera a pose for each frame, starting with its own; `angle` is its view's about the vertical, radians.

    Raises:
        UsageError: the camera would pass its target, or be straight above it.
    """
    make = {"orbit": _orbit, "linear": _linear, "handheld": _handheld}[recipe.rig.motion]
    poses = make(camera, recipe, angle, rng)
    return replace(camera, path=tuple(_pose(pose) for pose in poses))


def _orbit(camera: Camera, recipe: Recipe, angle: float, rng: np.random.Generator) -> list[np.ndarray]:
    target, offset = np.array(camera.target), np.array(camera.position) - np.array(camera.target)
    turns = np.linspace(0, np.radians(recipe.rig.orbit), recipe.frames)
    return [look_at(target + about_vertical(turn) @ offset, target) for turn in turns]


def _linear(camera: Camera, recipe: Recipe, angle: float, rng: np.random.Generator) -> list[np.ndarray]:
    way = about_vertical(angle) @ np.array(recipe.rig.travel)
    target, shares = np.array(camera.target), np.linspace(0, 1, recipe.frames)
    try:
        return [look_at(np.array(camera.position) + share * way, target) for share in shares]
    except ValueError as error:
        raise UsageError(
            f"Recipe {recipe.name!r}: {error} Change --rig.travel, --rig.target or --rig.azimuth."
        ) from None


def _handheld(camera: Camera, recipe: Recipe, angle: float, rng: np.random.Generator) -> list[np.ndarray]:
    first, seconds = camera.world_from_camera, np.arange(recipe.frames) / recipe.fps
    poses = []
    for shift, turn in zip(_tremor(seconds, rng), _tremor(seconds, rng), strict=True):
        pose = first.copy()
        pose[:3, 3] += recipe.rig.shake * shift
        pose[:3, :3] = first[:3, :3] @ _rotation(np.radians(recipe.rig.sway) * turn)
        poses.append(pose)
    return poses


def _tremor(seconds: Float[np.ndarray, "frame"], rng: np.random.Generator) -> Float[np.ndarray, "frame 3"]:
    """Smooth noise along three axes with a standard deviation of one, relative to its first value."""
    speed, phase = 2 * np.pi * rng.uniform(*TREMOR, (WAVES, 3)), rng.uniform(0, 2 * np.pi, (WAVES, 3))
    noise = np.sum(np.sin(seconds[:, None, None] * speed + phase), axis=1) * np.sqrt(2 / WAVES)
    return noise - noise[0]


def _rotation(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation about the direction of a vector by its length in radians (Rodrigues)."""
    angle = np.sqrt(np.sum(vector * vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _pose(pose: Float[np.ndarray, "4 4"]) -> CameraPose:
    w, x, y, z = (rounded(value) for value in quaternion_from_rotation(pose[:3, :3]))
    return CameraPose(vector(pose[:3, 3]), (w, x, y, z))
