"""Scores of poses: errors of position, orientation and box size of the objects that a model has found.

An object is found by the slot that has more than half of the union of their pixels in an image. Such pairs are one to
one without any matching (Kirillov et al., Panoptic Segmentation, 2019), and what overlaps less is not the same thing,
so that a distance between the two would mean nothing.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from benchmark.metrics.box_overlap import Box, box_overlap
from benchmark.metrics.contingency import contingency
from benchmark.metrics.overlap import intersection_over_union
from datagen.shapes.symmetry import is_continuous, symmetry_rotations

BOX_GROUP = symmetry_rotations("O")
"""The 24 rotations that map the axes of a box to axes of the box."""


def orientation_error(found: Float[np.ndarray, "3 3"], truth: Float[np.ndarray, "3 3"], symmetry: str) -> float:
    """Angle in degrees between an orientation and the nearest one that looks like the true one.

    Rotations are world from object; `symmetry` is the name of the body's exact group in the object's frame. 0 for what
    looks the same however it is turned.

    >>> quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> [round(orientation_error(quarter, np.eye(3), symmetry)) for symmetry in ("C1", "C4")]
    [90, 0]
    """
    return float(_least_angles((truth.T @ found)[None], symmetry)[0])


def box_orientation_error(
    found: Float[np.ndarray, "3 3"],
    truth: Float[np.ndarray, "3 3"],
    symmetry: str,
    box: Float[np.ndarray, "3 3"],
) -> float:
    """Angle between orientations of a box whose axes have no names, in degrees.

    `found` is world from box, its axes named anyhow; `box` holds the axes of the body's box of least volume in the
    object's frame. The object's orientation would be `found @ naming @ box.T` with one of the 24 namings; the one that
    suits the truth best counts.
    """
    return float(_least_angles(truth.T @ found @ BOX_GROUP @ box.T, symmetry).min())


def _least_angles(relative: Float[np.ndarray, "n 3 3"], symmetry: str) -> Float[np.ndarray, "n"]:
    """Degrees between rotations of the object's frame and the nearest rotation of the group."""
    if symmetry == "SO3":
        return np.zeros(len(relative))
    if is_continuous(symmetry):
        # A turn about z can undo all but the tilt of the z axis; Dinf may also turn it upside down.
        up, aside = relative[:, 2, 2], np.hypot(relative[:, 0, 2], relative[:, 1, 2])
        return np.degrees(np.arctan2(aside, np.abs(up) if symmetry.startswith("D") else up))
    group = symmetry_rotations(symmetry)
    # ||A - B||_F = 2 sqrt 2 sin(angle / 2); more exact than the arc cosine of the trace where angles are small.
    chords = np.linalg.norm(relative[:, None] - group, axis=(2, 3)).min(axis=1)
    return np.degrees(2 * np.arcsin(np.minimum(chords / np.sqrt(8.0), 1.0)))


LEAST_IOU = 0.5
"""IoU of an object's pixels and a slot's above which the slot has found the object."""

POSE_METRICS = (
    "posed", "translation_error", "translation_median", "translation_error_visible",
    "orientation_error", "orientation_median", "orientation_error_named", "box_iou",
)  # fmt: skip
"""Names of the scores in the order of tables; see `pose_scores`. Smaller errors are better."""

_ERRORS = ("translation_error", "translation_error_visible", "orientation_error", "orientation_error_named")
_MEDIANS = {"translation_median": "translation_error", "orientation_median": "orientation_error"}


@dataclass(frozen=True, eq=False)
class Poses:
    """Oriented bounding boxes of the objects, one row per label: row 3 belongs to label 3 of that image.

    World frame, metres. Rows of labels without a pose, such as the background's, are nan.
    """

    center: Float[np.ndarray, "frame view label 3"]
    """Centre of the box of the whole object, hidden parts included."""
    rotation: Float[np.ndarray, "frame view label 3 3"] | None = None
    """World from box; None if the model has no orientations. The order of the box's axes does not matter."""
    size: Float[np.ndarray, "frame view label 3"] | None = None
    """Side lengths of the box along its axes; None if the model has no sizes. It requires `rotation`."""


@dataclass(frozen=True, eq=False)
class TruePoses:
    """True poses of the objects of a clip, in the generator's order: object i has id i + 1. World frame, metres."""

    rotation: Float[np.ndarray, "frame object 3 3"]
    """Rotations, world from object."""
    symmetry: tuple[str, ...]
    """Name of each object's exact rotation group, in its own frame."""
    box_center: Float[np.ndarray, "frame object 3"]
    """Centre of the box of least volume around the whole object."""
    box_rotation: Float[np.ndarray, "object 3 3"]
    """Rotation of that box, object from box."""
    box_size: Float[np.ndarray, "object 3"]
    visible_center: Float[np.ndarray, "frame view object 3"]
    """Mean of the surface points of its pixels; nan where it has none."""

    def box(self, frame: int, row: int) -> Box:
        """Box of an object."""
        rotation = self.rotation[frame, row] @ self.box_rotation[row]
        return self.box_center[frame, row], rotation, self.box_size[row]


