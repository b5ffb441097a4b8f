"""Images of a recording as the record of a scene: one pose per view, a world frame, compact ids, stored units."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from datagen.errors import NoTable, UsageError
from datagen.formats.import_request import Grouping, World
from datagen.formats.importers.interface import Images
from datagen.formats.importers.plan import MOST_OBJECTS
from datagen.formats.importers.resample import resampled
from datagen.geometry import invert_rigid, quaternion_from_rotation, rigid
from datagen.pipeline.records import boxes_2d, visible_pixels
from datagen.rgbd.camera_pose import Pose
from datagen.rgbd.images import Size
from datagen.rgbd.table import pose_over_table
from datagen.schema import FIELDS, MAX_DEPTH, SceneRecord, encode_depth

ALWAYS = ("rgb", "depth", "camera/K", "camera/world_from_camera")
"""Fields of every imported scene."""
WITH_MASKS = ("segmentation", "objects/count", "visibility/visible_pixels", "boxes/box_2d")
"""Further fields of scenes with masks."""
WITH_NAMES = ("objects/category",)
"""Further field of scenes whose objects have names."""
WITH_POSES = ("poses/position", "poses/quaternion_wxyz")
"""Further fields of scenes whose objects have poses."""
WITH_MODELS = (
    "objects/size", "objects/symmetry", "objects/minimum_box_center", "objects/minimum_box_rotation",
    "objects/minimum_box_size", "boxes/box_3d",
)  # fmt: skip
"""Further fields of scenes whose objects have poses and models."""
_STILL_METRES, _STILL_RADIANS, _STILL_PIXELS = 0.002, 0.004, 0.01
"""Largest differences of poses and camera matrices over a clip that count as a static camera."""
_SAME_PLACE = 0.02
"""Largest difference of an object's positions between the views of a scene, metres; labels by hand are rough."""
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


def fields_of(images: Images) -> tuple[str, ...]:
    """Names of the fields that images give."""
    known = {
        WITH_MASKS: images.ids,
        WITH_NAMES: images.categories,
        WITH_POSES: images.camera_from_object,
        WITH_MODELS: images.models,
    }
    return (*ALWAYS, *(name for names, values in known.items() if values is not None for name in names))


def convert(images: Images, target: Target, place: str, fields: frozenset[str]) -> tuple[SceneRecord, Measured]:
    """Convert images to a record with these fields; `place` names them in messages.

    Raises:
        UsageError: a field is unknown, the camera moves in a clip, several views have no poses or disagree on those of
            objects, no table is found, or there are too many objects.
    """
    if missing := sorted(fields - set(fields_of(images))):
        raise UsageError(
            f"{place} has no {', '.join(missing)}, but other scenes of its split do; import them into two datasets."
        )
    # Images of the target size, with the time axis that the grouping asks for.
    images = resampled(images, target.size)
    if target.grouping == "views":
        images = _as_views(images, place)
    _check_static(images, place)
    # World, and depth that the format can hold.
    poses, estimated = _world(images, target.world, place)
    too_far = images.depth > MAX_DEPTH
    depth = np.where(too_far, np.float32(0), images.depth)
    record = {
        "rgb": images.rgb,
        "depth": encode_depth(depth),
        "camera/K": np.array(images.k[0], np.float64),
        "camera/world_from_camera": poses,
    }
    # Labels, and poses of the labelled objects.
    if "segmentation" in fields:
        objects = _object_ids(images, place)
        record |= _labels(images, objects)
        if "poses/position" in fields:
            record |= _poses(images, poses, (objects - 1).tolist(), place)
    known = images.depth[images.depth > 0]
    measured = Measured(
        depth=float(np.median(known)) if len(known) else 0.0,
        missing=float(np.mean(images.depth == 0)),
        too_far=float(np.mean(too_far)),
        estimated_world=estimated,
    )
    return {name: _padded(name, record[name], target.rows) for name in fields}, measured


def _as_views(images: Images, place: str) -> Images:
    """Turn images over time into views of one still scene."""
    if images.depth.shape[1] > 1:
        raise UsageError(f"{place} has several views already; leave out --group views.")
    arrays = ("rgb", "depth", "k", "world_from_camera", "ids", "camera_from_object")
    turned = {name: getattr(images, name) for name in arrays if getattr(images, name) is not None}
    return replace(images, **{name: np.swapaxes(array, 0, 1) for name, array in turned.items()})


