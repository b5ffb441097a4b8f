"""Distances, insides, welding and symmetry of meshes, against values known by hand."""

import numpy as np
import pytest
import trimesh

from datagen.meshes.build import find_symmetry
from datagen.meshes.distance import MeshSolid, squared_distances
from datagen.meshes.raycast import first_hits
from datagen.meshes.topology import smooth_normals, weld
from datagen.shapes.geometry.mass import of_mesh
from tests.worlds.meshes import BOX, triangles

CUBE = MeshSolid(BOX, triangles(), closed=True)


def cube_distance(points: np.ndarray) -> np.ndarray:
    """Signed distance to the cube of side 2."""
    q = np.abs(points) - 1
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(np.max(q, axis=1), 0)


def test_signed_distances_to_a_cube_are_exact():
    points = np.random.default_rng(0).uniform(-2, 2, (500, 3))
    np.testing.assert_allclose(CUBE.signed_distance(points), cube_distance(points), atol=1e-12)


def test_distances_to_triangles_of_very_different_size_are_exact():
    # A fine ball on a coarse box: the search tree holds only the small ones.
    ball = trimesh.creation.icosphere(2, 0.2)
    vertices = np.concatenate([BOX, ball.vertices + np.array([0, 0, 1.3])])
    faces = np.concatenate([triangles(), ball.faces + 8])
    points = np.random.default_rng(1).uniform(-2, 2, (50, 3))
    expected = np.min([squared_distances(points, face) for face in vertices[faces]], axis=0)
    np.testing.assert_allclose(MeshSolid(vertices, faces, closed=True).distance(points), np.sqrt(expected), atol=1e-12)


def test_points_within_a_limit_are_those_whose_distance_is_smaller():
    ball = trimesh.creation.icosphere(2, 0.9)
    faces = np.concatenate([np.asarray(ball.faces), triangles() + len(ball.vertices)])
    solid = MeshSolid(np.concatenate([ball.vertices, BOX]), faces, closed=True)
    points = np.random.default_rng(0).uniform(-1.3, 1.3, (2000, 3))
    near = solid.within(points, 0.04)
    np.testing.assert_array_equal(near, solid.distance(points) <= 0.04)
    assert 100 < np.count_nonzero(near) < 1000


def test_an_open_surface_has_no_inside():
    assert not MeshSolid(BOX, triangles()[:-2], closed=False).inside(np.zeros((1, 3)))[0]


def test_a_split_box_is_welded_and_closed():
    corners = BOX[triangles()].reshape(-1, 3)
    surface = weld(corners + 1e-8, np.arange(36).reshape(12, 3))
    assert (len(surface.vertices), surface.closed, surface.bodies) == (8, True, 1)
    assert not weld(BOX, triangles()[:-1]).closed


def test_inverted_bodies_are_turned_and_cavities_stay():
    inner = triangles()[:, ::-1]
    vertices = np.concatenate([BOX, 0.5 * BOX])
    hollow = weld(vertices, np.concatenate([triangles(), inner + 8]))
    assert of_mesh(hollow.vertices, hollow.faces).volume == pytest.approx(8 - 1)
    assert not hollow.turned.any()
    solid = weld(BOX, inner)
    assert of_mesh(solid.vertices, solid.faces).volume == pytest.approx(8)
    assert solid.turned.all()


def test_normals_are_shared_on_round_surfaces_only():
    ball = trimesh.creation.icosphere(3)
    normals = smooth_normals(ball.vertices, ball.faces)
    np.testing.assert_allclose(normals, ball.vertices[ball.faces], atol=0.02)
    flat = smooth_normals(BOX, triangles())
    assert set(np.round(np.abs(flat).max(axis=2).ravel(), 12)) == {1.0}


@pytest.mark.parametrize(
    ("mesh", "name"),
    [
        (trimesh.creation.box((1, 1, 2)), "D4"),
        (trimesh.creation.box((1, 1.5, 2)), "D2"),
        (trimesh.creation.cylinder(0.5, 2, sections=64), "Dinf"),
        (trimesh.creation.cone(0.5, 2, sections=64), "Cinf"),
        (trimesh.Trimesh(BOX * np.where(BOX.sum(axis=1, keepdims=True) > 2, 0.6, 1), triangles()), "C1"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_symmetry_of_simple_bodies(mesh: trimesh.Trimesh, name: str):
    vertices = np.asarray(mesh.vertices) - of_mesh(mesh.vertices, mesh.faces).center
    assert find_symmetry(vertices, MeshSolid(vertices, mesh.faces, closed=True)) == name


def test_rays_meet_a_cube_where_they_should():
    rng = np.random.default_rng(2)
    origins = rng.normal(size=(200, 3))
    origins *= 5 / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = rng.uniform(-0.9, 0.9, (200, 3)) - origins
    t, faces = first_hits(CUBE, origins, directions)
    assert np.all(faces >= 0)
    np.testing.assert_allclose(cube_distance(origins + t[:, None] * directions), 0, atol=1e-9)
    assert np.all(t < 1)
    assert np.all(np.isinf(first_hits(CUBE, origins, -directions)[0]))
