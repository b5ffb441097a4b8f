import dataclasses
from typing import Any

import numpy as np
import pytest

from datagen.config import Lighting, Recipe, Rig, load_recipe
from datagen.errors import UsageError
from datagen.sampling import sample_scene
from datagen.sampling.cameras import exposed, sample_cameras, sample_lights
from datagen.verify.cameras import check_cameras


def test_the_video_camera_is_the_same_in_every_scene():
    recipe = load_recipe("moving")
    first, second = (sample_cameras(recipe, np.random.default_rng(seed)) for seed in (0, 1))
    assert first == second
    (camera,) = first
    offset = np.subtract(camera.position, camera.target)
    assert np.sqrt(np.sum(offset**2)) == pytest.approx(1.03, abs=1e-5)
    assert np.degrees(np.arcsin(offset[2] / 1.03)) == pytest.approx(55, abs=1e-3)
    assert np.degrees(camera.field_of_view) == pytest.approx(40)
    assert camera.target[2] == 0


def test_views_are_turned_about_the_worlds_z_axis():
    cameras = sample_cameras(load_recipe("static"), np.random.default_rng(0))
    angles = np.degrees([np.arctan2(c.position[1], c.position[0]) for c in cameras]) % 360
    np.testing.assert_allclose(angles, [0, 120, 240], atol=1e-3)
    assert len({c.position[2] for c in cameras}) == 1
    for camera in cameras:
        assert camera.target[:2] == (0, 0)


def test_jitter_moves_cameras_and_not_what_they_look_at():
    recipe = load_recipe("clevr3d")
    first, second = (sample_cameras(recipe, np.random.default_rng(seed)) for seed in (0, 1))
    assert {c.target for c in first + second} == {(0.0, 0.0, 0.0)}
    shift = [np.subtract(a.position, b.position) for a, b in zip(first, second, strict=True)]
    assert np.all(np.abs(shift) < 8 * recipe.rig.jitter)
    assert np.min(np.abs(shift)) > 0


def test_an_azimuth_turns_the_first_camera():
    recipe = dataclasses.replace(load_recipe("moving"), rig=Rig(azimuth=90.0))
    (camera,) = sample_cameras(recipe, np.random.default_rng(0))
    np.testing.assert_allclose(camera.position[:2], [0, 1.03 * np.cos(np.radians(55))], atol=1e-6)


def test_ranges_are_drawn_anew_for_each_scene_and_shared_by_its_views():
    rig = Rig(distances=(0.5, 0.9), elevations=(30.0, 60.0), azimuths=(0.0, 360.0), fields_of_view=(40.0, 70.0))
    recipe = dataclasses.replace(load_recipe("static"), rig=rig)
    scenes = [sample_cameras(recipe, np.random.default_rng(seed)) for seed in range(50)]
    assert all(len({camera.field_of_view for camera in cameras}) == 1 for cameras in scenes)
    distances = [np.linalg.norm(cameras[0].position) for cameras in scenes]
    heights = [
        np.degrees(np.arcsin(cameras[0].position[2] / np.linalg.norm(cameras[0].position))) for cameras in scenes
    ]
    assert 0.5 <= min(distances) < 0.55
    assert 0.85 < max(distances) <= 0.9
    assert 30 <= min(heights) < 35
    assert 55 < max(heights) <= 60.001


def test_a_path_that_ends_straight_above_its_target_is_refused():
    rig = Rig(motion="linear", distance=1.0, elevation=60.0, travel=(-0.5, 0.0, 0.0))
    recipe = dataclasses.replace(load_recipe("moving"), rig=rig)
    with pytest.raises(UsageError, match="Change --rig"):
        sample_cameras(recipe, np.random.default_rng(0))


def test_lights_come_from_above_and_only_the_key_casts_a_shadow():
    rng = np.random.default_rng(0)
    lighting = Lighting()
    for _ in range(50):
        key, fill = sample_lights(lighting, rng)
        assert np.sum(np.square(key.direction)) == pytest.approx(1, abs=1e-5)
        assert lighting.elevation[0] <= np.degrees(np.arcsin(key.direction[2])) <= lighting.elevation[1] + 1e-3
        assert fill.direction[2] > 0
        assert (key.casts_shadow, fill.casts_shadow) == (True, False)
        assert max(fill.radiance) < min(key.radiance)


def test_exposure_and_white_balance_change_all_light_alike():
    recipe, rng = load_recipe("moving"), np.random.default_rng(0)
    scene = sample_scene(recipe, rng, "train", 0)
    assert exposed(scene, recipe.lighting, rng) == scene
    bright = exposed(scene, Lighting(exposure=(2.0, 2.0)), rng)
    assert bright.ambient == pytest.approx(2 * np.array(scene.ambient), abs=1e-5)
    tinted = exposed(scene, Lighting(tint=0.1), rng)
    gains = [np.divide(light.radiance, old.radiance) for light, old in zip(tinted.lights, scene.lights, strict=True)]
    assert gains[0] == pytest.approx(gains[1], abs=1e-3)
    assert np.ptp(gains[0]) > 0.01


def test_shadows_can_be_switched_off():
    key, _ = sample_lights(Lighting(shadows=False), np.random.default_rng(0))
    assert not key.casts_shadow


@pytest.mark.parametrize(("name", "aspect"), [("moving", 1.0), ("static", 1.0), ("clevr3d", 4 / 3)])
def test_cameras_are_aimed_at_the_frame_in_which_the_recipe_judges_visibility(name: str, aspect: float):
    recipe = dataclasses.replace(load_recipe(name), resolution=(640, 100))
    assert {camera.aspect for camera in sample_cameras(recipe, np.random.default_rng(0))} == {aspect}


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


@pytest.mark.parametrize("orbit", [360.0, -540.0, 3600.0])
def test_an_orbit_of_large_steps_is_the_recipes(orbit: float):
    wanted = dataclasses.replace(recipe(motion="orbit", orbit=orbit), frames=3)
    poses = paths(wanted)
    record = {"camera/world_from_camera": poses[0], "camera/world_from_camera_of_frame": poses}
    assert list(check_cameras(record, wanted, ())) == []
    other = dataclasses.replace(
        wanted, rig=dataclasses.replace(wanted.rig, orbit=orbit - 1 if orbit > 0 else orbit + 1)
    )
    assert list(check_cameras(record, other, ()))


@pytest.mark.parametrize("way", ["up", "out"])
def test_one_frame_beside_an_orbit_is_found(way: str):
    wanted = recipe(motion="orbit")
    poses = paths(wanted)
    away = (poses[3, 0, :3, 3] - wanted.rig.target) * [1, 1, 0]
    poses[3, 0, :3, 3] += [0, 0, 0.001] if way == "up" else 0.001 * away / np.linalg.norm(away)
    record = {"camera/world_from_camera": poses[0], "camera/world_from_camera_of_frame": poses}
    found = [(finding.view, finding.message) for finding in check_cameras(record, wanted, ())]
    assert found == [(0, "the orbit is up to 1.000 mm off")]
