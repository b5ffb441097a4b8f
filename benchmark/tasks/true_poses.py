"""Ground truth of the objects' poses, in the form that pose scores need."""

import numpy as np
from jaxtyping import Float, Integer

from benchmark.metrics.poses import TruePoses
from benchmark.models.interface import Clip
from datagen.geometry import rotation_from_quaternion
from datagen.storage.reader import Split

_FIELDS = (
    "objects/count",
    "objects/symmetry",
    "objects/minimum_box_center",
    "objects/minimum_box_rotation",
    "objects/minimum_box_size",
    "poses/position",
    "poses/quaternion_wxyz",
)


def read_true_poses(
    scenes: Split, index: int, clip: Clip, truth: Integer[np.ndarray, "frame view height width"]
) -> TruePoses:
    """Read the true poses of one scene, whose object ids are `truth`."""
    record = scenes.read(index, _FIELDS)
    count = int(record["objects/count"])
    rotation = rotation_from_quaternion(record["poses/quaternion_wxyz"][:, :count].astype(np.float64))
    middle = record["objects/minimum_box_center"][:count].astype(np.float64)
    position = record["poses/position"][:, :count].astype(np.float64)
    return TruePoses(
        rotation=rotation,
        symmetry=tuple(bytes(name).decode() for name in record["objects/symmetry"][:count]),
        box_center=position + np.einsum("foij,oj->foi", rotation, middle),
        box_rotation=record["objects/minimum_box_rotation"][:count].astype(np.float64),
        box_size=record["objects/minimum_box_size"][:count].astype(np.float64),
        visible_center=visible_centers(clip, truth, count),
    )


def visible_centers(
    clip: Clip, truth: Integer[np.ndarray, "frame view height width"], count: int
) -> Float[np.ndarray, "frame view object 3"]:
    """Mean of the visible points of each object in each image, metres, world frame; nan if it shows none."""
    points = clip.points()
    centers = np.full((*truth.shape[:2], count, 3), np.nan)
    for frame, view, row in np.ndindex(*centers.shape[:3]):
        mine = (truth[frame, view] == row + 1) & clip.valid[frame, view]
        if mine.any():
            centers[frame, view, row] = points[frame, view][mine].mean(axis=0)
    return centers
