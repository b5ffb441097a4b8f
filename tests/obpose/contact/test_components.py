from collections.abc import Sequence

import numpy as np
import pytest

from obpose.contact.components import (
    BELOW,
    FLOATING,
    NEIGHBOURS,
    image_components,
    join_floating,
    numbered,
    offsets,
    shifted,
)

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


def joined(*components: Sequence[tuple[float, float]], table: float = 0.5) -> list[int]:
    """Component that each one becomes, of components with points at these distances to the right and above a table."""
    names = np.concatenate([[0], *(np.full(len(places), name) for name, places in enumerate(components, 1))])
    right, up = np.array([(0, 0), *(place for places in components for place in places)]).T
    found = join_floating(names[None], np.stack([right, 0 * right, table + up], axis=-1)[None], table=table)[0]
    assert found[0] == 0
    pairs = {(int(name), int(other)) for name, other in zip(names[1:], found[1:], strict=True)}
    assert len(pairs) == len(components)
    return [other for _, other in sorted(pairs)]


def test_components_that_float_belong_to_all_that_is_below_them():
    """The shade of a lamp, a foot and a piece of the stem; a cup beside it, an arm over it and a ball in the air."""
    shade, foot, stem = [(0, 0.1), (0, 0.15)], [(0.9 * BELOW, 0.001)], [(-0.9 * BELOW, FLOATING + 0.02)]
    cup, arm, ball = [(1.1 * BELOW, 0.001)], [(0, 0.3), (2, 0.001)], [(1, 0.2)]
    assert joined(shade, cup, foot, arm, stem, ball) == [1, 2, 1, 3, 1, 4]


@pytest.mark.parametrize(("lowest", "floats"), [(FLOATING - 1e-3, False), (FLOATING + 1e-3, True)])
def test_components_float_if_their_lowest_point_does(lowest: float, floats: bool):
    assert joined([(0, lowest), (0, 0.2), (0, 0.3)], [(0, 0.001)]) == ([1, 1] if floats else [1, 2])


def test_direct_neighbours_are_partners_in_larger_images_too():
    assert set(NEIGHBOURS) <= set(offsets(2))


@pytest.mark.parametrize("offset", [(0, 1), (2, 3), (2, -3), (0, -1), (9, 0)])
def test_partners_are_at_the_offset(offset: tuple[int, int]):
    rows, columns = np.mgrid[:5, :6]
    here, there = shifted((5, 6), offset)
    assert np.all(rows[there] - rows[here] == offset[0])
    assert np.all(columns[there] - columns[here] == offset[1])
    assert rows[here].size == max(0, 5 - abs(offset[0])) * max(0, 6 - abs(offset[1]))
