"""Facts about the solid textures."""

import numpy as np
import pytest

from datagen.render import kernels

AXIS = (0.6, 0.0, 0.8)
PERIOD = 0.04
SHARP = 1e-9


def weights(
    pattern: str, points: np.ndarray, width: float = SHARP, axis: tuple[float, float, float] = AXIS
) -> np.ndarray:
    return kernels.texture_weights(kernels.PATTERNS.index(pattern), PERIOD, axis, points, width)


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.2, 0.2, (4000, 3))


@pytest.mark.parametrize("pattern", kernels.PATTERNS)
@pytest.mark.parametrize("width", [SHARP, 0.003, 0.5])
def test_weights_are_shares(points, pattern, width):
    found = weights(pattern, points, width)
    assert found.min() >= 0
    assert found.max() <= 1


@pytest.mark.parametrize(
    ("pattern", "share"), [("two-tone", 0.5), ("checker", 0.5), ("stripes", 0.5), ("dots", 2 * 0.113)]
)
def test_sharp_patterns_have_the_shares_that_geometry_says(points, pattern, share):
    found = weights(pattern, points)
    assert set(np.unique(found)) <= {0.0, 1.0}
    assert found.mean() == pytest.approx(share, abs=0.03)


def test_two_tone_changes_at_the_plane_through_the_origin(points):
    np.testing.assert_array_equal(weights("two-tone", points), points @ AXIS > 0)


@pytest.mark.parametrize(
    ("pattern", "step"), [("checker", (PERIOD, 0, 0)), ("stripes", PERIOD * np.array(AXIS)), ("dots", (0, PERIOD, 0))]
)
def test_patterns_repeat_after_their_period(points, pattern, step):
    found, shifted = weights(pattern, points, 0.002), weights(pattern, points + step, 0.002)
    np.testing.assert_allclose(shifted, found, atol=1e-9)
    assert np.ptp(found) == 1


@pytest.mark.parametrize("pattern", ["checker", "stripes", "dots"])
def test_a_width_averages_the_sharp_pattern(pattern):
    line = np.zeros((2001, 3))
    line[:, 0] = np.linspace(0, PERIOD, 2001)
    axis = (1.0, 0.0, 0.0)
    sharp, soft = weights(pattern, line, axis=axis), weights(pattern, line, 0.002, axis)
    assert soft.mean() == pytest.approx(sharp.mean(), abs=0.02)
    assert np.abs(np.diff(soft)).max() < 0.02
    assert np.abs(np.diff(sharp)).max() > 0.49


@pytest.mark.parametrize("pattern", ["noise", "wood"])
def test_natural_patterns_are_continuous_and_fade_where_pixels_are_too_coarse(points, pattern):
    near = weights(pattern, points + 1e-7)
    # The sawtooth of wood is steep, not broken.
    assert np.abs(near - weights(pattern, points)).max() < 1e-3
    assert np.ptp(weights(pattern, points)) > 0.8
    assert np.abs(weights(pattern, points, 10 * PERIOD) - 0.5).max() < 0.06


def test_wood_looks_the_same_along_its_grain_but_not_across(points):
    along = weights("wood", points + 0.2 * PERIOD * np.array(AXIS)) - weights("wood", points)
    across = weights("wood", points + 0.2 * PERIOD * np.array([0.8, 0.0, -0.6])) - weights("wood", points)
    assert np.abs(along).mean() < 0.3 * np.abs(across).mean()


@pytest.mark.parametrize("blur", [0.01, 0.1, 1.0])
def test_the_mean_of_the_room_is_one(blur):
    height, angle = np.meshgrid((np.arange(100) + 0.5) / 100, np.pi * np.arange(200) / 100, indexing="ij")
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1).reshape(-1, 3)
    values = kernels.sky(np.array([0.6, 0.8]), directions, blur)
    assert np.average(values, weights=directions[:, 2]) == pytest.approx(1.0, abs=0.03)


def test_the_noise_of_rich_images_changes_in_no_preferred_direction():
    places = np.concatenate([np.random.default_rng(0).uniform(-2, 2, (20000, 2)), np.zeros((20000, 1))], axis=1)
    squareness = []
    for pattern in ("noise", "clouds"):
        x, y = (weights(pattern, places + step) - weights(pattern, places) for step in 1e-5 * np.eye(3)[:2])
        squareness.append(abs(np.sum(np.hypot(x, y) * np.cos(4 * np.arctan2(y, x))) / np.sum(np.hypot(x, y))))
        assert np.mean(weights(pattern, places)) == pytest.approx(0.5, abs=0.02)
    assert squareness[1] < 0.02 < 0.08 < squareness[0]
