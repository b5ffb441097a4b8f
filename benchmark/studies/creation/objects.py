"""What a model infers of single objects, beside what the generator knows of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, Integer

from benchmark.metrics.contingency import contingency
from benchmark.metrics.overlap import intersection_over_union
from datagen.errors import UsageError
from datagen.geometry import rotation_from_quaternion
from datagen.schema import SceneRecord
from datagen.storage.reader import Dataset
from obpose.data.clips import observation_of, select_part
from obpose.data.datasets import SceneDataset
from obpose.data.resolution import fitting_model
from obpose.scenes.model_ref import Origin

LEAST_OBJECTS = 20
"""For probes to say anything."""
LEAST_IOU = 0.5
"""Of an object's pixels and a slot's, above which the slot has found the object."""
PLAIN = "plain"
"""The pattern of objects of one colour."""


@dataclass(frozen=True, eq=False)
class Objects:
    """Objects that slots have found, one row each: one frame of each object."""

    scene: Int[np.ndarray, "object"]
    what: Float[np.ndarray, "object latent"]
    """z_what, mean of the posterior."""
    place: Float[np.ndarray, "object 3"]
    """T_hat, metres, world frame."""
    shape: np.ndarray
    """Name in the catalogue, text."""
    colour: Float[np.ndarray, "object 3"]
    """First colour, sRGB 0..1."""
    plain: np.ndarray
    """Whether it has no other, bool."""
    size: Float[np.ndarray, "object"]
    """Edge of the cube with the volume of its box, metres."""
    position: Float[np.ndarray, "object 3"]
    """Of the middle of its box, metres, world frame."""
    missed: int
    """Objects that were in view in some frame, and no slot's in any."""


def infer_objects(origin: Origin, folder: Path, split: str, scenes: int) -> Objects:
    """Of the first view of the first scenes of a split; of an object's frames the middle one in which it is found.

    Raises:
        UsageError: there are too few.
    """
    records, source = Dataset(folder).split(split), SceneDataset(folder, split)
    rows, missed = [], 0
    for index in range(min(scenes, len(records))):
        observation = select_part(observation_of([source.window(index, 0, source.frames_of_clip)]), views=slice(1))
        found = fitting_model(origin.model, observation).segment(observation)
        record = records[index]
        truth, labels = record["segmentation"][:, 0], found.labels[0, :, 0].numpy()
        what, place = (
            values[0].numpy().astype(np.float64) for values in (found.inference.what.z, found.inference.boxes.center)
        )
        followed = dict(_middle_frames(truth, labels))
        missed += len(set(np.unique(truth)) - {0}) - len(followed)
        for row, (frame, slot) in followed.items():
            rows.append(
                {"scene": index, "what": what[frame, slot], "place": place[frame, slot], **facts(record, row, frame)}
            )
    if len(rows) < LEAST_OBJECTS:
        raise UsageError(
            f"{len(rows)} objects of {split} were found; expected {LEAST_OBJECTS} or more: give more scenes."
        )
    return Objects(missed=missed, **{name: np.array([row[name] for row in rows]) for name in rows[0]})


def facts(record: SceneRecord, row: int, frame: int) -> dict[str, object]:
    """What the generator knows of an object."""
    rotation = rotation_from_quaternion(record["poses/quaternion_wxyz"][frame, row].astype(np.float64))
    middle = record["poses/position"][frame, row] + rotation @ record["objects/minimum_box_center"][row]
    return {
        "shape": bytes(record["objects/category"][row]).decode(),
        "colour": record["objects/color"][row, 0].astype(np.float64),
        "plain": bytes(record["objects/pattern"][row]).decode() == PLAIN,
        "size": float(np.prod(record["objects/minimum_box_size"][row], dtype=np.float64) ** (1 / 3)),
        "position": middle.astype(np.float64),
    }


def _middle_frames(
    truth: Integer[np.ndarray, "frame height width"], labels: Integer[np.ndarray, "frame height width"]
) -> Iterator[tuple[int, tuple[int, int]]]:
    """Objects that are found in some frame: their rows, and the middle one of these frames with the slot there."""
    tables, _ = contingency(truth, labels)
    pairs = np.argwhere(intersection_over_union(tables)[:, 1:, 1:] > LEAST_IOU)
    for row in np.unique(pairs[:, 1]):
        mine = pairs[pairs[:, 1] == row]
        frame, _, slot = mine[len(mine) // 2]
        yield int(row), (int(frame), int(slot))
