import numpy as np

from benchmark.metrics import clip_scores
from benchmark.models.classical.plane_dbscan import LARGEST_MOVE, PlaneDbscan, PlaneDbscanTracked, follow
from tests.worlds.sphere_clips import balls

STEPS = np.linspace(-0.3, 0.3, 9)


def crossing() -> np.ndarray:
    """Two balls that pass each other 30 cm apart, 7.5 cm a frame."""
    there = np.stack([np.full(9, 0.15), STEPS, np.full(9, 0.045)], axis=-1)
    return np.stack([there, there * [-1, -1, 1]], axis=1)


def test_balls_that_pass_each_other_keep_their_labels():
    clip, truth = balls(crossing())
    tracked, plain = (model.segment(clip).labels for model in (PlaneDbscanTracked(), PlaneDbscan()))
    assert clip_scores(truth, tracked)["ari_fg_video"] == 1
    assert clip_scores(truth, tracked)["identity_switches"] == 0
    # Without tracking the labels follow the positions, and the test would be empty if they did not.
    assert clip_scores(truth, plain)["ari_fg_video"] < 0.5


def test_frames_by_themselves_are_those_of_plane_dbscan():
    clip, _ = balls(crossing())
    tracked, plain = (model.segment(clip).labels for model in (PlaneDbscanTracked(), PlaneDbscan()))
    assert np.all(clip_scores(plain, tracked)["ari"] == 1)


def dots(*frames: dict[int, float]) -> tuple[np.ndarray, np.ndarray]:
    """Clusters of one pixel, {label: x in metres}, and their points."""
    labels, points = np.zeros((len(frames), 1, 1, 4), int), np.zeros((len(frames), 1, 1, 4, 3))
    for frame, clusters in enumerate(frames):
        for pixel, (label, x) in enumerate(clusters.items()):
            labels[frame, 0, 0, pixel], points[frame, 0, 0, pixel, 0] = label, x
    return labels, points


def names(*frames: dict[int, float]) -> list[list[int]]:
    return [[label for label in frame.ravel().tolist() if label] for frame in follow(*dots(*frames))]


def test_labels_follow_the_nearest_centroid():
    assert names({1: 0.0, 2: 0.5}, {1: 0.55, 2: 0.05}, {1: 0.1, 2: 0.6}) == [[1, 2], [2, 1], [1, 2]]


def test_what_jumps_is_a_new_object():
    assert names({1: 0.0}, {1: 1.01 * LARGEST_MOVE}) == [[1], [2]]
    assert names({1: 0.0}, {1: 0.99 * LARGEST_MOVE}) == [[1], [1]]


def test_what_jumps_takes_no_label_from_what_stays():
    # The sum of all distances would be least if the first took the label of what is gone.
    assert names({1: 0.0, 2: 0.1}, {1: 0.08, 2: 5.0}) == [[1, 2], [2, 3]]


def test_what_hides_comes_back_under_its_label():
    assert names({1: 0.0, 2: 0.5}, {1: 0.5}, {}, {1: 0.02, 2: 0.5}) == [[1, 2], [2], [], [1, 2]]


def test_two_clusters_never_share_a_label_in_one_frame():
    assert names({1: 0.0}, {1: 0.01, 2: -0.02}) == [[1], [1, 2]]
