"""Facts that hold for every member of every family, on a few members of each category."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from datagen.catalog import CATEGORIES, sample_shape
from datagen.scene import ShapeSpec
from datagen.shapes import build
from datagen.shapes.shape import MESH_TOLERANCE, Shape
from datagen.shapes.symmetry import symmetry_rotations

SIZE = (0.04, 0.15)
HULL_TOLERANCE = 1e-3
MEMBERS = 2


@pytest.fixture(scope="module")
def members() -> dict[str, list[Shape]]:
    """A few members of each category."""
    rng = np.random.default_rng(11)
    return {name: [build(sample_shape(name, rng, SIZE)) for _ in range(MEMBERS)] for name in CATEGORIES}


def inside(shape: Shape, count: int) -> tuple[np.ndarray, float]:
    """Random points inside a shape, and the volume that each stands for."""
    low, high = shape.vertices.min(0), shape.vertices.max(0)
    points = np.random.default_rng(0).uniform(low, high, (count, 3))
    return points[shape.signed_distance(points) < 0], float(np.prod(high - low)) / count


@pytest.mark.parametrize("category", CATEGORIES)
def test_the_mesh_is_within_its_tolerance_of_the_solids(category, members, surface_samples):
    for shape in members[category]:
        points = np.concatenate([shape.vertices, surface_samples(shape, 2000)])
        nearest = np.min([np.abs(solid.signed_distance(points)) for solid in shape.solids], axis=0)
        assert nearest.max() < MESH_TOLERANCE
        assert shape.signed_distance(points).max() < MESH_TOLERANCE


@pytest.mark.parametrize("category", CATEGORIES)
def test_convex_parts_cover_the_shape_and_nothing_else_to_a_millimetre(category, members, surface_samples):
    for shape in members[category]:
        surface = surface_samples(shape, 400)
        rng = np.random.default_rng(0)
        gaps = []
        for corners in shape.convex_parts:
            hull = ConvexHull(corners).equations
            gaps.append((surface @ hull[:, :3].T + hull[:, 3]).max(axis=1))
            blends = rng.dirichlet(np.full(len(corners), 0.2), 100) @ corners
            assert shape.signed_distance(np.concatenate([corners, blends])).max() < HULL_TOLERANCE
        assert np.min(gaps, axis=0).max() < HULL_TOLERANCE


@pytest.mark.parametrize("category", CATEGORIES)
def test_mass_agrees_with_random_points_inside(category, members):
    shape = members[category][0]
    points, volume = inside(shape, 60_000)
    spread = shape.radius / np.sqrt(len(points))
    assert len(points) * volume == pytest.approx(shape.volume, rel=5 / np.sqrt(len(points)))
    assert np.linalg.norm(points.mean(0)) < 5 * spread
    inertia = np.trace(points.T @ points) * np.eye(3) - points.T @ points
    scale = np.abs(shape.inertia).max()
    np.testing.assert_allclose(inertia * volume / scale, shape.inertia / scale, atol=8 / np.sqrt(len(points)))


def outside_only(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Points on the surface, without those where two parts touch inside the shape: distances are 0 there too."""
    steps = 1e-6 * np.concatenate([np.eye(3), -np.eye(3)])
    around = np.max([shape.signed_distance(points + step) for step in steps], axis=0)
    return points[around > 1e-7]


@pytest.mark.parametrize("category", CATEGORIES)
def test_rotations_of_the_group_leave_the_surface_where_it_is(category, members, surface_samples):
    for shape in members[category]:
        points = outside_only(shape, surface_samples(shape, 60))
        for rotation in symmetry_rotations(shape.symmetry, steps=5)[1:]:
            turned = shape.signed_distance(points @ rotation.T)
            np.testing.assert_allclose(turned, shape.signed_distance(points), atol=1e-9)


@pytest.mark.parametrize("category", CATEGORIES)
def test_no_half_turn_beyond_the_group_leaves_the_surface_where_it_is(category, members):
    for shape in members[category]:
        group = symmetry_rotations(shape.symmetry, steps=72)
        for turn in np.array([np.diag(signs) for signs in ([-1.0, -1, 1], [-1.0, 1, -1], [1.0, -1, -1])]):
            is_element = np.abs(group - turn).max(axis=(1, 2)).min() < 1e-9
            moved = np.abs(shape.signed_distance(shape.vertices @ turn.T)).max()
            assert is_element or moved > 1e-4


@pytest.mark.parametrize("category", CATEGORIES)
def test_the_smallest_box_holds_the_mesh_and_touches_it_on_all_sides(category, members):
    for shape in members[category]:
        box = shape.minimum_box
        np.testing.assert_allclose(box.rotation @ box.rotation.T, np.eye(3), atol=1e-12)
        local = (shape.vertices - box.center) @ box.rotation
        reach = np.stack([-local.min(0), local.max(0)])
        np.testing.assert_allclose(reach, np.broadcast_to(box.size / 2, (2, 3)), atol=3 * MESH_TOLERANCE)
        assert np.prod(box.size) <= np.prod(shape.size + 2 * MESH_TOLERANCE)


@pytest.mark.parametrize("category", ["box", "sphere", "cylinder", "capsule"])
def test_primitives_say_what_they_are(category, members):
    shape = members[category][0]
    assert shape.primitive is not None
    kind, lengths = shape.primitive
    assert kind == category
    extents = {
        "box": lengths,
        "sphere": [2 * lengths[0]] * 3,
        "cylinder": [2 * lengths[0], 2 * lengths[0], lengths[-1]],
        "capsule": [2 * lengths[0], 2 * lengths[0], lengths[-1] + 2 * lengths[0]],
    }[category]
    np.testing.assert_allclose(shape.minimum_box.size, extents)


@pytest.mark.parametrize("category", sorted(set(CATEGORIES) - {"box", "cube", "sphere", "cylinder", "can", "capsule"}))
def test_other_shapes_claim_no_primitive(category, members):
    assert all(shape.primitive is None for shape in members[category])


EXTENTS = [
    ("sphere", {"radius": 0.04}, [0.08, 0.08, 0.08]),
    ("cylinder", {"radius": 0.03, "height": 0.07}, [0.06, 0.06, 0.07]),
    ("capsule", {"radius": 0.02, "length": 0.05}, [0.04, 0.04, 0.09]),
    ("torus", {"ring_radius": 0.05, "tube_radius": 0.02}, [0.14, 0.14, 0.04]),
    ("ellipsoid", {"half_axes": [0.02, 0.03, 0.05]}, [0.04, 0.06, 0.1]),
    ("snowman", {"radii": [0.04, 0.03], "distances": [0.05]}, [0.08, 0.08, 0.12]),
    ("crate", {"width": 0.2, "depth": 0.15, "height": 0.08, "wall": 0.01}, [0.2, 0.15, 0.08]),
]


@pytest.mark.parametrize(("family", "parameters", "size"), EXTENTS)
def test_sizes_are_those_of_the_surface_and_not_of_the_mesh(family, parameters, size):
    np.testing.assert_allclose(build(ShapeSpec(family, parameters)).size, size, rtol=1e-12)


@pytest.mark.parametrize("category", CATEGORIES)
def test_meshes_are_as_large_as_the_size_says(category, members):
    for shape in members[category]:
        np.testing.assert_allclose(np.ptp(shape.vertices, axis=0), shape.size, atol=2 * MESH_TOLERANCE)
