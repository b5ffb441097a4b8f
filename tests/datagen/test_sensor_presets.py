"""Presets against the published error curves of their devices."""

import dataclasses

import numpy as np
import pytest

from datagen import geometry
from datagen.config import load_recipe
from datagen.errors import UsageError
from datagen.sensor import sense
from datagen.sensor_presets import SENSORS, with_sensor

SIZE = 160
K = geometry.intrinsics(np.radians(60), SIZE, SIZE)
GREY = np.full((SIZE, SIZE, 3), 128, np.uint8)


def wall(device: str, z: float) -> np.ndarray:
    """Depths that a sensor returns of a wall in front of it."""
    flat = np.full((SIZE, SIZE), z, np.float32)
    depth, valid = sense(flat, GREY, K, SENSORS[device], np.random.default_rng(0))
    return depth[valid].astype(np.float64)


@pytest.mark.parametrize("z", [0.8, 1.5, 2.5, 3.5])
@pytest.mark.parametrize(
    ("device", "curve"),
    [
        # Khoshelham and Elberink 2012: 0.5 x 2.85e-5 z^2, in centimetres.
        ("kinect-v1", lambda z: 0.01 * 0.5 * 2.85e-5 * (100 * z) ** 2),
        # Microsoft, confirmed by Toelgyessy et al. 2021: 17 mm at 3.5 m; the light that returns falls with z^2.
        ("azure-kinect", lambda z: 0.017 * (z / 3.5) ** 2),
        # Intel: z^2 x subpixel / (focal length x baseline), in millimetres.
        ("realsense-d435", lambda z: 0.001 * (1000 * z) ** 2 * 0.08 / (424 * 50)),
    ],
)
def test_noise_follows_the_devices_curve(device: str, curve, z: float):
    assert np.std(wall(device, z)) == pytest.approx(curve(z), rel=0.06)


def test_kinect_depth_comes_in_the_devices_steps():
    steps = np.diff(np.unique(wall("kinect-v1", 3.0)))
    assert np.median(steps) == pytest.approx(0.00285 * 3.0**2, rel=0.02)


def test_azure_depth_comes_in_millimetres():
    depths = 1000 * wall("azure-kinect", 1.0)
    np.testing.assert_allclose(depths, np.rint(depths), atol=1e-3)


@pytest.mark.parametrize(("device", "near", "far"), [("kinect-v1", 0.4, 5.2), ("azure-kinect", 0.4, 4.0)])
def test_nothing_returns_from_outside_of_the_range(device: str, near: float, far: float):
    assert len(wall(device, near)) == len(wall(device, far)) == 0
    assert len(wall(device, 1.0)) > 0.9 * SIZE**2


def test_a_preset_changes_nothing_but_the_sensor():
    moving = load_recipe("moving")
    noisy = with_sensor(moving, "kinect-v1")
    assert noisy.sensor.enabled
    assert dataclasses.replace(noisy, sensor=moving.sensor) == moving
    with pytest.raises(UsageError, match="did you mean 'kinect-v1'"):
        with_sensor(moving, "kinect")
