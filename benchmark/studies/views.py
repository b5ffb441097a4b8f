"""How similar to the truth are a model's pictures of its input view, and of other views?

Each view of a scene is once the only input, and all views are rendered. Three references know only what the model sees;
true masks in one colour each know the labels, but nothing of what is inside a mask.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Integer

from benchmark.metrics.images import depth_errors, psnr, ssim
from benchmark.models.tuning import evenly_spaced
from benchmark.ranking.leaderboard import Line
from benchmark.ranking.statistics import draw, summarise
from benchmark.studies.inputs import ModelFlags, TableFlags
from datagen.errors import UsageError
from datagen.geometry import project, unproject
from datagen.schema import decode_depth
from datagen.storage.reader import Dataset, Split, read_camera_poses
from obpose.data.clips import select_part
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import cameras_of, infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.rendering import Renderer
from obpose.types import Observation

MODEL, CARRIED, COPIED, MEAN = "the model", "its points carried over", "the input image itself", "mean of other scenes"
FLAT = "true masks, each in one colour"
MEANS, MEDIANS = ("psnr", "psnr_objects", "ssim"), ("depth_errors", "depth_errors_objects")
INTERVALS = ("psnr", "psnr_objects")
"""Means that get a 95 % interval, by resampling scenes."""


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""

    frames: int = 3
    """Number of frames of each clip, at equal distances."""
    refine: int = 0
    """Steps in which scenes are fitted to the input view, as by `obpose-edit infer --refine`."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Colour and depth of one image."""

    rgb: Float[np.ndarray, "height width 3"]
    """Colours in 0..1."""
    depth: Float[np.ndarray, "height width"]
    """Planar, metres; 0 for none."""


@dataclass(frozen=True, eq=False)
class View:
    """Ground truth of one image."""

    picture: Picture
    labels: Integer[np.ndarray, "height width"]
    """0 is the background."""
    k: Float[np.ndarray, "3 3"]
    world_from_camera: Float[np.ndarray, "4 4"]

    @property
    def objects(self) -> Bool[np.ndarray, "height width"]:
        """Pixels of objects."""
        return self.labels > 0


@dataclass(frozen=True, eq=False)
class Similarity:
    """Scores of a picture compared with the truth."""

    scene: int
    """Index in the split."""
    maker: str
    same_view: bool
    """Whether the picture is of the input view."""
    psnr: float
    psnr_objects: float
    """PSNR over the pixels of objects."""
    ssim: float
    depth_errors: Float[np.ndarray, "pixel"]
    """Errors of all pixels, metres."""
    depth_errors_objects: Float[np.ndarray, "object_pixel"]


def run(flags: Flags) -> list[Line]:
    """Score pictures of all views."""
    for name, least in (("scenes", 1), ("frames", 1), ("refine", 0)):
        if (value := getattr(flags, name)) < least:
            raise UsageError(f"--{name} {value}: expected {least} or more.")
    origin, folder = flags.origin(), flags.folder()
    if Dataset(folder).views > 1:
        flags.folder("train")
    found = measure_views(
        origin, folder, flags.split, scenes=flags.scenes, frames=flags.frames, refinements=flags.refine
    )
    return summarise_pictures(list(found), flags.refine)


def measure_views(
    origin: Origin, folder: Path, split: str, *, scenes: int, frames: int, refinements: int = 0
) -> Iterator[Similarity]:
    """Score pictures of all views, for each view as the input.

    The mean images are of as many training scenes, if there are other views. If cameras move, the model sees one frame
    at a time.
    """
    records, renderer = Dataset(folder).split(split), Renderer(origin.model)
    train = Dataset(folder).split("train") if records.views > 1 else None
    chosen = evenly_spaced(records.labels_shape[1], frames)
    moving = records.has_moving_cameras
    means = {frame: mean_pictures(train, scenes, frame) for frame in (chosen if moving else (0,)) if train}
    for index in range(min(scenes, len(records))):
        for observation, places in _inputs(folder, split, index, chosen, moving=moving):
            cameras = cameras_of(observation)
            for seen in range(records.views):
                one = select_part(observation, views=slice(seen, seen + 1))
                # One view is the input; pictures of all views are compared.
                scene = infer_scene(origin, one, refinements=refinements)
                for frame, place in places.items():
                    truth = read_views(records, index, frame)
                    for view, camera in enumerate(cameras):
                        rendered = renderer.render(scene, place, camera)
                        rgb, depth = (values.numpy().astype(np.float64) for values in (rendered.rgb, rendered.depth))
                        pictures = {MODEL: Picture(rgb, depth)}
                        if view == seen:
                            pictures[FLAT] = flatten_masks(truth[seen])
                        else:
                            mean = means[frame if moving else 0][view]
                            pictures[CARRIED] = carry_points(truth[seen], truth[view], mean)
                            pictures |= {COPIED: truth[seen].picture, MEAN: mean}
                        for maker, picture in pictures.items():
                            yield compare(picture, truth[view], scene=index, maker=maker, same_view=seen == view)


