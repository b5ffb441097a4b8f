"""Pictures that a model renders of scenes it has seen from one view, beside the truth and beside simpler pictures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Integer

from benchmark.metrics.images import depth_errors, psnr, ssim
from datagen import schema
from datagen.geometry import project, unproject
from datagen.storage.reader import Dataset, Split
from obpose.data.clips import observation_of, select_part
from obpose.data.datasets import SceneDataset
from obpose.scenes.infer import cameras_of, infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.rendering import Renderer

MODEL, CARRIED, COPIED, MEAN = "the model", "its points carried over", "the input image itself", "mean of other scenes"
FLAT = "true masks, each in one colour"
"""Who makes a picture: `CARRIED`, `COPIED` and `MEAN` know nothing, or only what they see, `FLAT` knows the labels and
nothing of what is inside a mask."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Colour and depth of one image."""

    rgb: Float[np.ndarray, "height width 3"]
    """0..1."""
    depth: Float[np.ndarray, "height width"]
    """Planar, metres; 0 where there is none."""


@dataclass(frozen=True, eq=False)
class View:
    """What a camera saw of a frame, and where the objects are in it."""

    picture: Picture
    labels: Integer[np.ndarray, "height width"]
    """0 is the background."""
    k: Float[np.ndarray, "3 3"]
    world_from_camera: Float[np.ndarray, "4 4"]

    @property
    def objects(self) -> Bool[np.ndarray, "height width"]:
        """The pixels of objects."""
        return self.labels > 0


@dataclass(frozen=True, eq=False)
class Likeness:
    """How like the truth a picture is."""

    scene: int
    """Of the split."""
    maker: str
    same_view: bool
    """Whether it is of the view that was seen, or of another."""
    psnr: float
    psnr_objects: float
    """Over the pixels of objects."""
    ssim: float
    depth_errors: Float[np.ndarray, "pixel"]
    """Metres, of all pixels."""
    depth_errors_objects: Float[np.ndarray, "object_pixel"]


def measure_views(
    origin: Origin, folder: Path, split: str, *, scenes: int, frames: int, refinements: int = 0
) -> Iterator[Likeness]:
    """Each view of each scene once as the input, all views rendered; of clips so many frames, spread evenly.

    The mean images are of as many training scenes, if there are other views to be guessed.
    """
    records, renderer = Dataset(folder).split(split), Renderer(origin.model)
    source = SceneDataset(folder, split)
    chosen = range(min(scenes, len(records)))
    number = records.views
    means = mean_pictures(Dataset(folder).split("train"), scenes) if number > 1 else []
    for index in chosen:
        observation = observation_of([source.window(index, 0, source.frames_of_clip)])
        cameras = cameras_of(observation)
        for seen in range(number):
            one = select_part(observation, views=slice(seen, seen + 1))
            scene = infer_scene(origin, one, refinements=refinements)
            for frame in spread(source.frames_of_clip, frames):
                truth = read_views(records, index, frame)
                for view, camera in enumerate(cameras):
                    rendered = renderer.render(scene, frame, camera)
                    pictures = {MODEL: Picture(_array(rendered.rgb), _array(rendered.depth))}
                    if view == seen:
                        pictures[FLAT] = flat(truth[seen])
                    else:
                        pictures[CARRIED] = carried(truth[seen], truth[view], means[view])
                        pictures |= {COPIED: truth[seen].picture, MEAN: means[view]}
                    for maker, picture in pictures.items():
                        yield likeness(maker, picture, truth, seen, view, scene=index)


def likeness(maker: str, picture: Picture, truth: Sequence[View], seen: int, view: int, *, scene: int = 0) -> Likeness:
    """A picture of a view beside that view."""
    true, objects = truth[view].picture, truth[view].objects
    return Likeness(
        scene=scene,
        maker=maker,
        same_view=seen == view,
        psnr=psnr(picture.rgb, true.rgb),
        psnr_objects=psnr(picture.rgb, true.rgb, objects),
        ssim=ssim(picture.rgb, true.rgb),
        depth_errors=depth_errors(picture.depth, true.depth),
        depth_errors_objects=depth_errors(picture.depth, true.depth, objects),
    )


def read_views(records: Split, index: int, frame: int) -> list[View]:
    """All views of a frame, with exact depth."""
    names = ("rgb", "depth", "segmentation", "camera/K", "camera/world_from_camera")
    record = records.read(index, names, slice(frame, frame + 1))
    return [
        View(
            Picture(record["rgb"][0, view] / 255.0, schema.decode_depth(record["depth"][0, view]).astype(np.float64)),
            record["segmentation"][0, view],
            record["camera/K"][view],
            record["camera/world_from_camera"][view],
        )
        for view in range(record["rgb"].shape[1])
    ]


def mean_pictures(records: Split, scenes: int) -> list[Picture]:
    """Of each view the mean image of the first frames of scenes, and the median depth."""
    views = [[view.picture for view in read_views(records, i, 0)] for i in range(min(scenes, len(records)))]
    return [
        Picture(np.mean([p.rgb for p in same], axis=0), np.median([p.depth for p in same], axis=0))
        for same in zip(*views, strict=True)
    ]


def carried(seen: View, target: View, behind: Picture) -> Picture:
    """The surface points that one view sees as another sees them, nearer ones in front, and `behind` where none is."""
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


def flat(seen: View) -> Picture:
    """Every true mask, the background's too, in its mean colour and at its mean depth."""
    rgb, depth = np.empty_like(seen.picture.rgb), np.empty_like(seen.picture.depth)
    for label in np.unique(seen.labels):
        mask = seen.labels == label
        rgb[mask], depth[mask] = seen.picture.rgb[mask].mean(axis=0), seen.picture.depth[mask].mean()
    return Picture(rgb, depth)


def spread(length: int, count: int) -> list[int]:
    """At most `count` indices, each in the middle of an equal part of the range."""
    count = min(length, count)
    return [(2 * i + 1) * length // (2 * count) for i in range(count)]


def _array(values: torch.Tensor) -> np.ndarray:
    return values.numpy().astype(np.float64)
