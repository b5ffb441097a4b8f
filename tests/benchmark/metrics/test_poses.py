from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.metrics.poses import (
    BOX_GROUP,
    POSE_METRICS,
    TruePoses,
    box_orientation_error,
    orientation_error,
    pose_scores,
)
from benchmark.models.interface import Poses
from datagen.shapes.symmetry import symmetry_rotations

SIZE = np.array([0.1, 0.06, 0.04])
NAN = np.full(3, np.nan)


def world(symmetry: tuple[str, ...] = ("C1", "C1")) -> tuple[TruePoses, np.ndarray]:
    """Two objects in one frame of one view; the first covers 8 pixels, the second 4, of 24."""
    truth = np.zeros((1, 1, 4, 6), np.int64)
    truth[0, 0, :2, :4], truth[0, 0, 3, :4] = 1, 2
    rotation = Rotation.random(2, random_state=0).as_matrix()
    center = np.array([[0.1, 0.2, 0.05], [-0.1, 0.0, 0.03]])
    box = Rotation.random(2, random_state=1).as_matrix()
    visible = center + np.array([0.0, 0.0, 0.03])
    return TruePoses(rotation[None], symmetry, center[None], box, np.stack([SIZE, SIZE]), visible[None, None]), truth


def right(true: TruePoses) -> Poses:
    """Predict the true poses, with the background's row first."""
    center = np.concatenate([NAN[None], true.box_center[0]])
    rotation = np.concatenate([np.full((1, 3, 3), np.nan), true.rotation[0] @ true.box_rotation])
    size = np.concatenate([NAN[None], true.box_size])
    return Poses(center[None, None], rotation[None, None], size[None, None])


def scores(true: TruePoses, found: Poses, truth: np.ndarray, labels: np.ndarray | None = None, **more: object) -> dict:
    values = pose_scores(true, found, truth, truth if labels is None else labels, 0, **more)
    assert tuple(values) == POSE_METRICS
    return {name: float(array[0]) for name, array in values.items()}


def test_the_truth_has_no_error():
    true, truth = world()
    found = scores(true, right(true), truth)
    assert (found["posed"], found["box_iou"]) == (1.0, pytest.approx(1))
    for name in ("translation_error", "translation_median", "orientation_error", "orientation_median"):
        assert found[name] == pytest.approx(0, abs=1e-5)
    assert found["translation_error_visible"] == pytest.approx(0.03)
    assert found["orientation_error_named"] > 10


def test_places_are_measured_in_metres():
    true, truth = world()
    off = right(true)
    off.center[0, 0, 1] += [0.03, 0.0, 0.04]
    found = scores(true, off, truth)
    assert found["translation_error"] == pytest.approx(0.025)
    assert found["translation_median"] == pytest.approx(0.025)
    assert found["box_iou"] < 1


def test_labels_may_be_named_anyhow():
    true, truth = world()
    given = right(true)
    swapped = Poses(*(array[:, :, [0, 2, 1]] for array in (given.center, given.rotation, given.size)))
    labels = np.array([0, 2, 1])[truth]
    assert scores(true, swapped, truth, labels) == scores(true, given, truth)


def test_an_object_that_is_not_found_counts_for_the_boxes_alone():
    true, truth = world()
    split = truth.copy()
    split[0, 0, 0, :4] = 3
    found = scores(true, right(true), truth, split)
    assert found["posed"] == 0.5
    assert found["box_iou"] == pytest.approx(0.5)
    assert found["translation_error"] == pytest.approx(0, abs=1e-9)
    nothing = scores(true, right(true), truth, np.zeros_like(truth))
    assert (nothing["posed"], nothing["box_iou"]) == (0, 0)
    assert np.isnan(nothing["translation_error"])


def test_the_background_slot_finds_nothing():
    true, truth = world()
    labels = np.where(truth == 1, 0, 3)
    center = np.broadcast_to(true.box_center[:, None, :1], (1, 1, 4, 3)).copy()
    assert scores(true, Poses(center), truth, labels)["posed"] == 0


def test_slots_without_a_pose_have_found_nothing():
    true, truth = world()
    given = right(true)
    given.center[0, 0, 2] = np.nan
    assert scores(true, given, truth)["posed"] == 0.5
    few = Poses(given.center[:, :, :1])
    assert scores(true, few, truth)["posed"] == 0


def test_what_a_model_does_not_give_is_not_scored():
    true, truth = world()
    found = scores(true, Poses(right(true).center), truth)
    assert found["translation_error"] == 0
    assert all(np.isnan(found[name]) for name in ("orientation_error", "orientation_error_named", "box_iou"))
    nothing = scores(true, Poses(right(true).center), truth, np.zeros_like(truth))
    assert nothing["posed"] == 0
    assert np.isnan(nothing["box_iou"])


