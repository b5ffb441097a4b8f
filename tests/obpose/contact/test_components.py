import numpy as np
import pytest

from obpose.contact.components import image_components, shifted

GAP = 0.02


def plane(height: int, width: int) -> np.ndarray:
    rows, columns = np.mgrid[:height, :width] * 0.01
    return np.stack([columns, rows, np.zeros((height, width))], axis=-1)


def test_components_are_numbered_by_their_first_pixels():
    standing = np.array([[0, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 0], [1, 1, 0, 0]], bool)
    labels = image_components(plane(4, 4), standing, gap=GAP, least=1)
    assert labels.tolist() == [[0, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 0], [2, 2, 0, 0]]


def test_a_step_in_depth_divides():
    points = plane(3, 6)
    points[:, 3:, 2] = 2 * GAP
    labels = image_components(points, np.ones((3, 6), bool), gap=GAP, least=1)
    assert np.array_equal(labels, np.repeat([[1, 1, 1, 2, 2, 2]], 3, axis=0))


def test_small_components_are_left_out():
    standing = np.array([[1, 0, 1, 1, 1]], bool)
    assert image_components(plane(1, 5), standing, gap=GAP, least=2).tolist() == [[0, 0, 1, 1, 1]]


def test_components_are_as_many_as_there_are():
    standing = np.zeros((1, 600), bool)
    standing[0, ::2] = True
    labels = image_components(plane(1, 600), standing, gap=GAP, least=1)
    assert np.unique(labels).tolist() == list(range(301))


@pytest.mark.parametrize("offset", [(0, 1), (2, 3), (2, -3), (0, -1), (9, 0)])
def test_partners_are_at_the_offset(offset: tuple[int, int]):
    rows, columns = np.mgrid[:5, :6]
    here, there = shifted((5, 6), offset)
    assert np.all(rows[there] - rows[here] == offset[0])
    assert np.all(columns[there] - columns[here] == offset[1])
    assert rows[here].size == max(0, 5 - abs(offset[0])) * max(0, 6 - abs(offset[1]))
