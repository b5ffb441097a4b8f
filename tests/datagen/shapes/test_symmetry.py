import numpy as np
import pytest

from datagen.scene import ShapeSpec
from datagen.shapes import build
from datagen.shapes.symmetry import about_z, is_continuous, name_group, symmetry_rotations

GROUPS = ["C1", "C2", "C5", "D1", "D2", "D4", "D6", "O", "Cinf", "Dinf", "SO3"]
TABLE = {"width": 0.1, "height": 0.07, "thickness": 0.006, "leg": 0.008, "legs": "square"}


@pytest.mark.parametrize("name", GROUPS)
def test_elements_are_rotations_and_the_first_is_the_identity(name):
    rotations = symmetry_rotations(name)
    np.testing.assert_allclose(
        rotations @ np.swapaxes(rotations, 1, 2), np.broadcast_to(np.eye(3), rotations.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1)
    np.testing.assert_array_equal(rotations[0], np.eye(3))


@pytest.mark.parametrize(
    ("name", "order"), [("C1", 1), ("C5", 5), ("D2", 4), ("D6", 12), ("O", 24), ("Cinf", 36), ("Dinf", 72)]
)
def test_groups_have_their_order_and_no_element_twice(name, order):
    rotations = symmetry_rotations(name)
    assert len(np.unique(np.round(rotations.reshape(-1, 9), 6) + 0.0, axis=0)) == len(rotations) == order


@pytest.mark.parametrize("name", [name for name in GROUPS if name != "SO3"])
def test_the_product_of_two_elements_is_an_element(name):
    rotations = symmetry_rotations(name, steps=8)
    products = (rotations[:, None] @ rotations).reshape(-1, 1, 9)
    assert np.abs(products - rotations.reshape(-1, 9)).max(axis=2).min(axis=1).max() < 1e-9


@pytest.mark.parametrize("name", GROUPS[:8])
def test_a_finite_group_is_named_by_its_turns(name):
    tilt = about_z(np.radians([2.0]))[0][[2, 0, 1]][:, [2, 0, 1]]  # 2 degrees about x
    turns = symmetry_rotations(name)[1:][::-1]
    for given in (turns, tilt @ turns @ tilt.T):
        assert name_group(given, np.zeros((0, 3))) == name
    swapped = {"C1": "C1", "C2": "D1", "D1": "C2", "D2": "D2", "O": "O"}  # x and z
    assert name_group(turns[:, ::-1, ::-1], np.zeros((0, 3))) == swapped.get(name)


def test_a_continuous_group_is_named_by_its_axes():
    x, z, flip = [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], np.diag([1.0, -1.0, -1.0])[None]
    none = np.zeros((0, 3, 3))
    assert [name_group(*given) for given in ((none, np.array([z])), (flip, np.array([z])))] == ["Cinf", "Dinf"]
    assert [name_group(none, np.array(axes)) for axes in ([x], [x, z])] == [None, "SO3"]


def test_only_groups_with_a_free_axis_are_continuous():
    assert [is_continuous(name) for name in GROUPS] == [False] * 8 + [True] * 3


@pytest.mark.parametrize("name", ["", "C0", "C", "d2", "D-1", "SO2", "Oh"])
def test_other_names_are_refused(name):
    with pytest.raises(ValueError, match="no rotation group"):
        symmetry_rotations(name)


@pytest.mark.parametrize(
    ("family", "parameters", "symmetry"),
    [
        ("box", {"size": [0.03, 0.04, 0.05]}, "D2"),
        ("box", {"size": [0.03, 0.03, 0.05]}, "D4"),
        ("box", {"size": [0.03, 0.03, 0.03]}, "O"),
        ("sphere", {"radius": 0.03}, "SO3"),
        ("cylinder", {"radius": 0.03, "height": 0.05}, "Dinf"),
        ("frustum", {"low_radius": 0.03, "high_radius": 0.0, "height": 0.05}, "Cinf"),
        ("frustum", {"low_radius": 0.03, "high_radius": 0.03, "height": 0.05}, "Dinf"),
        ("torus", {"ring_radius": 0.03, "tube_radius": 0.01}, "Dinf"),
        ("prism", {"corners": 6, "radius": 0.03, "height": 0.05}, "D6"),
        ("angle", {"arm_x": 0.05, "arm_z": 0.05, "thickness": 0.01, "height": 0.03}, "C2"),
        ("angle", {"arm_x": 0.04, "arm_z": 0.05, "thickness": 0.01, "height": 0.03}, "C1"),
        ("bracket", {"base": 0.05, "upright": 0.05, "width": 0.03, "thickness": 0.01, "gusset": 0.02}, "C2"),
        ("jack", {"lengths": [0.06, 0.06, 0.06], "width": 0.015}, "O"),
        ("cross", {"length_x": 0.06, "length_y": 0.06, "width": 0.02, "height": 0.03}, "D4"),
        ("superquadric", {"half_axes": [0.03, 0.03, 0.05], "roundness": 0.5, "squareness": 0.4}, "D4"),
        ("superquadric", {"half_axes": [0.03, 0.03, 0.05], "roundness": 0.5, "squareness": 1.0}, "D24"),
        ("superquadric", {"half_axes": [0.03, 0.04, 0.05], "roundness": 0.5, "squareness": 0.4}, "D2"),
        ("box", {"size": [0.05, 0.03, 0.03]}, "D4"),
        ("ellipsoid", {"half_axes": [0.03, 0.05, 0.03]}, "Dinf"),
        ("jack", {"lengths": [0.05, 0.06, 0.06], "width": 0.015}, "D4"),
        ("lathe", {"profile": [[0.03, 0.0], [0.02, 0.03], [0.03, 0.06]]}, "Dinf"),
        ("lathe", {"profile": [[0.03, 0.0], [0.02, 0.03], [0.03, 0.06]], "wall": 0.004, "floor": 0.005}, "Cinf"),
        ("lathe", {"profile": [[0.03, 0.0], [0.02, 0.03], [0.03, 0.05]]}, "Cinf"),
        ("table", TABLE | {"depth": 0.1}, "C4"),
        ("table", TABLE | {"depth": 0.08}, "C2"),
        ("hammer", {"handle_radius": 0.01, "handle_length": 0.1, "head_size": [0.04, 0.04, 0.03]}, "C4"),
        ("hammer", {"handle_radius": 0.01, "handle_length": 0.1, "head_size": [0.06, 0.04, 0.03]}, "C2"),
        ("snowman", {"radii": [0.03, 0.03], "distances": [0.05]}, "Dinf"),
        ("crate", {"width": 0.1, "depth": 0.1, "height": 0.05, "wall": 0.01}, "C4"),
        ("crate", {"width": 0.1, "depth": 0.08, "height": 0.05, "wall": 0.01}, "C2"),
    ],
)
def test_exactly_equal_parameters_make_the_larger_group(family, parameters, symmetry):
    shape = build(ShapeSpec(family, parameters))
    assert shape.symmetry == symmetry
    for rotation in symmetry_rotations(symmetry, steps=7):
        assert (
            np.abs(shape.signed_distance(shape.vertices @ rotation.T) - shape.signed_distance(shape.vertices)).max()
            < 1e-9
        )