def visible_centers(
    points: Float[np.ndarray, "frame view height width 3"],
    valid: Bool[np.ndarray, "frame view height width"],
    truth: Integer[np.ndarray, "frame view height width"],
    count: int,
) -> Float[np.ndarray, "frame view object 3"]:
    """Mean of the valid points of each object in each image, metres; nan if it shows none."""
    centers = np.full((*truth.shape[:2], count, 3), np.nan)
    for frame, view, row in np.ndindex(*centers.shape[:3]):
        mine = (truth[frame, view] == row + 1) & valid[frame, view]
        if mine.any():
            centers[frame, view, row] = points[frame, view][mine].mean(axis=0)
    return centers


def pose_scores(
    true: TruePoses,
    found: Poses,
    truth: Integer[np.ndarray, "frame view height width"],
    labels: Integer[np.ndarray, "frame view height width"],
    background_slot: int,
    ignore: Bool[np.ndarray, "frame view height width"] | None = None,
) -> dict[str, np.ndarray]:
    """Score the poses of a clip: one value a frame and view, means over its objects; medians one for the clip.

    - `posed`: share of the objects in view that a slot with a pose has found; what follows but `box_iou` is of them.
    - `translation_error`: metres from the middle of the object's true box, `translation_median` of all in the clip.
    - `translation_error_visible`: metres from the mean of its visible points, which are on the side of the camera. A
      model that only averages what it sees is good at this and not at the former.
    - `orientation_error`: degrees modulo the object's exact symmetries and the names of the box's axes, which nothing
      in images says: the fair one. `orientation_median` is of all in the clip.
    - `orientation_error_named`: degrees modulo the symmetries alone, from the frame in which the generator defines the
      object. Only a model that is told of these frames can know them.
    - `box_iou`: of the box with the true one; an object that was not found counts 0.

    Objects that look the same however they are turned (balls) have no orientation and are left out of its errors. nan
    where nothing is to be measured: no object in view, none found, or the model gives no such thing.
    """
    frames, views, *image = truth.shape
    true_ids, slots = (array.reshape(-1, *image) for array in (truth, labels))
    ignored = None if ignore is None else ignore.reshape(-1, *image)
    tables, slot = contingency(true_ids, slots, background_slot, ignored)
    overlap = intersection_over_union(tables)
    overlap[:, :, slot] = 0.0
    every = [
        _image_errors(true, found, *divmod(index, views), overlap=overlap[index], seen=tables[index].sum(axis=1) > 0)
        for index in range(frames * views)
    ]
    scores = {name: np.array([_mean(errors[name]) for errors in every]) for name in (*_ERRORS, "posed", "box_iou")}
    medians = {name: np.concatenate([errors[of] for errors in every]) for name, of in _MEDIANS.items()}
    scores |= {name: np.array([np.median(all_) if len(all_) else np.nan]) for name, all_ in medians.items()}
    return {name: scores[name] for name in POSE_METRICS}


def _image_errors(
    true: TruePoses,
    found: Poses,
    frame: int,
    view: int,
    *,
    overlap: Float[np.ndarray, "truth slot"],
    seen: Bool[np.ndarray, "truth"],
) -> dict[str, np.ndarray]:
    """Score one image: a value per found object, or for `posed` and `box_iou` per object in view."""
    # Objects and the labels that have found them and have a pose.
    centers = found.center[frame, view]
    matches = np.argwhere(overlap[1:] > LEAST_IOU).tolist()
    pairs = [(row, label) for row, label in matches if label < len(centers) and np.isfinite(centers[label]).all()]
    missed = [0.0] * (int(seen[1:].sum()) - len(pairs))
    errors: dict[str, list[float]] = {name: [] for name in _ERRORS}
    errors |= {"posed": [1.0] * len(pairs) + missed, "box_iou": [] if found.size is None else missed}
    for row, label in pairs:
        # Position.
        center = found.center[frame, view, label]
        errors["translation_error"].append(float(np.linalg.norm(center - true.box_center[frame, row])))
        visible = true.visible_center[frame, view, row]
        errors["translation_error_visible"].append(float(np.linalg.norm(center - visible)))
        if found.rotation is None:
            continue
        # Orientation, and the box.
        rotation = found.rotation[frame, view, label]
        if true.symmetry[row] != "SO3":
            pose, symmetry = true.rotation[frame, row], true.symmetry[row]
            errors["orientation_error"].append(box_orientation_error(rotation, pose, symmetry, true.box_rotation[row]))
            errors["orientation_error_named"].append(orientation_error(rotation, pose, symmetry))
        if found.size is not None:
            box = center, rotation, found.size[frame, view, label]
            errors["box_iou"].append(box_overlap(box, true.box(frame, row)))
    return {name: np.array(values) for name, values in errors.items()}


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else np.nan
