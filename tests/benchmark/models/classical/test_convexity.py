import dataclasses

import numpy as np
import pytest

from benchmark.metrics import clip_scores
from benchmark.models.classical.convexity import Convexity, normals
from benchmark.models.classical.points import scene_points
from benchmark.models.interface import Clip
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


def raised(*tiles: tuple[slice | int, slice | int, float]) -> Clip:
    """An image from a height of 1 m, 3.6 cm a pixel, of a table and level tiles: rows, columns, and depth in metres."""
    clip, _ = balls(np.zeros((1, 0, 3)), size=32)
    depth = np.ones_like(clip.depth)
    for rows, columns, distance in tiles:
        depth[0, 0, rows, columns] = distance
    return dataclasses.replace(clip, depth=depth)


@pytest.mark.parametrize(("height", "segments"), [(0.05, 1), (0.15, 2)])
def test_tiles_that_only_a_gap_separates_are_divided_if_it_is_large(height: float, segments: int):
    """Tiles of one colour, one above the other. Neighbours that are 6.3 cm apart begin to repel each other."""
    clip = raised((slice(8, 16), slice(8, 16), 0.9), (slice(8, 16), slice(16, 24), 0.9 - height))
    labels = Convexity().segment(clip).labels[0, 0]
    assert labels.max() == segments
    assert (labels[8:16, 8:16] == 1).all()
    assert (labels[8:16, 16:24] == segments).all()


@pytest.mark.parametrize(("pixels", "label"), [(5, 1), (9, 0)])
def test_specks_join_segments_within_four_gaps(pixels: int, label: int):
    """A gap is 1.75 pixels wide."""
    clip = raised((slice(8, 16), slice(8, 16), 0.9), (10, 15 + pixels, 0.9))
    assert Convexity().segment(clip).labels[0, 0, 10, 15 + pixels] == label


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