def test_balls_have_no_orientation():
    true, truth = world(("SO3", "C1"))
    given = right(true)
    given.rotation[0, 0, 1] = np.eye(3)
    assert scores(true, given, truth)["orientation_error"] == pytest.approx(0, abs=1e-5)
    balls = replace(true, symmetry=("SO3", "SO3"))
    assert np.isnan(scores(balls, given, truth)["orientation_error"])


def test_pixels_that_are_ignored_find_nothing():
    true, truth = world()
    labels = np.where(truth == 2, 0, truth)
    ignored = truth == 2
    assert scores(true, right(true), truth, labels)["posed"] == 0.5
    assert scores(true, right(true), truth, labels, ignore=ignored)["posed"] == 1


def test_images_have_values_of_their_own():
    true, truth = world()
    twice = TruePoses(
        np.repeat(true.rotation, 2, axis=0),
        true.symmetry,
        np.repeat(true.box_center, 2, axis=0),
        true.box_rotation,
        true.box_size,
        np.repeat(true.visible_center, 2, axis=0),
    )
    given = right(true)
    found = Poses(*(np.concatenate([array, array]) for array in (given.center, given.rotation, given.size)))
    found.center[1] += 0.01
    values = pose_scores(twice, found, np.concatenate([truth, truth]), np.concatenate([truth, truth]), 0)
    assert values["translation_error"] == pytest.approx([0, 0.01 * np.sqrt(3)])
    assert values["translation_median"].shape == (1,)


GROUPS = ("C1", "C2", "C5", "D1", "D2", "D4", "D6", "Cinf", "Dinf", "O", "SO3")


def rotations(count: int, seed: int = 0) -> np.ndarray:
    return Rotation.random(count, random_state=seed).as_matrix()


def turned(degrees: float, axis: str) -> np.ndarray:
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


@pytest.mark.parametrize("symmetry", GROUPS)
def test_turning_an_object_by_its_own_symmetry_is_no_error(symmetry: str):
    for truth, found in zip(rotations(5), rotations(5, seed=1), strict=True):
        expected = orientation_error(found, truth, symmetry)
        for element in symmetry_rotations(symmetry, steps=7):
            assert orientation_error(truth @ element, truth, symmetry) == pytest.approx(0, abs=1e-5)
            assert orientation_error(found @ element, truth, symmetry) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("symmetry", ["Cinf", "Dinf"])
def test_continuous_groups_are_the_limit_of_finite_ones(symmetry: str):
    for truth, found in zip(rotations(20), rotations(20, seed=1), strict=True):
        fine = orientation_error(found, truth, symmetry.replace("inf", "720"))
        assert orientation_error(found, truth, symmetry) == pytest.approx(fine, abs=0.3)
        assert orientation_error(found, truth, symmetry) <= fine + 1e-6


@pytest.mark.parametrize(
    ("degrees", "axis", "symmetry", "expected"),
    [
        (30, "z", "C1", 30),
        (179, "z", "C1", 179),
        (170, "z", "C2", 10),
        (80, "z", "D4", 10),
        (77, "z", "Cinf", 0),
        (77, "x", "Cinf", 77),
        (177, "x", "Dinf", 3),
        (177, "x", "C4", 177),
        (90, "y", "O", 0),
        (123, "y", "SO3", 0),
        (1e-6, "x", "C1", 1e-6),
    ],
)
def test_what_is_left_of_a_turn(degrees: float, axis: str, symmetry: str, expected: float):
    truth = rotations(1)[0]
    assert orientation_error(truth @ turned(degrees, axis), truth, symmetry) == pytest.approx(expected, abs=1e-8)


def test_how_the_axes_of_a_box_are_named_makes_no_difference():
    truth, box = rotations(2)
    for naming in BOX_GROUP:
        assert box_orientation_error(truth @ box @ naming, truth, "C1", box) == pytest.approx(0, abs=1e-5)
        off = truth @ turned(10, "x") @ box @ naming
        assert box_orientation_error(off, truth, "C1", box) == pytest.approx(10)


def test_a_symmetric_object_may_have_another_of_its_boxes():
    """A cylinder has as many boxes of least volume as there are turns about its axis."""
    truth, box = rotations(1)[0], np.eye(3)
    assert box_orientation_error(truth @ turned(33, "z"), truth, "Dinf", box) == pytest.approx(0, abs=1e-5)
    assert box_orientation_error(truth @ turned(33, "z"), truth, "D2", box) == pytest.approx(33)


def test_what_chance_gives():
    """The figures beside the tables of `benchmark.ranking.columns`; Mackenzie (1958) has 40.7 degrees for cubes."""
    truth, found = np.eye(3), rotations(4000)
    assert np.mean([orientation_error(f, truth, "C1") for f in found]) == pytest.approx(126.5, abs=1.5)
    assert np.mean([box_orientation_error(f, truth, "C1", truth) for f in found]) == pytest.approx(40.7, abs=0.6)
