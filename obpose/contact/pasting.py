"""Training images without labels: pseudo-objects of different clips, pasted next to each other.

The connected components of a clip's clearest frame serve as pseudo-objects. Some of them are moved, in the image, next
to a component of another clip. Which pixel belongs to which is then known, although the pixels touch.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, UInt8
from scipy.ndimage import binary_dilation, binary_erosion, distance_transform_edt
from torch import Tensor

from datagen import geometry
from obpose.contact.components import image_components, join_floating, numbered
from obpose.contact.motion.tracking import COLOUR_SCALE, Cloud, track
from obpose.data.clean_depth import clean_depth, without_narrow_holes
from obpose.data.clips import ClipSource, observation_of
from obpose.errors import UsageError
from obpose.geometry import unproject
from obpose.random_streams import training_rng

LEAST_PIXELS = 6
"""Number of pixels of a 64x64 image from which a component is a pseudo-object."""
MOST_OBJECTS = 6
"""Number of objects of an image from which on no more are pasted into it."""
PASTED = (1, 2, 3)
"""Numbers of pseudo-objects that are pasted into an image."""
PLACES = 12
"""Places that are tried for each pasted object."""
LARGEST_SCALING = 0.12
"""Largest relative change of the distance from the camera: pasted objects keep their size in the image."""
LEAST_VISIBLE, LEAST_LEFT = 0.5, 0.4
"""Shares of a pasted object and of each other one that must be visible afterwards."""
LARGEST_LABEL = 255
"""Further components of an image are no pseudo-objects; they lie below the others."""
CHECKED = 32
"""Number of clips, one of which must show pseudo-objects."""
KEPT_BYTES = 2**30
"""Memory of a process for the pseudo-objects of clips that were used; the oldest are found again when needed."""
IMAGES_PER_FRAME = 3.2
"""Number of pasted images, 64 pixels wide, for each frame of a window of `ClipsWithPasted`."""
APART = 0.2
"""Probability that a place without contact is accepted."""

Image = Float32[np.ndarray, "height width 3"]


@dataclass(frozen=True, eq=False)
class PseudoScene:
    """Frame of a clip, with its pseudo-objects."""

    rgb: Image
    """sRGB in 0..1."""
    depth: Float32[np.ndarray, "height width"]
    """Planar z in metres, 0 where there is no return."""
    labels: UInt8[np.ndarray, "height width"]
    """Pseudo-objects from 1; 0 elsewhere."""
    k: Float32[np.ndarray, "3 3"]
    world_from_camera: Float32[np.ndarray, "4 4"]

    @property
    def count(self) -> int:
        """Number of pseudo-objects."""
        return int(self.labels.max())

    @property
    def bytes(self) -> int:
        """Memory of the images."""
        return self.rgb.nbytes + self.depth.nbytes + self.labels.nbytes

    def window(self) -> dict[str, Tensor]:
        """Give the fields of `obpose.types.PastedObservation` without the batch axis: one frame and view."""
        arrays = {
            "rgb": self.rgb[None, None],
            "depth": self.depth[None, None],
            "valid": self.depth[None, None] > 0,
            "k": self.k[None],
            "world_from_camera": self.world_from_camera[None],
            "pseudo_labels": self.labels[None, None].astype(np.int64),
        }
        return {name: torch.from_numpy(array) for name, array in arrays.items()}

    def points(self, mask: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "pixel 3"]:
        """Surface points of the pixels of a mask, world frame, metres."""
        return geometry.unproject(self.depth, self.k, self.world_from_camera)[mask]

    def slope(self, rows: np.ndarray | float, columns: np.ndarray | float) -> np.ndarray | float:
        """Change of height per metre of planar depth, along the rays through places of the image."""
        x, y = (columns + 0.5 - self.k[0, 2]) / self.k[0, 0], (rows + 0.5 - self.k[1, 2]) / self.k[1, 1]
        right, down, forward = self.world_from_camera[2, :3]
        return right * x + down * y + forward


Divide = Callable[[PseudoScene], UInt8[np.ndarray, "height width"]]
"""Function that relabels the pseudo-objects of a scene: from 1, and 0 elsewhere."""


@dataclass(frozen=True, eq=False)
class Cutout:
    """A pseudo-object that was cut out of its image."""

    rows: np.ndarray
    """Row of each pixel."""
    columns: np.ndarray
    rgb: Float32[np.ndarray, "pixel 3"]
    depth: Float32[np.ndarray, " pixel"]
    height: float
    """Mean height above the world's z = 0, metres."""


