import numpy as np
import pytest

from datagen.shapes.geometry import mesh, round_mesh, sdf
from datagen.shapes.shape import MESH_TOLERANCE

CONE = np.array([[0.0, 0.0], [0.03, 0.0], [0.0, 0.08]])
VASE = np.array(
    [[0.0, 0.0], [0.03, 0.0], [0.04, 0.05], [0.02, 0.1], [0.015, 0.1], [0.03, 0.05], [0.02, 0.01], [0.0, 0.01]]
)
STAR = np.array(
    [[0.04, 0.0], [0.01, 0.01], [0.0, 0.04], [-0.01, 0.01], [-0.04, 0.0], [-0.01, -0.01], [0.0, -0.04], [0.01, -0.01]]
)
STAR_PIECES = [[7, 0, 1], [1, 2, 3], [3, 4, 5], [5, 6, 7], [1, 3, 5, 7]]

CASES = {
    "small sphere": (round_mesh.ellipsoid((0.01, 0.01, 0.01)), sdf.Sphere(0.01)),
    "large sphere": (round_mesh.ellipsoid((0.08, 0.08, 0.08)), sdf.Sphere(0.08)),
    "ellipsoid": (round_mesh.ellipsoid((0.03, 0.08, 0.02)), sdf.Ellipsoid((0.03, 0.08, 0.02))),
    "capsule": (round_mesh.capsule(0.03, 0.05), sdf.Capsule(0.03, 0.05)),
    "thin torus": (round_mesh.torus(0.06, 0.01), sdf.Torus(0.06, 0.01)),
    "thick torus": (round_mesh.torus(0.04, 0.03), sdf.Torus(0.04, 0.03)),
    "cone": (mesh.revolution(CONE), sdf.Revolution(CONE)),
    "vase": (mesh.revolution(VASE), sdf.Revolution(VASE)),
    "box": (mesh.box((0.03, 0.05, 0.02)), sdf.Box((0.03, 0.05, 0.02))),
    "star": (mesh.extrusion(STAR, STAR_PIECES, 0.02), sdf.Extrusion(STAR, 0.02)),
}


@pytest.mark.parametrize("name", CASES)
def test_every_point_of_the_mesh_is_close_to_the_surface(name, surface_samples):
    triangles, solid = CASES[name]
    middles = triangles.vertices[triangles.faces].mean(axis=1)
    points = np.concatenate([triangles.vertices, middles, surface_samples(triangles, 5000)])
    assert np.abs(solid.signed_distance(points)).max() < MESH_TOLERANCE


@pytest.mark.parametrize("name", CASES)
def test_the_mesh_is_closed_and_every_edge_is_used_once_in_each_direction(name):
    faces = CASES[name][0].faces
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = {tuple(edge) for edge in edges.tolist()}
    assert len(forward) == len(edges)
    assert forward == {(end, start) for start, end in forward}


@pytest.mark.parametrize("name", CASES)
def test_the_mesh_faces_outwards_and_its_normals_are_units_on_the_same_side(name):
    triangles, _ = CASES[name]
    a, b, c = np.moveaxis(triangles.vertices[triangles.faces], 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0
    facing = mesh.unit(np.cross(b - a, c - a))
    np.testing.assert_allclose(np.linalg.norm(triangles.normals, axis=-1), 1, atol=1e-12)
    assert np.einsum("fx,fcx->fc", facing, triangles.normals).min() > 0.5


@pytest.mark.parametrize("name", ["small sphere", "ellipsoid", "capsule", "thin torus", "thick torus"])
def test_normals_at_the_corners_are_the_gradient_of_the_distance(name):
    triangles, solid = CASES[name]
    corners, normals = triangles.vertices[triangles.faces].reshape(-1, 3), triangles.normals.reshape(-1, 3)
    step = 1e-6 * normals
    rise = solid.signed_distance(corners + step) - solid.signed_distance(corners - step)
    np.testing.assert_allclose(rise / 2e-6, 1, atol=2e-3)


@pytest.mark.parametrize(
    ("name", "most"), [("small sphere", 600), ("thin torus", 3500), ("cone", 90), ("box", 12), ("star", 28)]
)
def test_few_triangles_suffice(name, most):
    assert len(CASES[name][0].faces) <= most


def test_a_circle_of_chords_is_as_far_outside_as_inside():
    count = mesh.segments_of_circle(0.05, 1e-4)
    corner, middle = 0.05 * mesh.balanced(count), 0.05 * mesh.balanced(count) * np.cos(np.pi / count)
    assert corner - 0.05 == pytest.approx(0.05 - middle)
    assert corner - 0.05 <= 1e-4 < 0.05 * mesh.balanced(count - 1) - 0.05


def test_smooth_corners_share_their_normals_and_edges_do_not():
    triangles, _ = CASES["vase"]
    vertices = triangles.vertices[triangles.faces].reshape(-1, 3)
    normals = triangles.normals.reshape(-1, 3)
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    belly = np.isclose(vertices[:, 2], 0.05) & (radius > 0.035)
    assert np.ptp(normals[belly, 2]) < 1e-12
    foot = np.isclose(vertices[:, 2], 0.0) & (radius > 0.01)
    assert np.ptp(normals[foot, 2]) > 0.7
