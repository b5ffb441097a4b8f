"""Scenes that a model samples, as clips with labels of their own, and what they have in common with real ones."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from benchmark.clips import ClipSequence, TruthSequence
from benchmark.metrics import score
from benchmark.models.interface import Clip, Prediction, Segmenter
from benchmark.tasks.true_poses import world_points
from datagen.storage.reader import Split
from obpose.errors import UsageError
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.interface import ScenePrior
from obpose.scenes.priors.sample import sample_scene
from obpose.scenes.rendering import Image, Renderer
from obpose.scenes.scene import Camera, Scene

OPAQUE = 0.5
"""Share of a ray's light that must come from something for the pixel to have a depth."""
TRIES = 20
"""Of one scene, where there is no room for its objects."""
LEAST_PIXELS = 10
"""Of an object, for its size and colour to be measured."""


@dataclass(frozen=True, eq=False)
class Labelled:
    """One image with its labels, as a clip of one frame and one view; 0 is the background."""

    clip: Clip
    labels: Int[np.ndarray, "1 1 height width"]


@dataclass(frozen=True, eq=False)
class Looks:
    """Of the visible surfaces of objects."""

    scene: Int[np.ndarray, "object"]
    size: Float[np.ndarray, "object 3"]
    """Extents in metres: the longer and the shorter along the table's axes, then the height."""
    colour: Float[np.ndarray, "object 3"]
    """Mean, sRGB 0..1."""


def real_scenes(scenes: Split, count: int) -> list[Labelled]:
    """First view of the first frame of the first scenes."""
    clips, truths = ClipSequence(scenes), TruthSequence(scenes)
    return [_first_image(clips[i], truths[i].astype(np.int64)) for i in range(min(count, len(clips)))]


def sampled_scenes(origin: Origin, prior: ScenePrior, like: Sequence[Labelled], *, seed: int) -> Iterator[Labelled]:
    """One for each real scene, with its camera and as many objects as are in view there."""
    renderer, generator = Renderer(origin.model), torch.Generator().manual_seed(seed)
    for real in like:
        camera = _camera(real.clip)
        scene = _sample(origin, prior, len(np.unique(real.labels)) - 1, camera, generator)
        yield labelled(renderer.render(scene), camera)


def labelled(image: Image, camera: Camera) -> Labelled:
    """A rendered image as the benchmark's models see images, labelled by what most light comes from."""
    valid = (image.shares.sum(dim=0) > OPAQUE).numpy()
    clip = Clip(
        rgb=np.rint(255 * image.rgb.numpy()).astype(np.uint8)[None, None],
        depth=np.where(valid, image.depth.numpy(), 0).astype(np.float32)[None, None],
        valid=valid[None, None],
        k=camera.k.double().numpy()[None],
        world_from_camera=camera.world_from_camera.double().numpy()[None],
    )
    return Labelled(clip, (image.nearest.numpy() * valid).astype(np.int64)[None, None])


def mean_ari_fg(segmenter: Segmenter, scenes: Sequence[Labelled]) -> float:
    """Of a segmentation of each image, over those with objects; nan where none has any."""
    scores = np.array([ari_fg(segmenter.segment(scene.clip), scene) for scene in scenes])
    defined = scores[~np.isnan(scores)]
    return float(defined.mean()) if len(defined) else np.nan


def ari_fg(found: Prediction, scene: Labelled) -> float:
    """Agreement with the labels on objects' pixels."""
    return score(scene.labels[0], np.asarray(found.labels)[0], found.background, ~scene.clip.valid[0])["ari_fg"]


def looks(scenes: Sequence[Labelled]) -> Looks:
    """Of all objects of which enough is in view."""
    rows = [(index, *look) for index, scene in enumerate(scenes) for look in _looks(scene)]
    index, size, colour = zip(*rows, strict=True) if rows else ((), (), ())
    return Looks(np.array(index, int), np.array(size, float).reshape(-1, 3), np.array(colour, float).reshape(-1, 3))


def _looks(scene: Labelled) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    points = world_points(scene.clip)
    for name in np.unique(scene.labels[scene.labels > 0]):
        mine = (scene.labels == name) & scene.clip.valid
        if mine.sum() >= LEAST_PIXELS:
            x, y, z = np.ptp(points[mine], axis=0)
            yield np.array([max(x, y), min(x, y), z]), scene.clip.rgb[mine].mean(axis=0) / 255


def _first_image(clip: Clip, truth: Int[np.ndarray, "frame view height width"]) -> Labelled:
    only = Clip(clip.rgb[:1, :1], clip.depth[:1, :1], clip.valid[:1, :1], clip.k[:1], clip.world_from_camera[:1])
    return Labelled(only, truth[:1, :1])


def _camera(clip: Clip) -> Camera:
    k, pose = (torch.from_numpy(values[0]).float() for values in (clip.k, clip.world_from_camera))
    height, width = clip.depth.shape[-2:]
    return Camera(k, pose, width, height)


def _sample(origin: Origin, prior: ScenePrior, objects: int, camera: Camera, generator: torch.Generator) -> Scene:
    for attempt in range(TRIES):
        try:
            return sample_scene(origin, prior, objects=objects, cameras=(camera,), generator=generator)
        except UsageError:
            if attempt == TRIES - 1:
                raise
    raise AssertionError("unreachable")
