import dataclasses

import numpy as np
import pytest

from benchmark.models.classical.above_plane import standing
from benchmark.models.classical.points import cell_ids, pixel_width, scene_points, viewpoints, voxels
from datagen.geometry import transform
from tests.worlds.sphere_clips import clip_and_truth, turned, with_noise


def test_points_are_the_worlds_seen_from_the_first_camera():
    clip, truth = clip_and_truth(frames=1, views=3)
    world = transform(clip.world_from_camera[0], scene_points(clip))
    assert np.max(np.abs(world[truth == 0][:, 2])) < 1e-3
    cameras = transform(clip.world_from_camera[0], viewpoints(clip))
    np.testing.assert_allclose(cameras, clip.world_from_camera[:, :3, 3], atol=1e-9)


def test_points_do_not_depend_on_the_world():
    clip, _ = clip_and_truth(frames=1, views=2)
    np.testing.assert_allclose(scene_points(turned(clip, 0.7)), scene_points(clip), atol=1e-9)


def test_what_stands_is_what_is_no_table():
    clip, truth = clip_and_truth(views=2)
    mask = standing(clip, scene_points(clip), seed=0)
    assert np.mean(mask == (truth > 0)) > 0.998
    noisy = with_noise(clip)
    assert np.mean(standing(noisy, scene_points(noisy), seed=0)[truth == 0]) < 0.005


def test_cells_are_equal_only_where_points_share_a_cube():
    points = np.array([[0.001, 0.001, 0.001], [0.003, 0.0, 0.0039], [-0.001, 0.001, 0.001], [0.001, 0.005, 0.001]])
    ids = cell_ids(points, 0.004)
    assert ids[0] == ids[1]
    assert len(set(ids.tolist())) == 3


def test_voxels_say_where_every_point_went():
    points = np.random.default_rng(0).random((200, 3))
    first, cell, counts = voxels(points, 0.25)
    assert np.all(np.floor(points[first][cell] / 0.25) == np.floor(points / 0.25))
    np.testing.assert_array_equal(counts, np.bincount(cell))
    assert len(first) == len(np.unique(np.floor(points / 0.25), axis=0))


def test_pixels_widen_with_depth_and_shrink_with_focal_length():
    clip, _ = clip_and_truth(frames=1)
    far = dataclasses.replace(clip, depth=2 * clip.depth)
    assert pixel_width(far) == pytest.approx(2 * pixel_width(clip))
    assert pixel_width(dataclasses.replace(clip, k=2 * clip.k)) == pytest.approx(pixel_width(clip) / 2)
