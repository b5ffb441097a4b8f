"""Observations: each object in each image of a split, and the outcome of a run for it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64, Integer

from benchmark.metrics.contingency import contingency
from benchmark.metrics.errors_by_type import errors_by_type
from benchmark.metrics.overlap import intersection_over_union
from datagen.storage.reader import Split, read_depth


@dataclass(frozen=True, eq=False)
class Objects:
    """One result for each object in each image that shows it, ordered by scene, frame, view and object."""

    scene: Int64[np.ndarray, "observation"]
    frame: Int64[np.ndarray, "observation"]
    view: Int64[np.ndarray, "observation"]
    companions: Int64[np.ndarray, "observation"]
    """Objects in the same image, itself included."""
    pixels: Int64[np.ndarray, "observation"]
    hidden: Float64[np.ndarray, "observation"] | None
    """Share of the object that is occluded or outside the image; None if the dataset lacks it."""
    gap: Float64[np.ndarray, "observation"] | None
    """Metres to the nearest other object, infinite beyond 2 cm; None if the dataset lacks it."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one run, or of several seeds, for all observations."""

    overlap: Float64[np.ndarray, "observation"]
    """Best IoU with a slot other than the background's; its mean is MSC-FG, except for the weights of frames."""
    errors: Float64[np.ndarray, "observation type"]
    """Share of the seeds that make each error of `ERROR_TYPES`."""


Truth = tuple[Integer[np.ndarray, "frame view height width"], Bool[np.ndarray, "frame view height width"]]
"""Object ids of a scene, and the pixels that are ignored because they have no depth."""


def read_truth(scenes: Split, scene: int) -> Truth:
    """Read the ground truth of a scene."""
    return scenes.read(scene, ["segmentation"])["segmentation"], ~read_depth(scenes, scene)[1]


def observe(scenes: Split) -> Objects:
    """List the observations of a whole split."""
    wanted = ("visibility/visible_fraction", "contacts/gap")
    fields = [name for name in wanted if name in scenes.fields()]
    parts = [
        _observe_scene(index, read_truth(scenes, index), scenes.read(index, fields)) for index in range(len(scenes))
    ]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    always = (joined[name] for name in ("scene", "frame", "view", "companions", "pixels"))
    return Objects(*always, hidden=joined.get("hidden"), gap=joined.get("gap"))


def _observe_scene(scene: int, truth: Truth, record: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    segmentation, ignore = truth
    pixels = object_pixels(np.where(ignore, 0, segmentation))
    frame, view, item = np.nonzero(pixels)
    found = {
        "scene": np.full(len(frame), scene),
        "frame": frame,
        "view": view,
        "companions": np.count_nonzero(pixels, axis=2)[frame, view],
        "pixels": pixels[frame, view, item],
    }
    if (visible := record.get("visibility/visible_fraction")) is not None:
        found["hidden"] = 1.0 - visible[frame, view, item].astype(np.float64)
    if (gaps := record.get("contacts/gap")) is not None:
        found["gap"] = nearest_gap(gaps)[frame, item]
    return found


def object_pixels(
    segmentation: Integer[np.ndarray, "frame view height width"],
) -> Int64[np.ndarray, "frame view object"]:
    """Count the pixels of every object; object i has id i + 1."""
    ids = np.arange(1, int(segmentation.max(initial=0)) + 1)
    counts = np.count_nonzero(segmentation[..., None] == ids, axis=(2, 3))
    return counts.astype(np.int64)


def nearest_gap(gaps: Float[np.ndarray, "frame body body"]) -> Float64[np.ndarray, "frame object"]:
    """Distance of each object to the nearest other one; body 0 is the table and does not count."""
    between = gaps[:, 1:, 1:].astype(np.float64)
    return np.where(np.eye(between.shape[1], dtype=bool), np.inf, between).min(axis=2, initial=np.inf)


def scene_tables(
    truth: Integer[np.ndarray, "frame view height width"],
    ignore: Bool[np.ndarray, "frame view height width"],
    labels: Integer[np.ndarray, "frame view height width"],
    background_slot: int,
) -> Int64[np.ndarray, "frame view truth slot"]:
    """Compute the contingency tables of all images of a scene; slots keep their numbers."""
    frames, views = truth.shape[:2]
    true, dropped, found = (part.reshape(frames * views, *part.shape[2:]) for part in (truth, ignore, labels))
    tables, _ = contingency(true, found, background_slot, dropped)
    return tables.reshape(frames, views, *tables.shape[1:])


def outcome_of_scene(
    tables: Int64[np.ndarray, "frame view truth slot"], background_slot: int
) -> tuple[Float64[np.ndarray, "observation"], Bool[np.ndarray, "observation type"]]:
    """Compute overlap and errors of the objects of one scene, in the order of `Objects`."""
    present = tables[:, :, 1:].sum(axis=3) > 0
    views = [tables[:, view] for view in range(tables.shape[1])]
    overlaps = [np.delete(intersection_over_union(part)[:, 1:], background_slot, axis=2) for part in views]
    best = np.stack([part.max(axis=2, initial=0.0) for part in overlaps], axis=1)
    errors = np.stack([errors_by_type(part, background_slot) for part in views], axis=1)
    return best[present], errors[present]