class PastedClips:
    """Source of labelled single images; a window's first frame is the seed of its image (`ClipSource`).

    Labels are pseudo-objects. The labels of the clips, if they have any, are never read.
    """

    frames_of_clip = 2**20
    """Number of different images with the background of one clip."""

    def __init__(
        self,
        source: ClipSource,
        *,
        table: float,
        floor: float,
        gap: float,
        clean: bool,
        seed: int,
        kept_bytes: int = KEPT_BYTES,
    ):
        """Prepare the source; pseudo-objects of a clip are found when they are first used.

        Args:
            source: Clips with cameras whose world has z upwards.
            table: Height of the table in the world, metres.
            floor: Height above the table from which points belong to pseudo-objects, metres.
            gap: Largest distance between neighbouring points of a pseudo-object, metres.
            clean: Whether noisy depth is smoothed and narrow holes are filled.
            seed: Seed of the images.
            kept_bytes: Memory for the pseudo-objects of clips that were used.
        """
        self._source, self._seed, self._kept_bytes = source, seed, kept_bytes
        self._settings = {
            "table": table,
            "floor": floor,
            "gap": gap,
            "clean": clean,
            "still": source.frames_of_clip == 1,
        }
        self._scenes: dict[int, PseudoScene] = {}
        self._divide: Divide | None = None
        self._labels: dict[int, UInt8[np.ndarray, "height width"]] = {}

    def check(self) -> None:
        """Check that at least one of `CHECKED` clips, spread evenly, shows a pseudo-object that can be pasted.

        Raises:
            UsageError: none shows an object above the table that lies within an image.
        """
        checked = np.linspace(0, len(self) - 1, min(CHECKED, len(self))).round().astype(int).tolist()
        if not any(_shows_whole_object(self._scene(index).labels) for index in checked):
            table, floor = self._settings["table"], self._settings["floor"]
            raise UsageError(
                f"The training clips show no whole object more than {floor * 1000:g} mm above z = {table:g} m; "
                "expected objects on a table. If the table is elsewhere, give its exact height: --set model.table=..., "
                "or for obpose-contact --set contact.table=... and --set model.table=..., 1 mm higher."
            )

    def __len__(self) -> int:
        return len(self._source)

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        """Paste an image: fields of `obpose.types.PastedObservation` without the batch axis, one frame and view.

        Raises:
            UsageError: more than one frame is requested.
        """
        if frames != 1:
            raise UsageError(f"Pasted images are single frames; expected train.frames=1, not {frames}.")
        rng = training_rng(self._seed, "pasted image", index, start)
        # Paste objects of other images next to those of this one.
        scene = self._scene(index)
        for _ in range(rng.choice(PASTED) if scene.count else 0):
            other = self._scene(int(rng.integers(len(self))))
            cutout = cut_out(other, rng) if other.count else None
            if cutout is not None and scene.count < MOST_OBJECTS:
                scene = paste(scene, cutout, rng)
        return scene.window()

    @property
    def divided(self) -> bool:
        """Whether this comes from `divided_by`."""
        return self._divide is not None

    def divided_by(self, divide: Divide) -> "PastedClips":
        """Give the same clips, with pseudo-objects that a function divides when they are first used."""
        other = copy(self)
        other._divide, other._labels = divide, {}
        return other

    def _scene(self, index: int) -> PseudoScene:
        """Image of a clip that shows the most pseudo-objects, which are divided."""
        scene = self._components(index)
        if index not in self._labels:
            self._labels[index] = self._divided_labels(scene)
        return replace(scene, labels=self._labels[index])

    def _components(self, index: int) -> PseudoScene:
        """Image of a clip that shows the most connected components."""
        if index not in self._scenes:
            window = self._source.window(index, 0, self._source.frames_of_clip)
            scene = max(pseudo_scenes(window, **self._settings), key=lambda scene: scene.count)
            while self._scenes and (len(self._scenes) + 1) * scene.bytes > self._kept_bytes:
                oldest = next(iter(self._scenes))
                del self._scenes[oldest]
                self._labels.pop(oldest, None)
            self._scenes[index] = scene
        return self._scenes[index]

    def _divided_labels(self, scene: PseudoScene) -> UInt8[np.ndarray, "height width"]:
        return self._divide(scene) if self._divide and scene.count else scene.labels

    def pseudo_labels(self, window: Mapping[str, Tensor]) -> UInt8[np.ndarray, "frame view height width"]:
        """Pseudo-objects of a window of a clip, followed from the frame that shows the most; 0 elsewhere."""
        scenes = list(pseudo_scenes(window, **self._settings))
        views = len(window["k"])
        labels = np.stack([self._followed(scenes[view::views]) for view in range(views)], axis=1)
        return np.where(window["valid"].numpy(), labels, 0).astype(np.uint8)

    def _followed(self, scenes: Sequence[PseudoScene]) -> UInt8[np.ndarray, "frame height width"]:
        """Pseudo-objects of the images of one view, with one label each over time."""
        masks = [scene.labels > 0 for scene in scenes]
        clouds = [
            Cloud(scene.points(mask), COLOUR_SCALE * scene.rgb[mask]) for scene, mask in zip(scenes, masks, strict=True)
        ]
        key = int(np.argmax([scene.count for scene in scenes]))
        begin = self._divided_labels(scenes[key])[masks[key]].astype(np.int64) - 1
        labels = np.zeros((len(scenes), *masks[0].shape), np.uint8)
        for frame, found in enumerate(track(clouds, key, begin, self._settings["gap"])):
            labels[frame][masks[frame]] = np.minimum(found + 1, 255)
        return labels


