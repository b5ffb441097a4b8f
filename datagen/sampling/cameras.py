"""Cameras and lights of a scene."""

from dataclasses import replace

import numpy as np

from datagen.config import Lighting, Recipe, Rig
from datagen.recipe_rules import OPTIONAL_RANGES
from datagen.sampling.camera_paths import camera_path
from datagen.sampling.poses import about_vertical
from datagen.scene import Camera, Light, Scene, rounded, vector


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
