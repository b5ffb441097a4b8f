import dataclasses

import numpy as np

from benchmark.models.classical.plane_hdbscan import PlaneHdbscan, adopt_lone
from tests.worlds.sphere_clips import balls

ONE_BALL = np.array([[[0.0, 0.0, 0.045]]])


def test_a_lone_object_is_found():
    clip, truth = balls(ONE_BALL)
    assert np.array_equal(PlaneHdbscan().segment(clip).labels, truth)


def test_groups_smaller_than_the_least_are_background():
    clip, truth = balls(ONE_BALL)
    assert not np.any(PlaneHdbscan(least_cells=int(np.sum(truth > 0)) + 1).segment(clip).labels)


def test_lone_points_join_the_nearest_cluster_within_the_distance():
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [0.4, 0, 0], [1.6, 0, 0], [0.0, 0, 0.6]])
    labels = np.array([1, 2, 0, 0, 0])
    np.testing.assert_array_equal(adopt_lone(points, labels, 0.5), [1, 2, 1, 0, 0])
    np.testing.assert_array_equal(adopt_lone(points, labels, 5.0), [1, 2, 1, 2, 1])
    np.testing.assert_array_equal(adopt_lone(points, np.zeros(5, int), 5.0), np.zeros(5))
    np.testing.assert_array_equal(adopt_lone(points, np.ones(5, int), 5.0), np.ones(5))


def test_a_speck_far_from_all_objects_is_background():
    clip, truth = balls(ONE_BALL)
    depth = clip.depth.copy()
    depth[..., 5, 5] -= 0.05
    assert np.array_equal(PlaneHdbscan().segment(dataclasses.replace(clip, depth=depth)).labels, truth)