class ClipsWithPasted:
    """Source of clips with pseudo-objects and pasted images: fields of `obpose.types.ContactObservation`."""

    def __init__(self, source: ClipSource, pasted: PastedClips, *, seed: int, scale: int = 1):
        """Combine clips and the images that are pasted from them.

        Images of `scale` times 64 columns are fewer, so that a step takes as long: the number of steps matters more to
        training than that of the images.
        """
        self._source, self._pasted, self._seed = source, pasted, seed
        self._images_per_frame = IMAGES_PER_FRAME / scale**2

    @property
    def frames_of_clip(self) -> int:
        """Frames of every clip."""
        return self._source.frames_of_clip

    @property
    def divided(self) -> bool:
        """Whether this comes from `divided_by`."""
        return self._pasted.divided

    def check(self) -> None:
        """Check that the clips show pseudo-objects, as `PastedClips.check`."""
        self._pasted.check()

    def divided_by(self, divide: Divide) -> "ClipsWithPasted":
        """Give the same clips, with pseudo-objects that a function divides when they are first used."""
        other = copy(self)
        other._pasted = self._pasted.divided_by(divide)
        return other

    def __len__(self) -> int:
        return len(self._source)

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        """Read a window of a clip, with pasted images that depend on the seed, the clip and its start."""
        rng = training_rng(self._seed, "choice of images", index, start)
        count = max(1, round(self._images_per_frame * frames))
        places = rng.integers((len(self), self._pasted.frames_of_clip), size=(count, 2)).tolist()
        images = [self._pasted.window(other, first, 1) for other, first in places]
        pasted = {name: torch.stack([image[name] for image in images]) for name in images[0]}
        window = self._source.window(index, start, frames)
        return {
            **window,
            "pseudo_labels": torch.from_numpy(self._pasted.pseudo_labels(window).astype(np.int64)),
            "pasted_rgb": pasted["rgb"][:, 0, 0],
            "pasted_depth": pasted["depth"][:, 0, 0],
            "pasted_labels": pasted["pseudo_labels"][:, 0, 0],
            "pasted_k": pasted["k"][:, 0],
            "pasted_world_from_camera": pasted["world_from_camera"][:, 0],
        }


