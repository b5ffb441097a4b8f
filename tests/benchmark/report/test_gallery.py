"""Which scenes and which of their images are chosen, and boxes in images of moving cameras."""

from pathlib import Path

import numpy as np

from benchmark.metrics.errors_by_type import ERROR_TYPES
from benchmark.report.gallery import (
    corners_in_images,
    disagreements,
    errors_in_words,
    telling_image,
    typical_scenes,
    worst_scenes,
)
from benchmark.report.observations import Objects
from datagen.config import Rig
from datagen.storage.reader import Dataset, read_camera_poses
from tests.worlds import moving_cameras, rendered

NAN = np.nan


def test_the_worst_scenes_come_first_and_undefined_ones_never() -> None:
    assert worst_scenes(np.array([0.5, NAN, 0.1, 0.9]), 2) == [2, 0]
    assert worst_scenes(np.array([NAN, 0.3]), 5) == [1]


def test_disagreement_counts_in_both_directions_and_equal_scenes_are_none() -> None:
    a, b = np.array([0.5, 0.9, 0.2, NAN]), np.array([0.5, 0.1, 0.9, 0.4])
    assert disagreements(a, b, 4) == [1, 2]
    assert disagreements(b, a, 1) == [1]


def test_typical_scenes_are_the_middling_one_and_then_the_hardest() -> None:
    scores = [np.array([0.9, 0.1, 0.5, NAN]), np.array([0.9, 0.3, 0.5, NAN])]
    assert typical_scenes(scores, 3, range(4)) == [2, 1, 0]
    assert typical_scenes(scores, 3, [0, 2]) == [0, 2]
    assert typical_scenes([np.array([NAN])], 2, [0]) == []


def test_the_telling_image_has_the_largest_mean() -> None:
    values = np.array([1.0, 0.0, 0.8, 0.7, 9.0])
    assert telling_image(OBJECTS, 0, values) == (0, 1, 0)
    assert telling_image(OBJECTS, 1, values) == (1, 0, 0)


def test_errors_of_an_image_are_counted_in_words() -> None:
    errors = np.zeros((5, len(ERROR_TYPES)))
    errors[2:4, ERROR_TYPES.index("merged")] = 1
    errors[3, ERROR_TYPES.index("switched")] = 1
    assert errors_in_words(OBJECTS, (0, 1, 0), errors) == "2 merged, 1 switched"
    assert errors_in_words(OBJECTS, (0, 0, 0), errors) == "no error"


def test_boxes_surround_their_objects_in_images_of_moving_cameras(tmp_path: Path):
    record = rendered.record(moving_cameras.orbiting())
    scenes = Dataset(rendered.write_dataset(tmp_path / "a", [record], rig=Rig(motion="orbit"))).split("train")
    corners = record["boxes/box_3d"][2, :3].astype(float)
    center, size = corners.mean(axis=1), np.ptp(corners, axis=1)  # upright boxes that hold the true ones
    arrays = (center, np.tile(np.eye(3), (3, 1, 1)), size)
    boxes = tuple(np.broadcast_to(array, (3, 1, *array.shape)) for array in arrays)
    (drawn,) = corners_in_images(boxes, record["camera/K"], read_camera_poses(scenes, 0), [(2, 0)])
    for row, (left, top, right, bottom) in enumerate(record["boxes/box_2d"][2, 0, :3].astype(float)):
        low, high = drawn[row].min(axis=0), drawn[row].max(axis=0)
        assert np.all(low <= [left + 1, top + 1])
        assert np.all(high >= [right - 1, bottom - 1])
        assert np.all(high - low < 2.5 * np.array([right - left, bottom - top]))


OBJECTS = Objects(
    scene=np.array([0, 0, 0, 0, 1]),
    frame=np.array([0, 0, 1, 1, 0]),
    view=np.zeros(5, np.int64),
    companions=np.array([2, 2, 2, 2, 1]),
    pixels=np.full(5, 9),
    hidden=None,
    gap=None,
)
