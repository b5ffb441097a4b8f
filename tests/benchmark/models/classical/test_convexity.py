import dataclasses

import numpy as np
import pytest

from benchmark.metrics import clip_scores
from benchmark.models.classical.convexity import Convexity, average_linkage, normals
from benchmark.models.classical.points import scene_points
from tests.worlds.sphere_clips import balls


def by_hand(count: int, pairs: np.ndarray, attractions: np.ndarray) -> np.ndarray:
    """Average linkage by its definition: all means between all segments, recomputed after each join."""
    segment = np.arange(count)
    while True:
        means = {}
        for one in np.unique(segment):
            for other in np.unique(segment[segment > one]):
                here = segment[pairs]
                edges = ((here == [[one], [other]]).all(axis=0)) | ((here == [[other], [one]]).all(axis=0))
                if edges.any():
                    means[one, other] = attractions[edges].mean()
        if not means or max(means.values()) <= 0:
            return segment
        one, other = max(means, key=means.__getitem__)
        segment[segment == other] = one


@pytest.mark.parametrize("seed", range(20))
def test_average_linkage_is_as_defined(seed: int):
    rng = np.random.default_rng(seed)
    pairs = np.array([(i, j) for i in range(9) for j in range(i) if rng.random() < 0.5]).T
    attractions = rng.normal(0.2, 1, pairs.shape[1])
    found, expected = average_linkage(9, pairs, attractions), by_hand(9, pairs, attractions)
    assert np.array_equal(found[:, None] == found, expected[:, None] == expected)


def test_nodes_without_edges_stay_alone():
    assert average_linkage(3, np.zeros((2, 0), int), np.zeros(0)).tolist() == [0, 1, 2]


def touching() -> tuple:
    """Two balls of one colour, 9 cm in diameter and 9.1 cm apart, seen from above."""
    return balls(np.array([[[-0.0455, 0, 0.045], [0.0455, 0, 0.045]]]), size=128)


def test_balls_that_touch_are_divided_where_they_meet():
    clip, truth = touching()
    assert clip_scores(truth, Convexity(concavity=3.0, gap=10.0).segment(clip).labels)["ari_fg"][0] > 0.85
    flat = Convexity(concavity=0.0, gap=10.0).segment(clip).labels
    assert clip_scores(truth, flat)["ari_fg"][0] == 0  # nothing else tells them apart


def test_a_convex_body_stays_whole():
    clip, truth = balls(np.array([[[0.0, 0, 0.045]]]), size=128)
    labels = Convexity(concavity=20.0).segment(clip).labels
    assert clip_scores(truth, labels)["msc_fg"][0] > 0.95


def test_colour_divides_what_shape_does_not():
    clip, truth = touching()
    painted = np.where((truth == 1)[..., None], [200, 40, 40], [40, 40, 200]).astype(np.uint8)
    options = {"concavity": 0.0, "gap": 10.0}
    labels = Convexity(**options).segment(dataclasses.replace(clip, rgb=painted)).labels
    assert clip_scores(truth, labels)["ari_fg"][0] > 0.95


def test_normals_of_balls_point_outwards():
    clip, truth = touching()
    points = scene_points(clip)[0, 0]
    centers = np.array([[-0.0455, 0, 0.045], [0.0455, 0, 0.045]])
    camera = np.linalg.inv(clip.world_from_camera[0])
    centers = centers @ camera[:3, :3].T + camera[:3, 3]
    found = normals(points, clip.valid[0, 0])
    for name, center in enumerate(centers, start=1):
        outward = points[truth[0, 0] == name] - center
        cosine = (found[truth[0, 0] == name] * outward).sum(axis=-1) / np.linalg.norm(outward, axis=-1)
        assert np.median(cosine) > 0.98


def test_pixels_without_neighbours_have_no_normal():
    valid = np.zeros((5, 5), bool)
    valid[2, 2] = True
    assert not np.any(normals(np.ones((5, 5, 3)), valid))
