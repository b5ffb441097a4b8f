import dataclasses
from typing import Any

import numpy as np
import pytest

from datagen.config import Recipe, load_recipe
from datagen.sampling import sample_scene
from datagen.sampling.cameras import sample_cameras
from datagen.verify.cameras import check_cameras


def recipe(**rig: Any) -> Recipe:
    moving = load_recipe("moving")
    return dataclasses.replace(moving, frames=6, views=2, rig=dataclasses.replace(moving.rig, **rig))


def paths(wanted: Recipe, seed: int = 0) -> np.ndarray:
    """Poses by frame and view."""
    cameras = sample_cameras(wanted, np.random.default_rng(seed))
    return np.array([[camera.at(frame).world_from_camera for camera in cameras] for frame in range(wanted.frames)])


@pytest.mark.parametrize("motion", ["orbit", "linear", "handheld"])
def test_paths_start_at_the_rigs_pose_and_move(motion: str):
    poses = paths(recipe(motion=motion))
    np.testing.assert_allclose(poses[0], paths(recipe())[0], atol=2e-6)
    assert np.all(np.max(np.abs(np.diff(poses[:, :, :3, 3], axis=0)), axis=-1) > 1e-4)


def test_an_orbit_covers_its_angle():
    poses = paths(recipe(motion="orbit", orbit=90.0))
    cosine = np.sum(poses[0, :, :2, 3] * poses[-1, :, :2, 3], axis=-1) / np.sum(poses[0, :, :2, 3] ** 2, axis=-1)
    np.testing.assert_allclose(cosine, 0, atol=1e-4)


def test_a_hands_tremor_depends_on_the_seed_and_has_the_given_strength():
    one, same, other = (paths(recipe(motion="handheld"), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    long = dataclasses.replace(recipe(motion="handheld", shake=0.02), frames=400, views=1)
    spread = np.std(np.concatenate([paths(long, seed)[:, 0, :3, 3] for seed in range(3)]), axis=0)
    assert np.all((spread > 0.012) & (spread < 0.04))


def test_scenes_differ_from_their_still_twins_in_nothing_but_the_cameras():
    still, shaken = (
        sample_scene(recipe(motion=motion), np.random.default_rng(3), "train", 0) for motion in ("still", "handheld")
    )
    assert dataclasses.replace(shaken, cameras=still.cameras) == still


@pytest.mark.parametrize("motion", ["orbit", "linear", "handheld"])
def test_a_path_that_is_not_the_recipes_is_found(motion: str):
    wanted = recipe(motion=motion)
    poses = paths(wanted)
    record = {"camera/world_from_camera": poses[0], "camera/world_from_camera_of_frame": poses}
    assert list(check_cameras(record, wanted, ())) == []
    other = recipe(motion=motion, orbit=31.0, travel=(0.0, 0.21, 0.0), shake=0.001)
    assert list(check_cameras(record, other, ()))
    assert list(check_cameras(record, recipe(), ()))
