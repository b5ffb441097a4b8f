import dataclasses

import numpy as np
import pytest
from fabricated import scene_record, spheres_recipe

from benchmark.baselines.plane_dbscan import PlaneDbscan, PlaneDbscanConfig, cell_ids, pixel_width
from benchmark.interface import Clip
from benchmark.metrics import score
from datagen import schema
from datagen.geometry import rigid


def clip_of(record: schema.SceneRecord) -> Clip:
    depth = schema.decode_depth(record["depth"])
    return Clip(record["rgb"], depth, depth > 0, record["camera/K"], record["camera/world_from_camera"])


def clip_and_truth(seed: int = 0, spheres: int = 3, **recipe: object) -> tuple[Clip, np.ndarray]:
    record = scene_record(spheres_recipe(**recipe), [seed], spheres)
    return clip_of(record), record["segmentation"]


def fitted(seed: int = 0) -> PlaneDbscan:
    model = PlaneDbscan()
    model.fit([], [], seed=seed, budget=1.0)
    return model


@pytest.mark.parametrize("seed", range(3))
def test_separate_objects_are_found_exactly(seed: int):
    clip, truth = clip_and_truth(seed)
    prediction = fitted().segment(clip)
    scores = score(truth[:, 0], prediction.labels[:, 0], 0)
    assert prediction.background_slot == 0
    assert scores["ari_fg"] == 1
    assert scores["msc_fg"] > 0.98
    assert scores["miou_bg"] > 0.99


def test_views_share_their_labels():
    clip, truth = clip_and_truth(frames=1, views=3)
    labels = fitted().segment(clip).labels
    scores = score(truth.reshape(1, -1, 64), labels.reshape(1, -1, 64))
    assert scores["ari_fg"] == 1
    assert scores["msc_fg"] > 0.98


def test_holes_are_background_and_harm_nothing_else():
    clip, truth = clip_and_truth(spheres=4)
    valid = np.random.default_rng(0).random(clip.depth.shape) > 0.2
    holed = dataclasses.replace(clip, depth=np.where(valid, clip.depth, 0).astype(np.float32), valid=valid)
    labels = fitted().segment(holed).labels
    assert np.all(labels[~valid] == 0)
    scores = score(truth[:, 0], labels[:, 0], ignore=~valid[:, 0])
    assert scores["ari_fg"] == 1
    assert scores["msc_fg"] > 0.97


def with_noise(clip: Clip) -> Clip:
    noise = np.random.default_rng(0).normal(0, 0.002, clip.depth.shape)
    return dataclasses.replace(clip, depth=(clip.depth + noise).astype(np.float32))


def test_noise_of_the_sensor_raises_no_table():
    clip, truth = clip_and_truth()
    scores = score(truth[:, 0], fitted().segment(with_noise(clip)).labels[:, 0])
    assert scores["miou_bg"] > 0.99
    assert scores["ari_fg"] > 0.95


def test_an_empty_table_is_all_background():
    clip, _ = clip_and_truth(spheres=0)
    assert not np.any(fitted().segment(clip).labels)


def test_a_clip_without_depth_is_all_background():
    clip, _ = clip_and_truth()
    blind = dataclasses.replace(clip, depth=np.zeros_like(clip.depth), valid=np.zeros_like(clip.valid))
    assert not np.any(fitted().segment(blind).labels)


@pytest.mark.parametrize("quaternion", [(0.0, 1.0, 0.0, 0.0), (0.5, 0.5, 0.5, 0.5), (0.5, -0.5, 0.5, 0.5)])
def test_turning_the_world_changes_no_cluster(quaternion: tuple[float, ...]):
    clip, _ = clip_and_truth()
    turned_from_world = rigid(np.array([0.3, -2.0, 1.0]), np.array(quaternion))
    turned = dataclasses.replace(clip, world_from_camera=turned_from_world @ clip.world_from_camera)
    labels, expected = fitted().segment(turned).labels[:, 0], fitted().segment(clip).labels[:, 0]
    assert score(expected, labels)["ari"] == 1


def test_equal_seeds_give_equal_labels_whatever_came_before():
    clip, other = (with_noise(clip_and_truth(seed)[0]) for seed in range(2))
    # With no height to spare, the least change of the plane shows in the labels.
    config = PlaneDbscanConfig(least_height=0.0, noise_factor=0.0)
    model, twin, stranger = PlaneDbscan(config), PlaneDbscan(config), PlaneDbscan(config)
    for segmenter, seed in ((model, 5), (twin, 5), (stranger, 6)):
        segmenter.fit([], [], seed=seed, budget=1.0)
    first = model.segment(clip).labels
    model.segment(other)
    assert np.array_equal(model.segment(clip).labels, first)
    assert np.array_equal(twin.segment(clip).labels, first)
    assert not np.array_equal(stranger.segment(clip).labels, first)


def test_voxels_change_no_cluster():
    clip, _ = clip_and_truth(frames=1, views=3)
    fine, usual, huge = (
        PlaneDbscan(PlaneDbscanConfig(voxel=size)).segment(clip).labels for size in (1e-6, 0.004, 10.0)
    )
    assert score(fine[0], usual[0])["ari"] == 1
    # Points that share a voxel are each other's neighbours, so that none of them is alone.
    assert np.array_equal(fine > 0, huge > 0)


def test_cells_are_equal_only_where_points_share_a_cube():
    points = np.array([[0.001, 0.001, 0.001], [0.003, 0.0, 0.0039], [-0.001, 0.001, 0.001], [0.001, 0.005, 0.001]])
    ids = cell_ids(points, 0.004)
    assert ids[0] == ids[1]
    assert len(set(ids.tolist())) == 3


def test_pixels_widen_with_depth_and_shrink_with_focal_length():
    clip, _ = clip_and_truth(frames=1)
    far = dataclasses.replace(clip, depth=2 * clip.depth)
    assert pixel_width(far) == pytest.approx(2 * pixel_width(clip))
    assert pixel_width(dataclasses.replace(clip, k=2 * clip.k)) == pytest.approx(pixel_width(clip) / 2)
