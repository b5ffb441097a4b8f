import numpy as np
import pytest

from obpose.rgbd.boxes import upright_box


def cuboid(size: tuple[float, float, float], angle: float, at: tuple[float, float, float]) -> np.ndarray:
    """Points of a cuboid that is turned about z."""
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20_000, 3)) * size
    cosine, sine = np.cos(angle), np.sin(angle)
    return points @ np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]).T + np.array(at)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, 2.5])
@pytest.mark.parametrize("size", [(0.2, 0.1, 0.3), (0.1, 0.2, 0.05)])
def test_the_box_of_a_cuboid_is_the_cuboid(size: tuple[float, float, float], angle: float):
    box = upright_box(cuboid(size, angle, (0.3, -0.2, 0.4)))
    np.testing.assert_allclose(box.size, [0.2, 0.1, size[2]], rtol=0.05)
    np.testing.assert_allclose(box.center, [0.3, -0.2, 0.4], atol=0.003)
    longer = angle if size[0] > size[1] else angle + np.pi / 2
    assert abs(box.rotation[:, 0] @ [np.cos(longer), np.sin(longer), 0]) == pytest.approx(1, abs=1e-3)
    np.testing.assert_allclose(box.rotation @ box.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(box.rotation) == pytest.approx(1)


def test_stray_points_do_not_count():
    points = cuboid((0.2, 0.1, 0.1), 0.3, (0.0, 0.0, 0.2))
    stray = np.concatenate([points, [[1.0, 0, 0.2], [0, 0, 2.0], [0, -1, 0.2]]])
    np.testing.assert_allclose(upright_box(stray).size, [0.2, 0.1, 0.1], rtol=0.05)


@pytest.mark.parametrize("size", [(0.2, 0.1, 0.3), (0.1, 0.2, 0.3)])
def test_the_box_is_where_the_points_are_though_most_of_them_are_at_one_corner(size: tuple[float, float, float]):
    points = cuboid(size, 0.0, (0.0, 0.0, 0.4))
    corner = points[(points[:, 0] > 0.02) & (points[:, 1] > 0.03)]
    cosine, sine = np.cos(0.4), np.sin(0.4)
    turned = np.concatenate([points, *[corner] * 9]) @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    np.testing.assert_allclose(upright_box(turned).center, [0, 0, 0.4], atol=0.006)


def test_boxes_near_the_table_stand_on_it():
    box = upright_box(cuboid((0.2, 0.1, 0.1), 0.0, (0.0, 0.0, 0.065)))
    assert box.center[2] - box.size[2] / 2 == pytest.approx(0)
    assert box.center[2] + box.size[2] / 2 == pytest.approx(0.115, abs=0.003)


@pytest.mark.parametrize("points", [np.full((5, 3), 0.1), np.linspace((0, 0, 0), (0.1, 0.1, 0.1), 9)])
def test_points_without_an_area_have_a_flat_box(points: np.ndarray):
    assert np.isfinite(upright_box(points).size).all()
