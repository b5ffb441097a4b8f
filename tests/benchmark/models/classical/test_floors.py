import numpy as np
import pytest

from benchmark.metrics import clip_scores
from benchmark.models.classical.floors import AllBackground, ConstantGrid, OneCluster, RandomSlots, grid_cells
from tests.worlds.sphere_clips import clip_and_truth


def test_one_cluster_is_an_object_as_large_as_the_picture():
    clip, truth = clip_and_truth()
    prediction = OneCluster().segment(clip)
    scores = clip_scores(truth, prediction.labels, prediction.background)
    shares = [np.mean([np.mean(frame == i) for i in np.unique(frame[frame > 0])]) for frame in truth]
    np.testing.assert_allclose(scores["msc_fg"], shares)
    assert np.all(scores["ari_fg"] == 0)
    assert np.all(scores["ari"] == 0)
    assert np.all(scores["miou_bg"] == 0)


def test_all_background_covers_no_object():
    clip, truth = clip_and_truth()
    prediction = AllBackground().segment(clip)
    scores = clip_scores(truth, prediction.labels, prediction.background)
    assert np.all(scores["msc_fg"] == 0)
    assert np.all(scores["ari_fg"] == 0)
    np.testing.assert_allclose(scores["miou_bg"], np.mean(truth == 0, axis=(1, 2, 3)))


def test_random_slots_are_uniform_and_agree_with_nothing():
    (clip, truth), (other, _) = clip_and_truth(0), clip_and_truth(1)
    labels = RandomSlots(5).segment(clip).labels
    assert np.all(np.abs(np.bincount(labels.ravel()) / labels.size - 0.2) < 0.02)
    assert np.mean(RandomSlots(5).segment(other).labels == labels) == pytest.approx(0.2, abs=0.02)
    scores = clip_scores(truth, labels, 0)
    assert np.all(np.abs(scores["ari"]) < 0.02)
    assert np.all(np.abs(scores["ari_fg"]) < 0.05)


def test_the_grid_is_the_same_in_every_image():
    clip, _ = clip_and_truth(frames=2, views=2)
    prediction = ConstantGrid(6).segment(clip)
    assert prediction.background_slot is None
    assert np.all(prediction.labels == prediction.labels[0, 0])


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 7, 9, 11, 12])
def test_cells_are_rectangles_of_about_equal_size(count: int):
    grid = grid_cells(48, 64, count)
    areas = np.bincount(grid.ravel())
    assert len(areas) == count
    assert areas.max() < 2.1 * areas.min()
    for cell in range(count):
        rows, columns = np.nonzero(grid == cell)
        assert (np.ptp(rows) + 1) * (np.ptp(columns) + 1) == areas[cell]