def _inputs(
    folder: Path, split: str, index: int, frames: Sequence[int], *, moving: bool
) -> Iterator[tuple[Observation, dict[int, int]]]:
    """Read the model's inputs with the chosen frames and their places in it: a clip, or frames if cameras move."""
    if moving:
        yield from ((read_clip(folder, split, index, frame), {frame: 0}) for frame in frames)
    else:
        yield read_clip(folder, split, index), {frame: frame for frame in frames}


def compare(picture: Picture, truth: View, *, scene: int, maker: str, same_view: bool) -> Similarity:
    """Compare a picture with the truth."""
    true, objects = truth.picture, truth.objects
    return Similarity(
        scene=scene,
        maker=maker,
        same_view=same_view,
        psnr=psnr(picture.rgb, true.rgb),
        psnr_objects=psnr(picture.rgb, true.rgb, objects),
        ssim=ssim(picture.rgb, true.rgb),
        depth_errors=depth_errors(picture.depth, true.depth),
        depth_errors_objects=depth_errors(picture.depth, true.depth, objects),
    )


def read_views(records: Split, index: int, frame: int) -> list[View]:
    """Read all views of a frame, with exact depth."""
    record = records.read(index, ("rgb", "depth", "segmentation", "camera/K"), slice(frame, frame + 1))
    poses = read_camera_poses(records, index, slice(frame, frame + 1))
    return [
        View(
            Picture(record["rgb"][0, view] / 255.0, decode_depth(record["depth"][0, view]).astype(np.float64)),
            record["segmentation"][0, view],
            record["camera/K"][view],
            poses[0, view],
        )
        for view in range(record["rgb"].shape[1])
    ]


def mean_pictures(records: Split, scenes: int, frame: int = 0) -> list[Picture]:
    """Mean colour and median depth of each view, over one frame of scenes."""
    views = [[view.picture for view in read_views(records, i, frame)] for i in range(min(scenes, len(records)))]
    return [
        Picture(np.mean([p.rgb for p in same], axis=0), np.median([p.depth for p in same], axis=0))
        for same in zip(*views, strict=True)
    ]


def carry_points(seen: View, target: View, behind: Picture) -> Picture:
    """Project the surface points of one view into another, nearer ones in front; `behind` fills the rest."""
    rgb, depth = behind.rgb.copy(), behind.depth.copy()
    known = seen.picture.depth > 0
    points = unproject(seen.picture.depth, seen.k, seen.world_from_camera)[known]
    pixel, z = project(points, target.k, target.world_from_camera)
    column, row = np.floor(pixel).astype(int).T
    height, width = depth.shape
    within = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    far_to_near = np.flatnonzero(within)[np.argsort(-z[within], kind="stable")]
    row, column = row[far_to_near], column[far_to_near]
    rgb[row, column], depth[row, column] = seen.picture.rgb[known][far_to_near], z[far_to_near]
    return Picture(rgb, depth)


def flatten_masks(seen: View) -> Picture:
    """Paint every true mask, the background included, in its mean colour and at its mean depth."""
    rgb, depth = np.empty_like(seen.picture.rgb), np.empty_like(seen.picture.depth)
    for label in np.unique(seen.labels):
        mask = seen.labels == label
        rgb[mask], depth[mask] = seen.picture.rgb[mask].mean(axis=0), seen.picture.depth[mask].mean()
    return Picture(rgb, depth)


def summarise_pictures(found: Sequence[Similarity], refinements: int) -> list[Line]:
    """Summarise the pictures of each view and maker: means over pictures, medians of depth errors over all pixels."""
    groups = {
        (same_view, maker): [one for one in found if one.same_view == same_view and one.maker == maker]
        for same_view in (True, False)
        for maker in (MODEL, FLAT, CARRIED, COPIED, MEAN)
    }
    return [
        {
            "picture": "the input view" if same_view else "another view",
            "by": maker,
            "refinements": refinements if maker == MODEL else 0,
            "pictures": len(group),
            **{name: float(np.nanmean([getattr(one, name) for one in group])) for name in MEANS},
            **{key: value for name in INTERVALS for key, value in _interval(group, name).items()},
            **{name: float(np.median(np.concatenate([getattr(one, name) for one in group]))) for name in MEDIANS},
        }
        for (same_view, maker), group in groups.items()
        if group
    ]


def _interval(group: Sequence[Similarity], name: str) -> dict[str, float]:
    """Interval of a mean over pictures, resampling scenes: pictures of one scene are not independent."""
    members = [
        [getattr(one, name) for one in group if one.scene == scene] for scene in {one.scene: None for one in group}
    ]
    counts = np.array([[np.sum(~np.isnan(scores)) for scores in members]], float)
    means = np.array([[np.nansum(scores) for scores in members]]) / np.maximum(counts, 1)
    found = summarise(means, counts, draw(1, len(members), np.random.default_rng(0)))
    return {f"{name}_ci_low": found.low, f"{name}_ci_high": found.high}
