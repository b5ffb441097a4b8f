import numpy as np
import pytest

from datagen.scene import ShapeSpec
from datagen.shapes import build
from datagen.shapes.geometry.mass import of_revolution

FINE = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 40_001)


def swept(radius: np.ndarray, z: np.ndarray):
    """Mass of what lies within `radius` of the z axis at heights `z`."""
    return of_revolution(np.vstack([[0, z[0]], np.stack([radius, z], axis=1), [0, z[-1]]]))


def ball(radius: float, center: float, z: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(radius**2 - (z - center) ** 2, 0))


def test_a_dumbbell_counts_what_bar_and_balls_share_once():
    shape = build(ShapeSpec("dumbbell", {"ball_radius": 0.03, "bar_radius": 0.02, "distance": 0.09}))
    z = 0.075 * np.sin(FINE)
    bar = np.where(np.abs(z) < 0.045, 0.02, 0.0)
    expected = swept(np.maximum(bar, np.maximum(ball(0.03, 0.045, z), ball(0.03, -0.045, z))), z)
    assert shape.volume == pytest.approx(expected.volume, rel=1e-6)
    np.testing.assert_allclose(shape.inertia, expected.inertia, rtol=1e-6, atol=1e-15)


def test_a_snowman_counts_what_its_balls_share_once():
    shape = build(ShapeSpec("snowman", {"radii": [0.03, 0.025, 0.015], "distances": [0.045, 0.03]}))
    z = np.linspace(-0.03, 0.09, 200_001)
    expected = swept(np.max([ball(0.03, 0, z), ball(0.025, 0.045, z), ball(0.015, 0.075, z)], axis=0), z)
    assert shape.volume == pytest.approx(expected.volume, rel=1e-6)
    np.testing.assert_allclose(shape.inertia, expected.inertia, rtol=1e-6, atol=1e-15)
    assert -shape.vertices[:, 2].min() == pytest.approx(0.03 + expected.center[2], abs=1e-4)


def test_bars_of_a_jack_do_not_overlap():
    shape = build(ShapeSpec("jack", {"lengths": [0.06, 0.07, 0.08], "width": 0.02}))
    assert shape.volume == pytest.approx(0.02**2 * (0.06 + 0.07 + 0.08) - 2 * 0.02**3)
