"""Images of a recording as the record of a scene: one pose per view, a world frame, compact ids, stored units."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from datagen.errors import UsageError
from datagen.formats.importers.interface import Grouping, Images, World
from datagen.formats.importers.plan import MOST_OBJECTS
from datagen.formats.importers.resample import resampled
from datagen.geometry import invert_rigid
from datagen.pipeline.records import boxes_2d, visible_pixels
from datagen.rgbd.camera_pose import Pose
from datagen.rgbd.images import Size
from datagen.rgbd.table import pose_over_table
from datagen.schema import MAX_DEPTH, SceneRecord, encode_depth

ALWAYS = ("rgb", "depth", "camera/K", "camera/world_from_camera")
"""Fields of every imported scene."""
WITH_MASKS = ("segmentation", "objects/count", "visibility/visible_pixels", "boxes/box_2d")
"""Further fields of scenes with masks."""
WITH_NAMES = ("objects/category",)
"""Further field of scenes whose objects have names."""
_STILL_METRES, _STILL_RADIANS, _STILL_PIXELS = 0.002, 0.004, 0.01
"""Largest differences of poses and camera matrices over a clip that count as a static camera."""
_LONGEST_NAME = 60


@dataclass(frozen=True)
class Target:
    """Form of all scenes of a dataset."""

    grouping: Grouping
    size: Size
    """Width and height, pixels."""
    rows: int
    """Length of the object axis."""
    world: World


@dataclass(frozen=True)
class Measured:
    """Facts about an imported scene for the user."""

    depth: float
    """Median depth, metres."""
    missing: float
    """Share of the pixels without depth."""
    too_far: float
    """Share of the pixels whose depth is beyond the format's range and was dropped."""
    estimated_world: bool
    """Whether the world frame was put on the table that the first image shows."""


def convert(images: Images, target: Target, place: str, fields: frozenset[str]) -> tuple[SceneRecord, Measured]:
    """Convert images to a record with these fields; `place` names them in messages.

    Raises:
        UsageError: the camera moves in a clip, several views have no poses, no table is found, or there are too many
            objects.
    """
    images = resampled(images, target.size)
    if target.grouping == "views":
        images = _as_views(images, place)
    _check_static(images, place)
    poses, estimated = _world(images, target.world, place)
    too_far = images.depth > MAX_DEPTH
    depth = np.where(too_far, np.float32(0), images.depth)
    record = {
        "rgb": images.rgb,
        "depth": encode_depth(depth),
        "camera/K": np.array(images.k[0], np.float64),
        "camera/world_from_camera": poses,
    }
    if "segmentation" in fields:
        record |= _labels(images, target.rows, place)
    known = images.depth[images.depth > 0]
    measured = Measured(
        depth=float(np.median(known)) if len(known) else 0.0,
        missing=float(np.mean(images.depth == 0)),
        too_far=float(np.mean(too_far)),
        estimated_world=estimated,
    )
    return {name: record[name] for name in record if name in fields}, measured


def _as_views(images: Images, place: str) -> Images:
    """Turn images over time into views of one still scene."""
    if images.depth.shape[1] > 1:
        raise UsageError(f"{place} has several views already; leave out --group views.")
    arrays = ("rgb", "depth", "k", "world_from_camera", "ids")
    turned = {name: getattr(images, name) for name in arrays if getattr(images, name) is not None}
    return replace(images, **{name: np.swapaxes(array, 0, 1) for name, array in turned.items()})


def _check_static(images: Images, place: str) -> None:
    if np.max(np.abs(images.k - images.k[:1])) > _STILL_PIXELS:
        raise UsageError(f"{place}: the camera matrix changes in the clip; import with --group stills.")
    if images.world_from_camera is None:
        return
    poses, first = images.world_from_camera, images.world_from_camera[:1]
    moved = float(np.max(np.linalg.norm(poses[..., :3, 3] - first[..., :3, 3], axis=-1)))
    turned = float(np.max(np.abs(poses[..., :3, :3] - first[..., :3, :3])))
    if moved > _STILL_METRES or turned > _STILL_RADIANS:
        raise UsageError(
            f"{place}: the camera moves by {moved:.3g} m in the clip, but each camera has one pose. If nothing else "
            "moves, import the images as views of a still scene with --group views; otherwise use --group stills."
        )


def _world(images: Images, world: World, place: str) -> tuple[Float64[np.ndarray, "view 4 4"], bool]:
    """world_from_camera of each view, and whether its world was put on the table."""
    given = None if images.world_from_camera is None else np.array(images.world_from_camera[0], np.float64)
    if given is None and world == "given":
        raise UsageError(f"{place} has no poses; leave out --world given, or add poses.")
    if given is None and images.depth.shape[1] > 1:
        raise UsageError(f"{place} has several views without poses; add poses, or import with --group stills.")
    if given is not None and world != "table":
        return given, False
    table = _table_pose(images, place)
    if given is None:
        return table[None], True
    return table @ invert_rigid(given[0]) @ given, True


def _table_pose(images: Images, place: str) -> Pose:
    """world_from_camera of the first view, in a world on the table of the first image that has a depth."""
    depth, k = images.depth[:, 0], images.k[0, 0]
    number = next((number for number, image in enumerate(depth) if (image > 0).any()), 0)
    rows, columns = np.nonzero(depth[number] > 0)
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=-1) @ np.linalg.inv(k).T
    points = rays * depth[number][rows, columns, None].astype(np.float64)
    try:
        return pose_over_table(points)
    except UsageError:
        raise UsageError(
            f"{place} has no poses, and no plane was found that could be the table; add a pose, see docs/import.md."
        ) from None


def _labels(images: Images, rows: int, place: str) -> SceneRecord:
    """Fields of the masks, with ids from 1 on in the order of the original ones."""
    assert images.ids is not None
    found = np.unique(images.ids)
    objects = found[found > 0]
    if len(objects) > MOST_OBJECTS:
        raise UsageError(f"{place} has {len(objects)} objects; expected at most {MOST_OBJECTS}.")
    ids = np.where(images.ids > 0, 1 + np.searchsorted(objects, images.ids), 0).astype(np.uint8)
    count = len(objects)
    pad = [(0, 0), (0, 0), (0, rows - count)]
    record = {
        "segmentation": ids,
        "objects/count": np.asarray(count, np.uint8),
        "visibility/visible_pixels": np.pad(visible_pixels(ids, count), pad) if count else _zeros(ids, rows, np.uint32),
        "boxes/box_2d": np.pad(boxes_2d(ids, count), [*pad, (0, 0)]),
    }
    names = [(images.categories or {}).get(int(one), "") for one in objects] + [""] * (rows - count)
    return {**record, "objects/category": np.array([_ascii(name) for name in names], "S")}


def _zeros(ids: np.ndarray, rows: int, dtype: type) -> np.ndarray:
    return np.zeros((*ids.shape[:2], rows), dtype)


def _ascii(name: str) -> bytes:
    """Printable ASCII of a name, at least one letter wide so that texts have a type."""
    kept = "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in name[:_LONGEST_NAME])
    return kept.encode("ascii")
