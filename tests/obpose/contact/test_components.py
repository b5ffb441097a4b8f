import numpy as np
import pytest

from obpose.contact.components import BELOW, FLOATING, image_components, join_floating, numbered, shifted

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


def test_labels_are_numbered_by_their_first_pixels():
    assert numbered(np.array([[0, 7, 3], [7, 3, 0]])).tolist() == [[0, 1, 2], [1, 2, 0]]
    assert numbered(np.array([[9, 2]])).tolist() == [[1, 2]]


def test_components_that_float_belong_to_what_is_below_them():
    """A lamp's shade and foot (1, 3), with an invisible stem; a cup (2) beside it and a ball (4) in the air."""
    table = 0.5
    labels = np.array([[0, 1, 0, 2, 0, 3, 0, 4]])
    places = [(0, 0, 0), (0, 0, FLOATING), (0, 0, 0), (2 * BELOW, 0, 0.001), (0, 0, 0), (0.9 * BELOW, 0, 0.001)]
    points = np.array([[*places, (0, 0, 0), (1, 0, 0.2)]]) + np.array([0, 0, table])
    points[0, 1, 2] += 1e-3
    assert join_floating(labels, points, table=table).tolist() == [[0, 1, 0, 2, 0, 1, 0, 3]]
    points[0, 1, 2] -= 2e-3  # no longer high enough
    assert np.array_equal(join_floating(labels, points, table=table), labels)


@pytest.mark.parametrize("offset", [(0, 1), (2, 3), (2, -3), (0, -1), (9, 0)])
def test_partners_are_at_the_offset(offset: tuple[int, int]):
    rows, columns = np.mgrid[:5, :6]
    here, there = shifted((5, 6), offset)
    assert np.all(rows[there] - rows[here] == offset[0])
    assert np.all(columns[there] - columns[here] == offset[1])
    assert rows[here].size == max(0, 5 - abs(offset[0])) * max(0, 6 - abs(offset[1]))
