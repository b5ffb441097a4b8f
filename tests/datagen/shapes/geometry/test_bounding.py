import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from datagen.catalog import CATEGORIES, sample_shape
from datagen.shapes import build
from datagen.shapes.geometry.bounding import Outline, minimum_box
from datagen.shapes.shape import MESH_TOLERANCE

BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * [0.05, 0.03, 0.08]


@pytest.mark.parametrize("seed", range(20))
def test_a_turned_box_is_its_own_smallest_box(seed):
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    box = minimum_box(Outline.of_points(BOX @ rotation.T + [0.1, 0.2, 0.3]))
    assert np.prod(box.size) == pytest.approx(0.05 * 0.03 * 0.08, rel=0.01)
    np.testing.assert_allclose(np.sort(box.size), [0.03, 0.05, 0.08], rtol=0.01)
    np.testing.assert_allclose(box.center, rotation @ BOX.mean(0) + [0.1, 0.2, 0.3], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_smallest_box_of_a_regular_tetrahedron_holds_it_in_a_cube(seed):
    tetrahedron = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 2
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    assert np.prod(minimum_box(Outline.of_points(tetrahedron @ rotation.T)).size) == pytest.approx(1, rel=0.01)


def test_an_aligned_box_is_kept_where_turning_does_not_pay():
    np.testing.assert_array_equal(minimum_box(Outline.of_points(BOX)).rotation, np.eye(3))


def test_spans_of_rounded_outlines_are_exact():
    directions = Rotation.random(50, rng=np.random.default_rng(0)).as_matrix()[:, 0]
    ring = Outline.of_circles(np.array([0.04]), np.array([0.01]), 0.01)
    across = np.hypot(directions[:, 0], directions[:, 1])
    np.testing.assert_allclose(ring.span(directions)[1], 0.04 * across + 0.01 * directions[:, 2] + 0.01)
    half_axes = np.array([0.02, 0.03, 0.05])
    reach = np.sqrt(((directions * half_axes) ** 2).sum(1))
    np.testing.assert_allclose(Outline.of_ellipsoid(half_axes).span(directions), [-reach, reach])


def test_a_placed_outline_moves_with_its_frame():
    rotation, shift = Rotation.random(rng=np.random.default_rng(1)).as_matrix(), np.array([0.1, -0.1, 0.2])
    outline = Outline.union([Outline.of_points(BOX), Outline.of_ellipsoid((0.02, 0.03, 0.05))])
    directions = Rotation.random(20, rng=np.random.default_rng(0)).as_matrix()[:, 0]
    expected = np.array(outline.span(directions))
    moved = np.array(outline.placed(rotation, shift).span(directions @ rotation.T))
    np.testing.assert_allclose(moved - directions @ rotation.T @ shift, expected, atol=1e-12)


def volume_ratios() -> np.ndarray:
    """Our box's volume over that of trimesh's box, grown by what the mesh may be smaller than the shape."""
    rng = np.random.default_rng(4)
    ratios = []
    for category in CATEGORIES:
        shape = build(sample_shape(category, rng, (0.05, 0.16)))
        _, extents = trimesh.bounds.oriented_bounds(shape.vertices)
        ratios.append(np.prod(shape.minimum_box.size) / np.prod(extents + 2 * MESH_TOLERANCE))
    return np.array(ratios)


def test_boxes_are_as_tight_as_those_of_trimesh():
    ratios = volume_ratios()
    assert np.median(ratios) <= 1
    assert ratios.max() <= 1.01
