import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from obpose.contact.motion.rigidity import common_motion, register
from obpose.contact.motion.tracking import Cloud


def box(seed: int, middle: float, count: int = 60) -> np.ndarray:
    """Points in a box of 6 x 4 x 3 cm, metres."""
    return np.random.default_rng(seed).uniform(-1, 1, (count, 3)) * [0.03, 0.02, 0.015] + [middle, 0, 0]


def shift(time: float, aside: float = 0.0) -> np.ndarray:
    return np.array([0.004 * time, aside, 0])


def cloud(*parts: np.ndarray) -> Cloud:
    points = np.concatenate(parts)
    return Cloud(points, np.zeros_like(points))


@pytest.mark.parametrize("degrees", [0, 5, 15])
def test_registration_finds_rigid_motions(degrees: float):
    points = box(0, 0.0)
    rotation = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    motion = register(cloud(points), cloud(points @ rotation.T + [0.05, 0.01, 0]), None, rounds=20)
    np.testing.assert_allclose(motion.moved(cloud(points)).points, points @ rotation.T + [0.05, 0.01, 0], atol=1e-6)


@pytest.mark.parametrize("hidden", [0, 1], ids=["before", "after"])
def test_registration_leaves_out_hidden_points(hidden: int):
    """A fifth of the points, at one end of the object, is seen in one of two frames only."""
    points = np.concatenate([box(0, 0.0), box(1, 0.09, 15)])
    frames = [points, points @ Rotation.from_euler("z", 5, degrees=True).as_matrix().T + [0.01, 0, 0]]
    before, after = (cloud(seen[:60] if frame == hidden else seen) for frame, seen in enumerate(frames))
    found = register(before, after, None, rounds=20).moved(cloud(points)).points
    np.testing.assert_allclose(found, frames[1], atol=1e-6)


@pytest.mark.parametrize("slip", [0.0, 0.01, 0.02])
def test_joint_residuals_grow_with_relative_motion(slip: float):
    one, other = box(0, 0.0), box(1, 0.06)
    frames = [cloud(one + shift(t), other + shift(t, slip * t)) for t in range(5)]
    labels = [np.repeat([0, 1], 60)] * 5
    found = common_motion(frames, labels).excess
    assert np.array_equal(found, found.T)
    assert found[0, 1] < 1e-6 if slip == 0 else found[0, 1] > 0.003


def test_views_of_the_same_time_are_no_motion():
    one, other = box(0, 0.0), box(1, 0.06)
    images = [cloud(one, other), cloud(one, other + shift(0, 0.02))] * 3  # the second view shows another side
    labels = [np.repeat([0, 1], 60)] * 6
    assert common_motion(images, labels, views=2).excess[0, 1] < 1e-6
    assert common_motion(images, labels).excess[0, 1] > 0.003


def test_one_slip_counts_in_a_long_clip_as_in_a_short_one():
    one, other = box(0, 0.0), box(1, 0.06)
    frames = [cloud(one + shift(t), other + shift(t, 0.02 if t > 5 else 0.0)) for t in range(12)]
    labels = [np.repeat([0, 1], 60)] * 12
    short, long = (common_motion(part, labels[: len(part)]).excess[0, 1] for part in (frames[5:7], frames))
    assert long > 0.9 * short > 0.003


@pytest.mark.parametrize("order", [1, -1])
def test_one_part_with_a_clear_motion_suffices(order: int):
    """A ring of 15 points turns by 24 degrees, which alone looks like rest; the box beside it shows the rotation."""
    angles = 2 * np.pi * np.arange(15) / 15
    parts = [0.02 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1), box(1, 0.06)][::order]
    turn = Rotation.from_euler("z", 24, degrees=True).as_matrix()
    frames = [cloud(*parts), cloud(*(part @ turn.T for part in parts))]
    labels = [np.repeat([0, 1], [len(part) for part in parts])] * 2
    assert common_motion(frames, labels).excess[0, 1] < 1e-6


def test_points_far_from_all_others_have_the_same_residual_in_any_motion():
    """Specks count in the mean, as 4 of 64 points of a part, but add nothing to the excess."""
    one, other = box(0, 0.0), box(1, 0.06)
    turn = Rotation.from_euler("z", 10, degrees=True).as_matrix()
    after, labels = cloud(one @ turn.T + [0, 0.02, 0], other), np.repeat([0, 1], 60)
    plain = common_motion([cloud(one, other), after], [labels] * 2).excess
    specks = np.tile([0, 0.2, 0], (4, 1))
    spoiled = common_motion([cloud(specks, one, other), after], [np.append([0] * 4, labels), labels]).excess
    np.testing.assert_allclose(spoiled, plain * 60 / 64, atol=1e-5)


def test_parts_that_are_far_apart_or_seen_once_are_not_compared():
    one, other = box(0, 0.0), box(1, 0.3)
    far = [cloud(one, other + shift(0, 0.01 * t)) for t in range(4)]
    assert not common_motion(far, [np.repeat([0, 1], 60)] * 4).excess.any()
    once = [cloud(one), cloud(one, box(1, 0.06)), cloud(one)]
    labels = [np.zeros(60, int), np.repeat([0, 1], 60), np.zeros(60, int)]
    assert not common_motion(once, labels).excess.any()


@pytest.mark.parametrize("order", [1, -1], ids=["part", "meet"])
def test_parts_that_are_near_each_other_in_one_frame_are_compared(order: int):
    one, other = box(0, 0.0), box(1, 0.06)
    frames = [cloud(one, other), cloud(one, other + shift(0, 0.2))][::order]
    assert common_motion(frames, [np.repeat([0, 1], 60)] * 2).excess[0, 1] > 0.003


@pytest.mark.parametrize(
    ("axis", "degrees", "slip", "tumbling"),
    [("y", 15, 0.0, True), ("y", 4, 0.0, False), ("z", 15, 0.0, False), ("y", 15, 0.01, False)],
)
def test_parts_that_turn_over_together_tumble(axis: str, degrees: float, slip: float, tumbling: bool):
    one, other = box(0, 0.0, 200), box(1, 0.06, 200)
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    slipped = other + np.array([0, slip, 0])
    frames = [cloud(one, other), cloud(one @ turn.T + shift(5), slipped @ turn.T + shift(5))]
    found = common_motion(frames, [np.repeat([0, 1], 200)] * 2).tumbling
    assert np.array_equal(found, tumbling * (1 - np.eye(2, dtype=int)).astype(bool))


@pytest.mark.parametrize(("radius", "tumbling"), [(0.0005, False), (0.02, True)])
def test_parts_tumble_only_if_their_points_move(radius: float, tumbling: bool):
    """Two halves of a rod that turns about its axis; its points move only if it is thick."""
    angles = np.pi / 2 * np.arange(20)
    rod = np.stack([radius * np.cos(angles), 0.004 * np.arange(20), radius * np.sin(angles)], axis=-1)
    turn = Rotation.from_euler("y", 15, degrees=True).as_matrix()
    found = common_motion([cloud(rod), cloud(rod @ turn.T)], [np.repeat([0, 1], 10)] * 2)
    assert found.excess[0, 1] < 1e-6
    assert found.tumbling[0, 1] == tumbling