def pseudo_scenes(
    window: Mapping[str, Tensor], *, table: float, floor: float, gap: float, clean: bool, still: bool
) -> Iterator[PseudoScene]:
    """Find the pseudo-objects in all images of a clip's window (`ClipSource`), by frames and views.

    Narrow holes in the depth never divide objects. They have depth and labels only if images are to be cleaned.
    In scenes at rest (`still`), what seems to float belongs to what is below it (`join_floating`).
    """
    observed = observation_of([window])
    whole = clean_depth(observed) if clean else without_narrow_holes(observed)
    points = unproject(whole)[0].numpy()
    rgb, depth, valid = (getattr(whole, name)[0].numpy() for name in ("rgb", "depth", "valid"))
    kept = valid if clean else observed.valid[0].numpy()
    least = least_pixels(depth[0, 0].size)
    for frame, view in np.ndindex(*depth.shape[:2]):
        standing = valid[frame, view] & (points[frame, view, ..., 2] > table + floor)
        labels = image_components(points[frame, view], standing, gap=gap, least=least)
        if still:
            labels = join_floating(labels, points[frame, view], table=table)
        yield PseudoScene(
            rgb=rgb[frame, view].copy(),
            depth=np.where(kept[frame, view], depth[frame, view], 0).astype(np.float32),
            labels=numbered(np.where(kept[frame, view] & (labels <= LARGEST_LABEL), labels, 0)).astype(np.uint8),
            k=whole.k[0, view].numpy(),
            world_from_camera=whole.world_from_camera[0, view].numpy(),
        )


def least_pixels(size: int) -> int:
    """Number of pixels from which a component of an image of `size` pixels is a pseudo-object."""
    return max(LEAST_PIXELS, round(LEAST_PIXELS * size / 64**2))


def _shows_whole_object(labels: UInt8[np.ndarray, "height width"]) -> bool:
    """Whether a pseudo-object does not reach the border of the image. A table that lies too high always does."""
    border = np.concatenate([labels[[0, -1]].ravel(), labels[:, [0, -1]].ravel()])
    return bool(np.setdiff1d(labels, [0, *border]).size)


def cut_out(scene: PseudoScene, rng: np.random.Generator) -> Cutout | None:
    """Cut out one of the pseudo-objects, half of the time mirrored; None if it reaches the border of the image."""
    mask = scene.labels == rng.integers(1, scene.count + 1)
    if mask[[0, -1]].any() or mask[:, [0, -1]].any():
        return None
    rows, columns = np.nonzero(mask)
    depth = scene.depth[mask]
    height = float(np.mean(scene.world_from_camera[2, 3] + scene.slope(rows, columns) * depth))
    colours = _inner_colours(scene.rgb, mask)
    if rng.random() < 0.5:
        columns = mask.shape[1] - 1 - columns
    return Cutout(rows, columns, colours, depth, height)


