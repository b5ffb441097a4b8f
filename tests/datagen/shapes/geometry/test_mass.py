import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datagen.shapes.geometry import mass as masses
from datagen.shapes.geometry import mesh as meshes
from datagen.shapes.geometry import round_mesh
from datagen.shapes.geometry.mass import Mass


def assert_equal(actual: Mass, expected: Mass, rtol: float = 1e-9) -> None:
    scale = abs(expected.volume) ** (1 / 3)
    assert actual.volume == pytest.approx(expected.volume, rel=rtol)
    np.testing.assert_allclose(actual.center, expected.center, atol=rtol * scale)
    np.testing.assert_allclose(actual.inertia, expected.inertia, atol=rtol * np.abs(expected.inertia).max())


def turned_disc(radius: float, heights: np.ndarray) -> np.ndarray:
    """Profile of a ball's part between the given heights, as a fine polygon."""
    arc = np.stack([np.sqrt(np.maximum(radius**2 - heights**2, 0)), heights], axis=1)
    return np.vstack([[0, heights[0]], arc, [0, heights[-1]]])


def test_a_box_has_the_same_mass_as_its_mesh():
    triangles = meshes.box((0.02, 0.05, 0.03))
    shift = np.array([0.1, -0.2, 0.3])
    expected = masses.of_box((0.02, 0.05, 0.03)).placed(np.eye(3), shift)
    assert_equal(masses.of_mesh(triangles.vertices + shift, triangles.faces), expected)


def test_a_cylinder_has_the_textbook_moments():
    r, h = 0.03, 0.08
    volume = np.pi * r**2 * h
    across = volume * (3 * r**2 + h**2) / 12
    expected = Mass(volume, np.array([0, 0, h / 2]), np.diag([across, across, volume * r**2 / 2]))
    assert_equal(masses.of_revolution(np.array([[0, 0], [r, 0], [r, h], [0, h]])), expected)


def test_a_cone_has_the_textbook_moments():
    r, h = 0.03, 0.08
    volume = np.pi * r**2 * h / 3
    across = 3 / 20 * volume * r**2 + 3 / 80 * volume * h**2
    expected = Mass(volume, np.array([0, 0, h / 4]), np.diag([across, across, 0.3 * volume * r**2]))
    assert_equal(masses.of_revolution(np.array([[0, 0], [r, 0], [0, h]])), expected)


def test_a_cup_is_a_cylinder_less_its_cavity():
    cup = masses.of_revolution(np.array([[0, 0], [0.03, 0], [0.03, 0.07], [0.02, 0.07], [0.02, 0.01], [0, 0.01]]))
    outside = masses.of_revolution(np.array([[0, 0], [0.03, 0], [0.03, 0.07], [0, 0.07]]))
    cavity = masses.of_revolution(np.array([[0, 0.01], [0.02, 0.01], [0.02, 0.07], [0, 0.07]]))
    assert_equal(cup, masses.total([outside, cavity.negative()]))


def test_slices_of_a_ball_add_up_to_the_ball():
    parts = [masses.of_ball_slice(0.04, low, high) for low, high in ((-0.04, -0.01), (-0.01, 0.03), (0.03, 0.04))]
    assert_equal(masses.total(parts), masses.of_ellipsoid((0.04, 0.04, 0.04)))


def test_a_cap_is_what_its_fine_profile_sweeps():
    profile = turned_disc(0.04, 0.04 * np.sin(np.linspace(0.3, np.pi / 2, 20_000)))
    cap = masses.of_ball_slice(0.04, 0.04 * np.sin(0.3), 0.04)
    assert_equal(cap, masses.of_revolution(profile), rtol=1e-7)


def test_a_torus_is_what_a_fine_polygon_sweeps():
    profile = np.array([0.04, 0]) + 0.015 * meshes.circle(20_000)
    assert_equal(masses.of_torus(0.04, 0.015), masses.of_revolution(profile), rtol=1e-7)


def test_an_ellipsoid_is_a_stretched_ball():
    vertices, faces, _ = round_mesh.unit_dome(60)
    axes = np.array([0.03, 0.05, 0.02])
    assert_equal(masses.of_ellipsoid(axes), masses.of_mesh(vertices * axes, faces), rtol=2e-3)


def test_a_circular_segment_is_its_fine_polygon():
    half_angle = np.arcsin(0.5 * 0.03 / 0.04)
    angles = np.linspace(-half_angle, half_angle, 4001)
    polygon = 0.04 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    prism = meshes.extrusion(polygon, [range(len(polygon))], 0.01)
    assert_equal(masses.of_circular_segment(0.04, 0.03, 0.01), masses.of_mesh(prism.vertices, prism.faces), rtol=1e-6)


def test_turning_a_solid_turns_its_inertia():
    rotation, shift = Rotation.random(rng=np.random.default_rng(0)).as_matrix(), np.array([0.1, 0.0, -0.3])
    triangles = meshes.extrusion(np.array([[0.0, 0.0], [0.08, 0.0], [0.0, 0.03]]), [[0, 1, 2]], 0.02)
    expected = masses.of_mesh(triangles.vertices @ rotation.T + shift, triangles.faces)
    assert_equal(masses.of_mesh(triangles.vertices, triangles.faces).placed(rotation, shift), expected)
