import dataclasses

import numpy as np
import pytest

from datagen import geometry
from datagen.config import Sensor
from datagen.sensor import depth_edges, hole_probability, incidence, sense

PERFECT = Sensor(axial_noise=0.0, edge_dropout=0.0, grazing_angle=90.0, dark_reflectance=0.0, quantisation=0.0)
SIZE = 200
K = geometry.intrinsics(np.radians(40), SIZE, SIZE)
GREY = np.full((SIZE, SIZE, 3), 128, np.uint8)


def flat(z: float) -> np.ndarray:
    return np.full((SIZE, SIZE), z, np.float32)


def slanted(angle: float) -> np.ndarray:
    """A plane through (0, 0, 1) whose normal makes `angle` (degrees) with the optical axis."""
    rays = geometry.pixel_rays(K, SIZE, SIZE)
    return (1 / (1 + rays[..., 0] * np.tan(np.radians(angle)))).astype(np.float32)


def stepped() -> np.ndarray:
    depth = flat(1.0)
    depth[:, SIZE // 2 :] = 1.2
    return depth


def run(depth: np.ndarray, config: Sensor, seed: int = 0, rgb: np.ndarray = GREY) -> tuple[np.ndarray, np.ndarray]:
    return sense(depth, rgb, K, config, np.random.default_rng(seed))


def test_a_perfect_sensor_returns_its_input_and_no_holes() -> None:
    depth = stepped()
    depth[:20] = 0
    sensed, valid = run(depth, PERFECT, rgb=np.zeros_like(GREY))
    np.testing.assert_array_equal(sensed, depth)
    np.testing.assert_array_equal(valid, depth > 0)


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (1, 1)])
def test_a_single_row_or_column_has_no_slope(shape: tuple[int, int]) -> None:
    assert not incidence(np.full(shape, 0.7), geometry.intrinsics(np.radians(60), shape[1], shape[0])).any()


def test_noise_is_unbiased_and_its_deviation_grows_with_the_square_of_depth() -> None:
    config = dataclasses.replace(PERFECT, axial_noise=0.002)
    for z in (0.5, 1.0, 2.0):
        error = run(flat(z), config)[0].astype(np.float64) - z
        assert np.std(error) == pytest.approx(0.002 * z**2, rel=0.02)
        assert abs(np.mean(error)) < 4 * np.std(error) / SIZE


@pytest.mark.parametrize("z", [0.5, 1.0, 2.0])
def test_quantisation_steps_grow_with_the_square_of_depth(z: float) -> None:
    ramp = np.linspace(z, z * 1.05, SIZE * SIZE, dtype=np.float32).reshape(SIZE, SIZE)
    sensed, _ = run(ramp, dataclasses.replace(PERFECT, quantisation=0.001))
    levels = np.unique(sensed.astype(np.float64))
    np.testing.assert_allclose(np.diff(levels), 0.001 * levels[1:] * levels[:-1], rtol=1e-3)
    assert np.max(np.abs(sensed - ramp)) <= 0.51 * np.max(np.diff(levels))


def test_the_stated_share_of_pixels_beside_a_depth_edge_is_lost_and_no_other() -> None:
    _, valid = run(stepped(), dataclasses.replace(PERFECT, edge_dropout=0.5))
    beside = np.zeros((SIZE, SIZE), bool)
    beside[:, SIZE // 2 - 1 : SIZE // 2 + 1] = True
    assert np.all(valid[~beside])
    assert np.mean(~valid[beside]) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("angle", [0.0, 30.0, 60.0])
def test_planes_have_no_depth_edges_and_show_their_own_incidence(angle: float) -> None:
    depth = slanted(angle)
    assert not np.any(depth_edges(depth.astype(np.float64), K))
    rays = geometry.pixel_rays(K, SIZE, SIZE)
    normal = np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
    expected = np.degrees(np.arccos(rays @ normal / np.sqrt(np.sum(rays**2, axis=-1))))
    np.testing.assert_allclose(incidence(depth.astype(np.float64), K), expected, atol=0.2)


def test_grazing_surfaces_lose_returns_linearly_beyond_the_angle() -> None:
    config = dataclasses.replace(PERFECT, grazing_angle=60.0)
    depth = slanted(68.0).astype(np.float64)
    angle = incidence(depth, K)
    assert np.min(angle) < 60 < np.max(angle)
    np.testing.assert_allclose(hole_probability(depth, GREY, K, config), np.clip((angle - 60) / 30, 0, 1), atol=1e-9)
    _, valid = run(depth.astype(np.float32), config)
    assert np.mean(~valid) == pytest.approx(np.mean(np.clip((angle - 60) / 30, 0, 1)), abs=0.01)


def test_dark_surfaces_lose_returns() -> None:
    config = dataclasses.replace(PERFECT, dark_reflectance=0.05)
    rgb = GREY.copy()
    rgb[:, : SIZE // 2] = 0
    _, valid = run(flat(1.0), config, rgb=rgb)
    assert not np.any(valid[:, : SIZE // 2])
    assert np.all(valid[:, SIZE // 2 :])


def test_equal_seeds_give_equal_images_and_noise_does_not_depend_on_other_pixels() -> None:
    sensed, valid = run(stepped(), Sensor(), seed=3)
    again, _ = run(stepped(), Sensor(), seed=3)
    np.testing.assert_array_equal(sensed, again)
    other, _ = run(stepped(), Sensor(), seed=4)
    assert np.mean(other != sensed) > 0.5
    far = stepped()
    far[:, SIZE // 2 :] = 2.0
    left = slice(0, SIZE // 2 - 1)
    np.testing.assert_array_equal(run(far, Sensor(), seed=3)[0][:, left], sensed[:, left])
    assert np.all((sensed > 0) == valid)


def test_what_would_not_fit_the_format_does_not_return() -> None:
    sensed, valid = run(flat(6.553), dataclasses.replace(PERFECT, axial_noise=0.002))
    assert np.max(sensed) <= 6.5535
    assert 0.1 < np.mean(valid) < 0.9