def _inner_colours(rgb: Image, mask: Bool[np.ndarray, "height width"]) -> Float32[np.ndarray, "pixel 3"]:
    """Colours of the pixels of a mask; those at its border, which the background tints, have that of an inner pixel."""
    rows, columns = np.nonzero(mask)
    box = slice(rows.min() - 1, rows.max() + 2), slice(columns.min() - 1, columns.max() + 2)
    inner = np.asarray(binary_erosion(mask[box], np.ones((3, 3))), bool)
    if not inner.any():
        return rgb[mask]
    nearest = distance_transform_edt(~inner, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    distance = np.linalg.norm(nearest - np.indices(inner.shape), axis=0)
    colours = np.where((distance <= 2)[..., None], rgb[box][tuple(nearest)], rgb[box])
    return colours[mask[box]].astype(np.float32)


def paste(scene: PseudoScene, cutout: Cutout, rng: np.random.Generator) -> PseudoScene:
    """Move a cut-out object next to one of a scene; the scene is unchanged if no place that is tried is suitable."""
    target = scene.labels == rng.integers(1, scene.count + 1)
    rgb = cutout.rgb
    if rng.random() < 0.5:
        # Colour alone must not tell the two apart.
        rgb = np.clip(rgb * (scene.rgb[target].mean(axis=0) / (rgb.mean(axis=0) + 0.02)), 0, 1).astype(np.float32)
    # Try places at about the distance at which the two touch.
    sizes = np.sqrt(len(cutout.rows)) + np.sqrt(np.count_nonzero(target))
    middle = np.array([np.nonzero(target)[axis].mean() for axis in (0, 1)])
    own = np.array([cutout.rows.mean(), cutout.columns.mean()])
    for _ in range(PLACES):
        angle, radius = rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 1.1) * 0.6 * sizes
        place = middle + radius * np.array([np.sin(angle), np.cos(angle)])
        pasted = _paste_at(scene, replace(cutout, rgb=rgb), np.rint(place - own).astype(int), own)
        if pasted is not None and (_adjoins(pasted) or rng.random() < APART):
            return pasted
    return scene


def _paste_at(scene: PseudoScene, cutout: Cutout, shift: np.ndarray, own: Float[np.ndarray, "2"]) -> PseudoScene | None:
    """Paste at a shift in pixels, with a depth that keeps the height above the table; None if that does not fit."""
    rows, columns = cutout.rows + shift[0], cutout.columns + shift[1]
    height, width = scene.labels.shape
    if rows.min() < 1 or columns.min() < 1 or rows.max() >= height - 1 or columns.max() >= width - 1:
        return None
    slope = float(scene.slope(*(own + shift)))
    if slope >= 0:
        return None  # above the horizon
    # Depth at which the object keeps its height; its size in pixels is not changed, so it must be similar.
    distance, mean = (cutout.height - scene.world_from_camera[2, 3]) / slope, cutout.depth.mean()
    if abs(distance / mean - 1) > LARGEST_SCALING:
        return None
    # Hide what is behind, but never most of the pasted object or of another one.
    depth = cutout.depth + np.float32(distance - mean)
    behind = scene.depth[rows, columns]
    nearer = (depth < behind) | (behind == 0)
    if nearer.mean() < LEAST_VISIBLE:
        return None
    rows, columns = rows[nearer], columns[nearer]
    labels = scene.labels.copy()
    labels[rows, columns] = scene.count + 1
    before, after = (np.bincount(each.ravel(), minlength=scene.count + 2) for each in (scene.labels, labels))
    if (after[1:-1] < LEAST_LEFT * before[1:-1]).any():
        return None
    new_rgb, new_depth = scene.rgb.copy(), scene.depth.copy()
    new_rgb[rows, columns], new_depth[rows, columns] = cutout.rgb[nearer], depth[nearer]
    return replace(scene, rgb=new_rgb, depth=new_depth, labels=labels)


def _adjoins(scene: PseudoScene) -> bool:
    """Whether the object pasted last adjoins another one."""
    last = scene.labels == scene.count
    return bool((binary_dilation(last) & ~last & (scene.labels > 0)).any())
