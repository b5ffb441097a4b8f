import dataclasses

import numpy as np

from benchmark.metrics import clip_scores
from benchmark.models.classical.kmeans import KMeansXyzRgb
from tests.worlds.sphere_clips import arbitrary, balls, with_holes

ROLL = np.stack([[[-0.2 + x, 0.15, 0.045], [0.2 - x, -0.15, 0.045]] for x in np.linspace(0, 0.4, 6)])


def coloured_balls():
    """A red and a blue ball that pass each other on a grey table."""
    clip, truth = balls(ROLL)
    colours = np.array([[90, 90, 90], [250, 10, 10], [10, 10, 250]], np.uint8)
    return dataclasses.replace(clip, rgb=colours[truth]), truth


def test_colours_are_found_and_keep_their_slots():
    clip, truth = coloured_balls()
    prediction = KMeansXyzRgb(3).segment(clip)
    scores = clip_scores(truth, prediction.labels, prediction.background)
    assert prediction.background_slot is None
    assert np.all(scores["ari"] == 1)
    assert scores["ari_fg_video"] == 1


def test_position_alone_cuts_up_the_table():
    clip, truth = coloured_balls()
    assert np.mean(clip_scores(truth, KMeansXyzRgb(3, colour=0.0).segment(clip).labels)["ari"]) < 0.1


def test_holes_change_nothing_where_there_is_depth():
    clip, truth = coloured_balls()
    holed = with_holes(clip, 0.2)
    assert np.all(clip_scores(truth, KMeansXyzRgb(3).segment(holed).labels, 0, ~holed.valid)["ari"] == 1)


def test_fewer_points_than_slots_join_what_there_was():
    clip = arbitrary(0, frames=3)
    valid = clip.valid.copy()
    valid[0] = valid[2] = False
    valid[0, 0, 0, :3] = valid[2, 0, 0, :3] = True
    labels = KMeansXyzRgb(5).segment(dataclasses.replace(clip, valid=valid)).labels
    assert not np.any(labels[0])
    assert len(np.unique(labels[1])) == 5
