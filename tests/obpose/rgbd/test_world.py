"""Worlds of tables, walls, bins and shelves that were drawn from boxes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datagen.geometry import unproject
from obpose.errors import NoTable, UsageError
from obpose.rgbd.recording import Recording
from obpose.rgbd.workspace import doubts, find_workspace
from obpose.rgbd.world import GIVEN, World, choose_world
from tests.worlds.rooms import FLOOR, SIZE, TABLE, WALL, Box, K, hollow, look, things

BIN = hollow((-0.2, -0.3, -0.01), (0.2, 0.3, 0.2), 2)
SHELF = hollow((-0.2, -0.4, -0.01), (0.2, 0.4, 0.4), 0)
THINGS = things(np.random.default_rng(0), (0.18, 0.28), 6)
CENTER = (0.0, 0.0, 0.0)


def recording(boxes: list[Box], position: tuple[float, ...], **changes) -> tuple[Recording, np.ndarray]:
    """A noisy frame, and the true pose of its camera."""
    depth, pose = look(boxes, position, changes.pop("target", CENTER), noise=0.002)
    frame = Recording((Path("a.png"),), np.zeros((1, *depth.shape, 3), np.uint8), depth[None], K)
    return replace(frame, **changes), pose


def reasons(frame: Recording, world: World) -> list[str]:
    points = unproject(frame.depth[0], K, world.poses[0])[frame.depth[0] > 0]
    return [*world.warnings, *doubts(points, find_workspace(points), world.poses[0, :3, 3])]


def is_on_table(world: World, pose: np.ndarray) -> bool:
    found = world.poses[0]
    return bool(found[2, :3] @ pose[2, :3] > 0.98 and abs(found[2, 3] - pose[2, 3]) < 0.02)


@pytest.mark.parametrize("wall", [[], [WALL]])
@pytest.mark.parametrize("position", [(0.3, 0.1, 0.9), (0.8, 0.2, 0.5), (1.0, 0.0, 0.3)])
def test_a_table_is_found_with_and_without_a_wall_behind_it(wall: list[Box], position: tuple[float, ...]):
    frame, pose = recording([TABLE, FLOOR, *wall, *THINGS], position)
    world = choose_world(frame, None, CENTER)
    assert is_on_table(world, pose)
    assert reasons(frame, world) == []


def test_the_note_says_where_the_middle_of_the_table_is():
    frame, _ = recording([TABLE, FLOOR, *THINGS], (0.8, 0.2, 0.5))
    world, moved = (choose_world(frame, None, (x, 0.0, 0.0)) for x in (0.0, -0.1))
    np.testing.assert_allclose(moved.poses[0, :3, 3] - world.poses[0, :3, 3], [-0.1, 0, 0], atol=1e-9)
    assert "the median of the plane's points is the origin." in world.note
    assert "the median of the plane's points is at x = -0.100 m, y = 0.000 m, as in training." in moved.note


def test_a_table_that_only_later_frames_of_a_moving_camera_show_is_found():
    room = [TABLE, FLOOR, *THINGS]
    (first, pose), (second, other) = recording(room, (0.8, 0.2, 0.5)), recording(room, (0.3, 0.1, 0.9))
    depth = np.concatenate([first.depth, second.depth])
    depth[0][unproject(depth[0], K, pose)[..., 2] < 0.02] = 0
    tilted = np.eye(4)
    tilted[:3, :3] = Rotation.from_euler("x", 40, degrees=True).as_matrix()
    frame = replace(first, depth=depth, rgb=np.repeat(first.rgb, 2, axis=0), poses=tilted @ np.stack([pose, other]))
    world = choose_world(frame, None, CENTER)
    assert is_on_table(world, pose)
    assert world.poses[1, 2, 3] == pytest.approx(other[2, 3], abs=0.02)


def test_the_floor_before_a_wall_is_the_table_and_not_the_wall_straight_ahead():
    frame, pose = recording([FLOOR, WALL], (1.5, 0.0, -0.1), target=(-0.6, 0.0, -0.15))
    assert is_on_table(choose_world(frame, None, CENTER), pose + lift(0.75))


def lift(z: float) -> np.ndarray:
    moved = np.zeros((4, 4))
    moved[2, 3] = z
    return moved


@pytest.mark.parametrize(
    ("boxes", "position", "target", "said"),
    [
        (BIN, (0.1, 0.05, 0.8), CENTER, "below it, as in a bin"),
        (BIN, (0.4, 0.1, 0.7), CENTER, "rises beside"),
        ([*BIN, *things(np.random.default_rng(1), (0.18, 0.28), 30)], (0.05, 0.0, 1.0), CENTER, "as in a bin"),
        (SHELF, (0.9, 0.1, 0.2), (0, 0, 0.1), "."),
        ([WALL], (1.0, 0.0, 0.4), (-0.6, 0.0, 0.0), "as a wall does"),
    ],
)
def test_bins_shelves_and_walls_are_reported(boxes: list[Box], position, target, said: str):
    frame, _ = recording([*boxes, *(THINGS if boxes is BIN else [])], position, target=target)
    found = reasons(frame, choose_world(frame, None, CENTER))
    assert found
    assert said in found[0]


def test_the_floor_that_is_seen_under_a_table_makes_no_bin_of_it():
    stool: Box = ((-0.3, -0.4, -0.02), (0.3, 0.4, 0))
    ground: Box = ((-4, -4, -0.45), (4, 4, -0.4))
    frame, pose = recording([stool, ground, *THINGS], (0.8, 0.2, 0.7))
    world = choose_world(frame, None, CENTER)
    assert is_on_table(world, pose)
    assert reasons(frame, world) == []


def test_the_user_can_name_the_table():
    stool: Box = ((0.15, 0.3, 0), (0.45, 0.6, 0.3))
    frame, pose = recording([TABLE, FLOOR, stool], (1.0, 0.4, 0.8), target=(0.2, 0.4, 0.2))
    surface = unproject(frame.depth[0], K, pose)
    row, column = np.argwhere(np.abs(surface - (0.3, 0.45, 0.3)).max(axis=-1) < 0.03)[0]
    world = choose_world(frame, (int(column), int(row)), CENTER)
    assert is_on_table(world, pose - lift(0.3))
    assert "--table" in world.note
    with pytest.raises(UsageError, match=r"--table 96,0: expected column and row of a pixel of the 96x72 images"):
        choose_world(frame, (SIZE[0], 0), CENTER)


def test_a_pixel_without_a_plane_names_no_table():
    frame, _ = recording([TABLE, FLOOR], (1.0, 0.4, 0.8))
    depth = frame.depth.copy()
    depth[:, 20:50, 20:50] = 0
    depth[:, 35, 35] = 0.3  # a flying pixel
    with pytest.raises(NoTable, match="--table 35,35: there is no plane around this pixel"):
        choose_world(replace(frame, depth=depth), (35, 35), CENTER)


def test_a_given_world_is_kept_if_the_user_names_its_table():
    frame, pose = recording([TABLE, FLOOR], (0.7, 0.1, 0.7))
    column, row = SIZE[0] // 2, SIZE[1] // 2
    world = choose_world(replace(frame, poses=pose[None]), (column, row), CENTER)
    assert (world.note, world.poses.tolist()) == (GIVEN, pose[None].tolist())
    assert world.table is not None
    np.testing.assert_allclose(world.table, unproject(frame.depth[0], K, pose)[row, column, :2])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (np.eye(4), ""),
        (np.eye(4) + lift(0.01), ""),
        (np.eye(4) + lift(-0.1), "the table lies at z = -0.10 m"),
        (np.eye(4) + np.array([[0, 0, 0, 2.0]] + [[0, 0, 0, 0]] * 3), "m from the origin"),
        (np.array([[1, 0, 0, 0], [0, 0.966, -0.259, 0], [0, 0.259, 0.966, 0], [0, 0, 0, 1]]), "tilted by 15 degrees"),
        (np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]), "no level plane is in view"),
    ],
)
def test_a_given_world_is_kept_if_the_table_is_at_z_0(change: np.ndarray, said: str):
    frame, pose = recording([TABLE, FLOOR, *THINGS], (0.7, 0.1, 0.7))
    moved = pose.copy()
    moved[:3, 3] += (0.1, 0, 0)
    poses = change @ np.stack([pose, moved])
    twice = {"rgb": frame.rgb.repeat(2, axis=0), "depth": frame.depth.repeat(2, axis=0)}
    world = choose_world(replace(frame, **twice, poses=poses), None, CENTER)
    if said:
        assert said in world.note
        assert is_on_table(world, pose)
    else:
        assert world.note == GIVEN
        np.testing.assert_array_equal(world.poses, poses)
    np.testing.assert_allclose(
        np.linalg.inv(world.poses[0]) @ world.poses[1], np.linalg.inv(poses[0]) @ poses[1], atol=1e-9
    )
