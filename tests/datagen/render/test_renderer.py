"""Facts about colours and directions of light."""

import numpy as np
import pytest

from datagen.geometry import linear
from datagen.render.renderer import light_axes


def test_linear_light_has_the_fixed_points_and_the_middle_grey_of_srgb():
    np.testing.assert_allclose(linear((0.0, 1.0, 0.5)), [0.0, 1.0, 0.21404], atol=1e-5)


def test_linear_light_is_continuous_where_its_two_branches_meet():
    low, high, _ = linear((0.040449, 0.040451, 0.0))
    assert high - low == pytest.approx(0.000002 / 12.92, rel=0.3)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 2.0), (1.0, 0.0, 0.0), (0.95, 0.1, 0.3), (-0.3, 0.4, 0.5)])
def test_axes_are_a_rotation_whose_last_row_is_the_direction(direction):
    axes = light_axes(direction)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(axes[2] * np.sqrt(np.sum(np.square(direction))), direction, atol=1e-12)
