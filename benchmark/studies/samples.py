"""How similar are sampled scenes to real ones?

Judged by segmenters made for real scenes, by the sizes and colours of objects, and by eye. One image of each scene is
used: first view, first frame.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from benchmark.clips import ClipSequence, TruthSequence
from benchmark.metrics import mean_where_defined, score
from benchmark.metrics.kernel_distance import kernel_distance
from benchmark.models.adapters.learned import LearnedSegmenter
from benchmark.models.interface import Clip, Prediction, Segmenter
from benchmark.models.registry import find_model
from benchmark.models.tuning import choose
from benchmark.ranking.leaderboard import Cell, Line
from benchmark.studies.inputs import ModelFlags, TableFlags
from datagen.errors import UsageError
from datagen.storage.reader import Dataset, Split
from obpose.scenes.model_ref import Origin, load_origin
from obpose.scenes.pictures import enlarged, write_png
from obpose.scenes.priors import available_priors, load_prior
from obpose.scenes.priors.interface import ScenePrior
from obpose.scenes.priors.sample import sample_scene
from obpose.scenes.rendering import Image, Renderer
from obpose.scenes.scene import Camera, Scene
from obpose.storage.pretrained import shipped_names

TUNED_ON = "val"
"""Split that clustering is tuned on, and that the real scenes are compared with."""
OBPOSE, CLUSTERING = "ObPose", "plane-hdbscan"
FEATURES = ("size", "colour")
OPAQUE = 0.5
"""Share of a ray's light that must come from surfaces for the pixel to have a depth."""
TRIES = 20
"""Attempts at a scene in which there is no room for the objects."""
LEAST_PIXELS = 10
"""Number of pixels of an object from which on its size and colour are measured."""
COLUMNS, TILE, GAP = 10, 96, 2
"""Scenes per row of the picture, least pixels per scene, white pixels between."""


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""

    seed: int = 0
    """Seed of the samples."""
    segmenter: str = ""
    """Folder of a model, or name of shipped weights, that segments; default: obpose for the track, if it ships.

    Other weights than those that sample avoid a circular comparison."""
    picture: Path | None = None
    """PNG with a row of real scenes and one row per prior: flow (if there is one), Gaussian, learned."""


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """One image with its labels, as a clip of one frame and one view; 0 is the background."""

    clip: Clip
    labels: Int[np.ndarray, "1 1 height width"]


@dataclass(frozen=True, eq=False)
class Looks:
    """Appearance of the objects' visible surfaces."""

    scene: Int[np.ndarray, "object"]
    size: Float[np.ndarray, "object 3"]
    """Extents in metres: the longer and the shorter one along the table's axes, then the height."""
    colour: Float[np.ndarray, "object 3"]
    """Mean, sRGB from 0 to 1."""


def run(flags: Flags) -> Iterator[Line]:
    """Compare scenes of each prior with real ones, and draw the picture.

    Raises:
        UsageError: an option is out of range, or real scenes would be compared with themselves.
    """
    if flags.scenes < 1:
        raise UsageError(f"--scenes {flags.scenes}: expected 1 or more.")
    if flags.seed < 0:
        raise UsageError(f"--seed {flags.seed}: expected 0 or more.")
    if flags.picture is not None and flags.picture.suffix != ".png":
        raise UsageError(f"--picture {flags.picture}: expected a name that ends with .png.")
    if flags.split == TUNED_ON:
        raise UsageError(f"--split {TUNED_ON}: scenes of {TUNED_ON} are a reference; expected test or train.")
    # Real images, and sampled ones of each prior.
    origin = flags.origin()
    segmenter = load_origin(flags.segmenter or shipped_to_segment(flags.source.name) or origin.name)
    dataset = Dataset(flags.folder(TUNED_ON))
    real, reference = (real_images(dataset.split(name), flags.scenes) for name in (flags.split, TUNED_ON))
    kinds = {f"real ({flags.split})": real, f"real ({TUNED_ON})": reference}
    for name in available_priors(origin):
        images = sampled_images(origin, load_prior(origin, name), real, seed=flags.seed)
        kinds[f"sampled, prior {name}"] = list(images)
    # Scores of the segmentations.
    circular = ", which also samples: what it draws it recognises" if origin.hash == segmenter.hash else ""
    print(f"{OBPOSE} segments with {segmenter.name}{circular}.")
    segmenters = {OBPOSE: _obpose(segmenter), CLUSTERING: _clustering(reference, flags.source.slots)}
    for line in compare(kinds, segmenters, flags.seed):
        yield {"segmenter": segmenter.name, **line}
    if flags.picture is not None:
        write_png(flags.picture, grid([kind for name, kind in kinds.items() if name != f"real ({TUNED_ON})"]))


def shipped_to_segment(track: str) -> str | None:
    """Name of the weights of `obpose` that ship for a track, if there are any."""
    return next((name for name in shipped_names() if name.startswith(f"obpose--{track}--")), None)


def real_images(scenes: Split, count: int) -> list[LabelledImage]:
    """First image of each of the first scenes."""
    clips, truths = ClipSequence(scenes), TruthSequence(scenes)
    images = []
    for index in range(min(count, len(clips))):
        clip = clips[index]
        rgb, depth, valid = (array[:1, :1] for array in (clip.rgb, clip.depth, clip.valid))
        first = Clip(rgb, depth, valid, clip.k[:1], clip.world_from_camera[:1])
        images.append(LabelledImage(first, truths[index][:1, :1].astype(np.int64)))
    return images


