from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from datagen.geometry import intrinsics, look_at, unproject
from obpose.geometry import unproject as surface_points
from obpose.rgbd.frames import PreparedFrames, Trained, observe
from obpose.rgbd.recording import Recording
from obpose.rgbd.segment import _largest, segment_frames
from obpose.rgbd.workspace import find_workspace
from obpose.rgbd.world import World
from obpose.types import Observation
from tests.worlds.sphere_clips import clip_and_truth
from tests.worlds.traced import trace

EVERY = 4


@pytest.fixture(scope="module")
def world() -> tuple[PreparedFrames, np.ndarray]:
    """Two frames of spheres on a table, and the labels of their pixels."""
    clip, truth = clip_and_truth(frames=2, resolution=(160, 120))
    recording = Recording((Path("a.png"), Path("b.png")), clip.rgb[:, 0], clip.depth[:, 0], clip.k[0])
    world = World(np.repeat(clip.world_from_camera, 2, axis=0), "")
    workspace = find_workspace(clip.points()[0, 0][clip.valid[0, 0]])
    observation = observe(recording.every(EVERY), world.poses, workspace, Trained(0.01))
    return PreparedFrames(recording, observation, world, workspace, EVERY, ""), truth[:, 0]


def knows(truth: np.ndarray):
    """Give a method that labels the reduced pixels correctly."""

    def method(observation: Observation) -> np.ndarray:
        labels = truth[:, EVERY // 2 :: EVERY, EVERY // 2 :: EVERY].astype(np.int64)
        assert labels.shape == observation.depth.shape[1:2] + observation.depth.shape[3:]
        return labels * 7

    return method


def test_outlines_are_those_of_the_full_frames(world: tuple[PreparedFrames, np.ndarray]):
    frames, truth = world
    labels = segment_frames(frames, knows(truth))
    assert labels.shape == truth.shape
    for name in range(1, int(truth.max()) + 1):
        own = labels == np.bincount(labels[truth == name]).argmax()
        assert np.sum(own & (truth == name)) / np.sum(own | (truth == name)) > 0.9


def test_labels_are_numbered_by_size_and_constant_over_time(world: tuple[PreparedFrames, np.ndarray]):
    frames, truth = world
    labels = segment_frames(frames, knows(truth))
    assert set(np.unique(labels)) == set(range(int(truth.max()) + 1))
    assert (np.diff(np.bincount(labels.ravel())[1:]) <= 0).all()
    first, second = (np.bincount(truth[frame][labels[frame] == 1]).argmax() for frame in (0, 1))
    assert first == second


def test_the_table_has_no_label_whatever_the_method_says(world: tuple[PreparedFrames, np.ndarray]):
    frames, truth = world
    labels = segment_frames(frames, lambda observation: np.ones(observation.depth[0, :, 0].shape, np.int64))
    assert not labels[frames.recording.depth == 0].any()
    assert np.mean(labels[truth == 0] > 0) < 0.01
    assert np.mean(labels[truth > 0] > 0) > 0.9


def test_pixels_far_from_what_is_labelled_are_background(world: tuple[PreparedFrames, np.ndarray]):
    frames, truth = world
    labels = segment_frames(frames, knows(np.where(truth == 1, truth, 0)))
    assert labels[truth == 1].any()
    assert np.mean(labels[truth > 1] > 0) < 0.1


def test_pixels_far_from_all_reduced_points_are_background(world: tuple[PreparedFrames, np.ndarray]):
    """The method sees nothing within 15 cm of a ball, and takes all the rest for objects."""
    frames, truth = world
    valid = frames.observation.valid.clone()
    for frame, ball in enumerate(truth == 1):
        points = frames.points(frame)
        near = np.linalg.norm(points - points[ball].mean(axis=0), axis=-1) < 0.15
        valid[0, frame, 0] &= torch.from_numpy(~near[EVERY // 2 :: EVERY, EVERY // 2 :: EVERY])
    unseen = replace(frames, observation=replace(frames.observation, valid=valid))
    labels = segment_frames(unseen, lambda observation: np.ones(observation.depth[0, :, 0].shape, np.int64))
    assert not labels[truth == 1].any()
    assert np.mean(labels[truth > 1] > 0) > 0.9


def test_nothing_is_found_where_nothing_is_labelled(world: tuple[PreparedFrames, np.ndarray]):
    frames, truth = world
    assert not segment_frames(frames, knows(0 * truth)).any()


@pytest.mark.parametrize("height", [0.008, 0.012])
def test_bumps_lower_than_the_noise_are_no_objects(world: tuple[PreparedFrames, np.ndarray], height: float):
    frames, truth = world
    bump = np.zeros(truth.shape, bool)
    bump[:, 20:100, 40:120] = True
    bump &= truth == 0
    above = frames.world.poses[0, 2, 3]
    depth = frames.recording.depth * np.where(bump, 1 - height / above, 1)
    recording = replace(frames.recording, depth=depth.astype(np.float32))
    raised = replace(frames, recording=recording, workspace=replace(frames.workspace, floor=0.01))
    assert segment_frames(raised, knows(bump)).any() == (height > 0.01)


def test_specks_are_no_objects():
    labels = np.zeros((1, 100, 100), np.int64)
    labels[0, 0, :3], labels[0, 5, :5] = 1, 2
    np.testing.assert_array_equal(_largest(labels, 9), labels == 2)


@pytest.mark.parametrize("frames", [1, 30])
def test_an_object_that_is_visible_in_one_frame_counts_however_long_the_video_is(frames: int):
    labels = np.zeros((frames, 100, 100), np.int64)
    labels[:, :9] = 1
    labels[0, 20, :5], labels[:, 40, :3] = 2, 3
    found = _largest(labels, 9)
    np.testing.assert_array_equal(found, np.where(labels < 3, labels, 0))


def test_pixels_outside_of_the_workspace_have_no_depth(world: tuple[PreparedFrames, np.ndarray]):
    frames, _ = world
    small = Trained(0.01, cube=((0.0, 0.0, 0.0), 0.2))
    observation = observe(frames.recording, frames.world.poses, frames.workspace, small)
    assert (
        0
        < observation.valid.sum()
        < observe(frames.recording, frames.world.poses, frames.workspace, Trained(0.01)).valid.sum()
    )
    assert surface_points(observation)[observation.valid].abs().max() <= 0.1 + 1e-6


def test_objects_of_a_video_keep_their_labels_though_the_camera_moves():
    """Two balls, one of which rolls, seen by a camera on a circle; the method numbers them anew in each frame."""
    k, size, count = intrinsics(np.radians(60), 96, 72), (96, 72), 4
    angles = np.linspace(0, 0.8, count)
    poses = np.stack([look_at(np.array([0.7 * np.cos(a), 0.7 * np.sin(a), 0.7]), np.zeros(3)) for a in angles])
    places = [np.array([(-0.12, 0.0, 0.05), (0.1, 0.03 * frame, 0.05)]) for frame in range(count)]
    images = [trace(centers, k, pose, *size) for centers, pose in zip(places, poses, strict=True)]
    depth, truth = (np.stack([image[part] for image in images]) for part in (0, 1))
    rgb = np.array([(90, 90, 90), (200, 40, 40), (40, 40, 200)], np.uint8)[truth]
    recording = Recording(tuple(Path(f"{i}.png") for i in range(count)), rgb, depth.astype(np.float32), k)
    workspace = find_workspace(unproject(recording.depth[0], k, poses[0]).reshape(-1, 3))
    observation = observe(recording, poses, workspace, Trained(0.01))
    frames = PreparedFrames(recording, observation, World(poses, ""), workspace, 1, "")
    calls = iter(range(count))

    def method(still: Observation) -> np.ndarray:
        frame = next(calls)
        assert torch.equal(still.world_from_camera[0, 0], torch.from_numpy(poses[frame]).float())
        return np.where(truth[frame] > 0, (truth[frame] + frame) % 2 + 1, 0)[None]

    assert frames.moves
    labels = segment_frames(frames, method, video=True)
    for ball in (1, 2):
        names, counts = np.unique(labels[truth == ball], return_counts=True)
        assert counts.max() > 0.9 * counts.sum()
        assert names[counts.argmax()] > 0
    assert segment_frames(frames, lambda _: truth, most=1).max() == 1