def _check_static(images: Images, place: str) -> None:
    if np.max(np.abs(images.k - images.k[:1])) > _STILL_PIXELS:
        raise UsageError(
            f"{place}: the camera matrix changes in the clip, but each camera has one. Import with --group stills, or "
            "with --group views if nothing moves."
        )
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
    except NoTable:
        raise UsageError(
            f"{place} has no poses, and no plane was found that could be the table; add a pose, see docs/import.md."
        ) from None


def _object_ids(images: Images, place: str) -> Int64[np.ndarray, " object"]:
    """Ids of the objects that the masks show."""
    assert images.ids is not None
    found = np.unique(images.ids)
    if len(objects := found[found > 0]) > MOST_OBJECTS:
        raise UsageError(f"{place} has {len(objects)} objects; expected at most {MOST_OBJECTS}.")
    return objects


def _labels(images: Images, objects: Int64[np.ndarray, " object"]) -> SceneRecord:
    """Fields of the masks, with ids from 1 on in the order of the original ones."""
    assert images.ids is not None
    ids = np.where(images.ids > 0, 1 + np.searchsorted(objects, images.ids), 0).astype(np.uint8)
    names = images.categories or {}
    return {
        "segmentation": ids,
        "objects/count": np.asarray(len(objects), np.uint8),
        "visibility/visible_pixels": visible_pixels(ids, len(objects)),
        "boxes/box_2d": boxes_2d(ids, len(objects)),
        "objects/category": np.array([_ascii(names.get(one, "")) for one in objects.tolist()], "S"),
    }


def _poses(images: Images, cameras: Float64[np.ndarray, "view 4 4"], rows: list[int], place: str) -> SceneRecord:
    """Fields of the poses and models of some objects; poses are those that the first view gives."""
    assert images.camera_from_object is not None
    # All views must agree on where objects are.
    every = cameras[:, None] @ images.camera_from_object[:, :, rows]
    apart = float(np.max(np.ptp(every[..., :3, 3], axis=1), initial=0))
    if apart > _SAME_PLACE:
        raise UsageError(
            f"{place}: positions of an object differ by {apart:.3g} m between the views; expected a still scene. "
            "Import with --group stills."
        )
    poses = every[:, 0]
    turns = [quaternion_from_rotation(pose[:3, :3]) for pose in poses.reshape(-1, 4, 4)]
    record = {
        "poses/position": poses[..., :3, 3].astype(np.float32),
        "poses/quaternion_wxyz": np.reshape(turns, (*poses.shape[:2], 4)).astype(np.float32),
    }
    if images.models is None:
        return record
    # Facts of the models, and boxes at the stored poses.
    models = [images.models[row] for row in rows]
    stored = rigid(record["poses/position"], record["poses/quaternion_wxyz"])
    corners = np.reshape([model.box.corners for model in models], (-1, 8, 3))
    return {
        **record,
        "objects/size": np.reshape([model.size for model in models], (-1, 3)),
        "objects/symmetry": np.array([model.symmetry.encode() for model in models], "S"),
        "objects/minimum_box_center": np.reshape([model.box.center for model in models], (-1, 3)),
        "objects/minimum_box_rotation": np.reshape([model.box.rotation for model in models], (-1, 3, 3)),
        "objects/minimum_box_size": np.reshape([model.box.size for model in models], (-1, 3)),
        "boxes/box_3d": np.einsum("foij,ocj->foci", stored[..., :3, :3], corners) + stored[..., None, :3, 3],
    }


def _padded(name: str, values: np.ndarray, rows: int) -> np.ndarray:
    """Fill the object axis of a field, if it has one, with zeros."""
    axes = FIELDS[name].axes
    if "object" not in axes:
        return values
    values = np.asarray(values, FIELDS[name].dtype)
    shape = (rows if axis == "object" else length for axis, length in zip(axes, values.shape, strict=True))
    padded = np.zeros((*shape,), values.dtype)
    padded[tuple(slice(length) for length in values.shape)] = values
    return padded


def _ascii(name: str) -> bytes:
    """First 60 characters of a name, with `?` for what is not printable ASCII."""
    kept = "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in name[:_LONGEST_NAME])
    return kept.encode("ascii")
