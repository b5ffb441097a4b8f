import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from datagen.shapes.geometry import mesh, round_mesh, sdf
from datagen.shapes.shape import Solid

L_SHAPE = np.array([[0.0, 0.0], [0.08, 0.0], [0.08, 0.02], [0.03, 0.02], [0.03, 0.06], [0.0, 0.06]])
CUP = np.array([[0.0, 0.0], [0.03, 0.0], [0.045, 0.07], [0.04, 0.07], [0.026, 0.006], [0.0, 0.006]])
OCTAHEDRON = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]) / np.sqrt(3)

SOLIDS: dict[str, Solid] = {
    "sphere": sdf.Sphere(0.04),
    "box": sdf.Box((0.06, 0.1, 0.03)),
    "capsule": sdf.Capsule(0.02, 0.06),
    "torus": sdf.Torus(0.04, 0.015),
    "ellipsoid": sdf.Ellipsoid((0.03, 0.05, 0.02)),
    "polyhedron": sdf.ConvexPolyhedron(OCTAHEDRON, np.full(8, 0.03)),
    "extrusion": sdf.Extrusion(L_SHAPE, 0.04),
    "revolution": sdf.Revolution(CUP),
}
MESHES = {
    "sphere": lambda: round_mesh.ellipsoid((0.04, 0.04, 0.04), 4e-5),
    "box": lambda: mesh.box((0.06, 0.1, 0.03)),
    "capsule": lambda: round_mesh.capsule(0.02, 0.06),
    "torus": lambda: round_mesh.torus(0.04, 0.015),
    "ellipsoid": lambda: round_mesh.ellipsoid((0.03, 0.05, 0.02), 4e-5),
    "extrusion": lambda: mesh.extrusion(L_SHAPE, [[0, 1, 2, 3], [0, 3, 4, 5]], 0.04),
    "revolution": lambda: mesh.revolution(CUP),
}
coordinates = st.floats(-0.15, 0.15)
points = st.tuples(coordinates, coordinates, coordinates)


def cloud(count: int, extent: float = 0.1) -> np.ndarray:
    return np.random.default_rng(1).uniform(-extent, extent, (count, 3))


@pytest.mark.parametrize("name", MESHES)
def test_distance_is_that_to_the_closest_of_many_points_on_the_surface(name, surface_samples):
    surface = surface_samples(MESHES[name](), 200_000)
    queries = cloud(3000)
    nearest, _ = KDTree(surface).query(queries)
    # Samples lie a fifth of a millimetre apart on average, and on a mesh that is off by 0.08 mm.
    np.testing.assert_allclose(np.abs(SOLIDS[name].signed_distance(queries)), nearest, atol=9e-4)
    assert np.abs(np.abs(SOLIDS[name].signed_distance(queries)) - nearest).mean() < 8e-5


@pytest.mark.parametrize("name", SOLIDS)
@given(a=points, b=points)
def test_distance_never_changes_faster_than_the_point_moves(name, a, b):
    pair = np.array([a, b])
    first, second = SOLIDS[name].signed_distance(pair)
    assert abs(first - second) <= np.linalg.norm(pair[0] - pair[1]) + 1e-12


@pytest.mark.parametrize(
    ("name", "inside"),
    [
        ("sphere", lambda p: (p**2).sum(1) < 0.04**2),
        ("box", lambda p: (np.abs(p) < [0.03, 0.05, 0.015]).all(1)),
        ("torus", lambda p: (np.hypot(p[:, 0], p[:, 1]) - 0.04) ** 2 + p[:, 2] ** 2 < 0.015**2),
        ("ellipsoid", lambda p: ((p / [0.03, 0.05, 0.02]) ** 2).sum(1) < 1),
        ("polyhedron", lambda p: np.abs(p).sum(1) < 0.03 * np.sqrt(3)),
        (
            "extrusion",
            lambda p: (
                (np.abs(p[:, 2]) < 0.02)
                & (p[:, :2] > 0).all(1)
                & (((p[:, 0] < 0.08) & (p[:, 1] < 0.02)) | ((p[:, 0] < 0.03) & (p[:, 1] < 0.06)))
            ),
        ),
    ],
)
def test_distance_is_negative_exactly_inside(name, inside):
    queries = cloud(20_000, 0.09)
    np.testing.assert_array_equal(SOLIDS[name].signed_distance(queries) < 0, inside(queries))


def test_a_cup_is_empty_where_its_cavity_is_and_solid_in_its_wall():
    queries = np.array([[0.0, 0.0, 0.003], [0.0, 0.0, 0.03], [0.0355, 0.0, 0.035], [0.0, 0.0, -0.01], [0.0, 0.0, 0.1]])
    np.testing.assert_array_equal(SOLIDS["revolution"].signed_distance(queries) < 0, [True, False, True, False, False])


def test_points_on_the_axis_are_not_near_the_profile_edge_that_lies_there():
    cylinder = sdf.Revolution(np.array([[0, -0.05], [0.02, -0.05], [0.02, 0.05], [0, 0.05]]))
    np.testing.assert_allclose(cylinder.signed_distance(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.06]])), [-0.02, 0.01])


def test_polyhedron_is_exact_in_front_of_a_face_and_too_short_in_front_of_a_corner():
    polyhedron = SOLIDS["polyhedron"]
    corner = 0.03 * np.sqrt(3)
    queries = np.array([OCTAHEDRON[0] * 0.05, [corner + 0.01, 0, 0]])
    face, tip = polyhedron.signed_distance(queries)
    assert face == pytest.approx(0.02)
    assert 0 < tip < 0.01


def test_a_placed_solid_moves_with_its_frame():
    rotation, shift = Rotation.random(rng=np.random.default_rng(3)).as_matrix(), np.array([0.1, -0.2, 0.3])
    queries = cloud(500)
    moved = sdf.Placed(SOLIDS["box"], rotation, shift)
    expected = SOLIDS["box"].signed_distance(queries)
    np.testing.assert_allclose(moved.signed_distance(queries @ rotation.T + shift), expected, atol=1e-12)
