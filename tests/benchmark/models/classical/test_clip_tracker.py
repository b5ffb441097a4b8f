import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.metrics import clip_scores
from benchmark.models.classical.clip_tracker import ClipTracker, follow_clearest
from benchmark.models.classical.plane_dbscan import PlaneDbscan
from obpose.contact.motion.tracking import COLOUR_SCALE, LEAST_POINTS, Cloud, kabsch, move, split
from tests.worlds.sphere_clips import balls

STEPS = np.linspace(-0.12, 0.12, 7)


def meeting() -> np.ndarray:
    """Two balls of 4.5 cm radius, which are apart only in the first frames."""
    gap = np.array([0.2, 0.16, 0.13, 0.11, 0.095, 0.091, 0.091])
    y = 0.05 * np.arange(7) - 0.15
    middle = np.stack([np.zeros(7), y, np.full(7, 0.045)], axis=-1)
    apart = np.stack([gap / 2, np.zeros(7), np.zeros(7)], axis=-1)
    return np.stack([middle - apart, middle + apart], axis=1)


@pytest.mark.parametrize("order", [1, -1], ids=["forwards", "backwards"])
def test_balls_that_meet_stay_two_objects(order: int):
    clip, truth = balls(meeting()[::order])
    labels, plain = (model.segment(clip).labels for model in (ClipTracker(), PlaneDbscan()))
    assert clip_scores(truth, labels)["ari_fg_video"] > 0.8
    assert clip_scores(truth, labels)["identity_switches"] == 0
    assert np.min(clip_scores(truth, plain)["ari_fg"]) == 0  # one cluster where they touch: the clip is needed


@pytest.mark.parametrize("order", [1, -1], ids=["enters", "leaves"])
def test_an_object_that_enters_or_leaves_has_a_label_of_its_own(order: int):
    """The frame with most components is the one without it, because three others are apart only there."""
    apart, touching = ([cube(3) * 0.01 + [gap * place, 0, 0] for place in (-1, 0, 1)] for gap in (0.05, 0.04))
    side = cube(3)[:9] * 0.01 + [0, 0.1, 0]
    frames = [np.concatenate(apart), np.concatenate([*touching, side])][::order]
    assert [split(points, 0.025).max() + 1 for points in frames] == [3, 2][::order]
    labels = follow_clearest([Cloud(points, np.zeros_like(points)) for points in frames], 0.025)
    expected = [np.repeat(range(3), 27), np.repeat(range(4), [27, 27, 27, 9])][::order]
    assert all(np.array_equal(*pair) for pair in zip(labels, expected, strict=True))


def test_a_hidden_object_returns_under_its_label():
    there = np.stack([STEPS, np.zeros(7), np.full(7, 0.045)], axis=-1)
    clouds = [Cloud(points + 0.003 * cube(5), np.zeros((125, 3))) for points in there]
    clouds[3] = Cloud(np.zeros((0, 3)), np.zeros((0, 3)))
    labels = follow_clearest(clouds, 0.02)
    assert [np.unique(found).tolist() for found in labels] == [[0], [0], [0], [], [0], [0], [0]]


def test_a_clip_without_points_has_no_labels():
    assert [len(found) for found in follow_clearest([Cloud(np.zeros((0, 3)), np.zeros((0, 3)))] * 3, 0.02)] == [0, 0, 0]


def test_the_frame_with_most_components_decides():
    two = np.concatenate([cube(3) * 0.01, cube(3) * 0.01 + [0.05, 0, 0]])
    one = np.concatenate([cube(3) * 0.01, cube(3) * 0.01 + [0.03, 0, 0]])
    clouds = [Cloud(points, np.zeros_like(points)) for points in (one, two, one)]
    assert [len(np.unique(found)) for found in follow_clearest(clouds, 0.012)] == [2, 2, 2]


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_frames_with_as_many_components_the_one_with_more_points_decides(order: int):
    """A green cube touches a red one in a frame where a part of the blue one is hidden, and the blue one elsewhere."""
    cubes = [cube(3) * 0.01 + [place, 0, 0] for place in (0, 0.05, 0.08)]
    colours = np.repeat(COLOUR_SCALE * np.eye(3), 27, axis=0)
    whole = np.concatenate(cubes)
    partial = np.concatenate([cubes[0], cubes[1] - [0.02, 0, 0], cubes[2][:18]])
    assert [split(points, 0.012)[[0, 27, 54]].tolist() for points in (partial, whole)] == [[0, 0, 1], [0, 1, 1]]
    found = follow_clearest([Cloud(points, colours[: len(points)]) for points in (partial, whole)][::order], 0.012)
    expected = [np.repeat([0, 1], [27, len(points) - 27]) for points in (partial, whole)][::order]
    assert all(np.array_equal(*pair) for pair in zip(found, expected, strict=True))


def test_specks_join_the_nearest_object():
    speck = np.tile([0.1, 0, 0], (LEAST_POINTS - 1, 1))
    labels = follow_clearest([Cloud(np.concatenate([cube(3) * 0.01, speck]), np.zeros((27 + len(speck), 3)))], 0.02)[0]
    assert np.all(labels == labels[0])


def test_points_are_connected_over_gaps_up_to_the_limit():
    points = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0], [0.05, 0, 0]])
    assert split(points, 0.011).tolist() == [0, 0, 0, 1]
    assert split(points, 0.031).tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("seed", range(3))
def test_a_rigid_motion_is_recovered(seed: int):
    rng = np.random.default_rng(seed)
    points, rotation = rng.normal(size=(20, 3)), Rotation.from_rotvec(0.3 * rng.normal(size=3) / np.sqrt(3)).as_matrix()
    target = points @ rotation.T + [1.0, 2.0, 3.0]
    assert np.allclose(kabsch(points, target), rotation)
    assert np.allclose(move(points, (points, target), turning=True), target)
    assert np.allclose(move(points, (points, target), turning=False) - points, (target - points).mean(axis=0))


def test_a_reflection_is_not_a_rotation():
    points = np.random.default_rng(0).normal(size=(20, 3))
    assert np.isclose(np.linalg.det(kabsch(points, points * [1, 1, -1])), 1)


def cube(edge: int) -> np.ndarray:
    """Integer points of a solid cube."""
    return np.stack(np.meshgrid(*[np.arange(edge)] * 3), axis=-1).reshape(-1, 3).astype(float)
