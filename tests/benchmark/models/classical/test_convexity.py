import dataclasses

import numpy as np

from benchmark.metrics import clip_scores
from benchmark.models.classical.convexity import Convexity, normals
from benchmark.models.classical.points import scene_points
from tests.worlds.sphere_clips import balls


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