def sampled_images(
    origin: Origin, prior: ScenePrior, like: Sequence[LabelledImage], *, seed: int
) -> Iterator[LabelledImage]:
    """Sample one scene for each real image, with its camera and its number of objects."""
    renderer, generator = Renderer(origin.model), torch.Generator().manual_seed(seed)
    for real in like:
        k, pose = (torch.from_numpy(values[0]).float() for values in (real.clip.k, real.clip.world_from_camera))
        height, width = real.labels.shape[-2:]
        camera = Camera(k, pose, width, height)
        scene = _sample(origin, prior, len(np.unique(real.labels)) - 1, camera, generator)
        yield label_image(renderer.render(scene), camera)


def label_image(image: Image, camera: Camera) -> LabelledImage:
    """Convert a rendered image to a clip, labelled by the component that contributes the most light."""
    valid = (image.shares.sum(dim=0) > OPAQUE).numpy()
    clip = Clip(
        rgb=np.rint(255 * image.rgb.numpy()).astype(np.uint8)[None, None],
        depth=np.where(valid, image.depth.numpy(), 0).astype(np.float32)[None, None],
        valid=valid[None, None],
        k=camera.k.double().numpy()[None],
        world_from_camera=camera.world_from_camera.double().numpy()[None],
    )
    return LabelledImage(clip, (image.nearest.numpy() * valid).astype(np.int64)[None, None])


def compare(
    kinds: Mapping[str, Sequence[LabelledImage]], segmenters: Mapping[str, Segmenter], seed: int
) -> Iterator[Line]:
    """Compare each kind of scenes with the first kind."""
    (first, real), *_ = kinds.items()
    reference = measure_looks(real)
    for name, images in kinds.items():
        looks = measure_looks(images)
        line: dict[str, Cell] = {"scenes": name, "seed": seed, "objects": len(looks.scene)}
        line |= {f"ari_fg {segmenter}": mean_ari_fg(model, images) for segmenter, model in segmenters.items()}
        # A kernel distance needs two objects of each kind.
        if name != first and min(len(looks.scene), len(reference.scene)) > 1:
            for feature in FEATURES:
                values = (getattr(looks, feature), getattr(reference, feature), looks.scene, reference.scene)
                distance = kernel_distance(*values, rng=np.random.default_rng(seed))
                line |= {f"mmd2 {feature}": distance.squared, f"mmd2 {feature} p": distance.p_value}
        yield line


def mean_ari_fg(segmenter: Segmenter, images: Sequence[LabelledImage]) -> float:
    """Mean ARI-FG of a segmenter over the images that have objects; nan if none has."""
    return mean_where_defined(np.array([ari_fg(segmenter.segment(image.clip), image) for image in images]))


def ari_fg(found: Prediction, image: LabelledImage) -> float:
    """ARI-FG of a segmentation of one image."""
    return score(image.labels[0], np.asarray(found.labels)[0], found.background, ~image.clip.valid[0])["ari_fg"]


def measure_looks(images: Sequence[LabelledImage]) -> Looks:
    """Measure all objects that show enough pixels."""
    rows = [(index, *look) for index, image in enumerate(images) for look in _looks(image)]
    index, size, colour = zip(*rows, strict=True) if rows else ((), (), ())
    return Looks(np.array(index, int), np.array(size, float).reshape(-1, 3), np.array(colour, float).reshape(-1, 3))


def grid(rows: Sequence[Sequence[LabelledImage]]) -> np.ndarray:
    """Arrange images in rows, each enlarged by a whole number."""
    lines = []
    for images in rows:
        tiles = [enlarged(rgb, max(1, TILE // rgb.shape[0])) for rgb in (i.clip.rgb[0, 0] for i in images[:COLUMNS])]
        framed = [np.pad(tile, ((GAP, GAP), (GAP, GAP), (0, 0)), constant_values=255) for tile in tiles]
        lines.append(np.concatenate(framed, axis=1))
    return np.concatenate(lines)


def _sample(origin: Origin, prior: ScenePrior, objects: int, camera: Camera, generator: torch.Generator) -> Scene:
    sample = partial(sample_scene, origin, prior, objects=objects, cameras=(camera,), generator=generator)
    for _ in range(TRIES - 1):
        with suppress(UsageError):
            return sample()
    return sample()


def _obpose(origin: Origin) -> Segmenter:
    model = LearnedSegmenter("obpose", slots=origin.model.config.model.segments, checkpoint=origin.folder)
    model.fit([], [], seed=0, budget=0.0)
    return model


def _clustering(images: Sequence[LabelledImage], slots: int) -> Segmenter:
    """Clustering tuned on these images."""
    spec = find_model(CLUSTERING)
    clips, labels = [image.clip for image in images], [image.labels for image in images]
    segmenter = spec.build(choose(spec, {"slots": slots}, [], clips, labels, seed=0, budget=0.0).options)
    segmenter.fit([], clips, seed=0, budget=0.0)
    return segmenter


def _looks(image: LabelledImage) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    points = image.clip.points()
    for name in np.unique(image.labels[image.labels > 0]):
        mask = (image.labels == name) & image.clip.valid
        if mask.sum() >= LEAST_PIXELS:
            x, y, z = np.ptp(points[mask], axis=0)
            yield np.array([max(x, y), min(x, y), z]), image.clip.rgb[mask].mean(axis=0) / 255
