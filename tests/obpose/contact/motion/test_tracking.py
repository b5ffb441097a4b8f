import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from obpose.contact.motion.tracking import Cloud, Followed, follow, move, register, track

CUBE = 0.01 * np.stack(np.meshgrid(*[np.arange(3.0)] * 3), axis=-1).reshape(-1, 3)
ROW = np.concatenate([CUBE, CUBE + np.array([0.06, 0, 0])])
"""Two cubes of 2 cm, 6 cm apart."""
OBJECTS = np.repeat([0, 1], len(CUBE))
STEP = np.array([0.03, 0.01, 0.0])


def black(points: np.ndarray) -> Cloud:
    return Cloud(points, 0 * points)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Points turned about a vertical axis through their mean, by an angle in radians."""
    middle = points.mean(axis=0)
    return (points - middle) @ Rotation.from_rotvec([0, 0, angle]).as_matrix().T + middle


def test_objects_that_speed_up_are_not_taken_for_those_before_them():
    # In the last step the cube behind comes nearer to where the other one was than to its own place.
    clouds = [Cloud(ROW + np.array([place, 0, 0]), 0 * ROW) for place in (0.0, 0.02, 0.06, 0.12, 0.2)]
    assert all(np.array_equal(labels, OBJECTS) for labels in track(clouds, 0, OBJECTS, 0.02))


def test_an_object_that_turns_is_followed_to_its_place():
    target = turned(ROW, 0.2)
    _, _, predicted = register(black(target), {0: Followed(black(ROW), np.zeros(3))})
    np.testing.assert_allclose(predicted[0], target, atol=1e-9)


def test_objects_that_shift_far_are_not_turned_by_points_of_the_other():
    """Two bars move diagonally by most of their distance, so that the first assignment is wrong for one of them."""
    bars = np.random.default_rng(0).uniform(0, [0.08, 0.02, 0.02], (2, 50, 3))
    bars[1] += [0.04, 0.04, 0]
    objects = {name: Followed(black(points), np.zeros(3)) for name, points in enumerate(bars)}
    labels, _, _ = register(black(np.concatenate(bars) + np.array([0.03, 0.03, 0])), objects)
    assert np.array_equal(labels, np.repeat([0, 1], 50))


def test_a_partly_hidden_object_stays_in_place():
    """Hidden points have no counterparts; the nearest visible ones would pull the object towards them."""
    bar = np.concatenate([1.5 * CUBE, 1.5 * CUBE + np.array([0.045, 0, 0])])
    seen = black(bar[bar[:, 0] < 0.05])
    _, _, predicted = register(seen, {0: Followed(black(bar), np.zeros(3))})
    np.testing.assert_allclose(predicted[0], bar, atol=1e-9)


@pytest.mark.parametrize(("degrees", "followed"), [(34, True), (35, False), (60, False), (150, False)])
def test_points_are_only_shifted_where_a_turn_would_be_too_large(degrees: float, followed: bool):
    target = turned(CUBE, np.radians(degrees)) + STEP
    expected = target if followed else CUBE + STEP
    np.testing.assert_allclose(move(CUBE, (CUBE, target), turning=True), expected, atol=1e-9)


def test_a_single_point_takes_the_label_of_those_around_it():
    speck = OBJECTS.copy()
    speck[len(CUBE) // 2] = 1  # the middle of the first cube
    assert np.array_equal(track([black(ROW), black(ROW)], 0, speck, 0.02)[1], OBJECTS)


@pytest.mark.parametrize("visible", [0, len(CUBE)], ids=["none", "another"])
def test_a_hidden_object_moves_on_by_one_step_and_rests(visible: int):
    objects = {0: Followed(black(CUBE), np.zeros(3)), 1: Followed(black(CUBE + 0.2), STEP)}
    labels, after, unused = follow(black(CUBE[:visible]), objects, 0.02, 2)
    assert np.array_equal(labels, np.zeros(visible))
    assert unused == 2
    np.testing.assert_allclose(after[1].cloud.points, CUBE + 0.2 + STEP)
    np.testing.assert_allclose(after[1].velocity, 0)
