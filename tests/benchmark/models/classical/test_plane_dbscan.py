import numpy as np

from benchmark.metrics import clip_scores
from benchmark.models.classical.plane_dbscan import PlaneDbscan
from benchmark.models.interface import Clip
from tests.worlds.sphere_clips import balls, clip_and_truth

NEAR = np.array([[[-0.075, 0, 0.045], [0.075, 0, 0.045]]])
"""Two balls, their surfaces 5 cm apart; a pixel is 2 cm wide."""


def objects(model: PlaneDbscan, clip: Clip) -> int:
    return int(model.segment(clip).labels.max())


def coloured(clip: Clip, truth: np.ndarray, *colours: tuple[int, int, int]) -> Clip:
    for ball, colour in enumerate(colours, start=1):
        clip.rgb[truth == ball] = colour
    return clip


def test_views_share_their_labels():
    clip, truth = clip_and_truth(frames=1, views=3)
    labels = PlaneDbscan(reach=3.0).segment(clip).labels
    # One image made of all views: the metrics then ask for equal labels in all of them.
    scores = clip_scores(truth.reshape(1, 1, -1, 64), labels.reshape(1, 1, -1, 64))
    assert scores["ari_fg"] == 1
    assert scores["msc_fg"] > 0.98


def test_reach_joins_what_is_near_and_is_in_pixels():
    coarse, fine = (balls(NEAR, size)[0] for size in (64, 128))
    assert objects(PlaneDbscan(reach=2.0), coarse) == 2
    assert objects(PlaneDbscan(reach=5.0), coarse) == 1
    assert objects(PlaneDbscan(reach=5.0), fine) == 2


def test_colour_parts_what_touches():
    clip, truth = balls(np.array([[[-0.045, 0, 0.045], [0.045, 0, 0.045]]]))
    assert objects(PlaneDbscan(colour=1.0), clip) == 1
    parted = coloured(clip, truth, (250, 10, 10), (10, 10, 250))
    assert objects(PlaneDbscan(), parted) == 1
    assert objects(PlaneDbscan(colour=2.0), parted) == 2


def test_colour_parts_no_more_than_its_weight():
    clip, truth = balls(np.array([[[-0.045, 0, 0.045], [0.045, 0, 0.045]]]))
    shades = coloured(clip, truth, (100, 100, 100), (120, 120, 120))
    assert objects(PlaneDbscan(colour=2.0), shades) == 1
