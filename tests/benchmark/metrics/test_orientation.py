import doctest
import importlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.metrics.orientation import BOX_GROUP, box_orientation_error, orientation_error
from datagen.shapes.symmetry import symmetry_rotations

GROUPS = ("C1", "C2", "C5", "D1", "D2", "D4", "D6", "Cinf", "Dinf", "O", "SO3")


def rotations(count: int, seed: int = 0) -> np.ndarray:
    return Rotation.random(count, random_state=seed).as_matrix()


def turned(degrees: float, axis: str) -> np.ndarray:
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


@pytest.mark.parametrize("symmetry", GROUPS)
def test_turning_an_object_by_its_own_symmetry_is_no_error(symmetry: str):
    for truth, found in zip(rotations(5), rotations(5, seed=1), strict=True):
        expected = orientation_error(found, truth, symmetry)
        for element in symmetry_rotations(symmetry, steps=7):
            assert orientation_error(truth @ element, truth, symmetry) == pytest.approx(0, abs=1e-5)
            assert orientation_error(found @ element, truth, symmetry) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("symmetry", ["Cinf", "Dinf"])
def test_continuous_groups_are_the_limit_of_finite_ones(symmetry: str):
    for truth, found in zip(rotations(20), rotations(20, seed=1), strict=True):
        fine = orientation_error(found, truth, symmetry.replace("inf", "720"))
        assert orientation_error(found, truth, symmetry) == pytest.approx(fine, abs=0.3)
        assert orientation_error(found, truth, symmetry) <= fine + 1e-6


@pytest.mark.parametrize(
    ("degrees", "axis", "symmetry", "expected"),
    [
        (30, "z", "C1", 30),
        (179, "z", "C1", 179),
        (170, "z", "C2", 10),
        (80, "z", "D4", 10),
        (77, "z", "Cinf", 0),
        (77, "x", "Cinf", 77),
        (177, "x", "Dinf", 3),
        (177, "x", "C4", 177),
        (90, "y", "O", 0),
        (123, "y", "SO3", 0),
        (1e-6, "x", "C1", 1e-6),
    ],
)
def test_what_is_left_of_a_turn(degrees: float, axis: str, symmetry: str, expected: float):
    truth = rotations(1)[0]
    assert orientation_error(truth @ turned(degrees, axis), truth, symmetry) == pytest.approx(expected, abs=1e-8)


def test_how_the_axes_of_a_box_are_named_makes_no_difference():
    truth, box = rotations(2)
    for naming in BOX_GROUP:
        assert box_orientation_error(truth @ box @ naming, truth, "C1", box) == pytest.approx(0, abs=1e-5)
        off = truth @ turned(10, "x") @ box @ naming
        assert box_orientation_error(off, truth, "C1", box) == pytest.approx(10)


def test_a_symmetric_object_may_have_another_of_its_boxes():
    """A cylinder has as many boxes of least volume as there are turns about its axis."""
    truth, box = rotations(1)[0], np.eye(3)
    assert box_orientation_error(truth @ turned(33, "z"), truth, "Dinf", box) == pytest.approx(0, abs=1e-5)
    assert box_orientation_error(truth @ turned(33, "z"), truth, "D2", box) == pytest.approx(33)


def test_the_names_of_axes_can_only_help():
    for truth, found in zip(rotations(20), rotations(20, seed=1), strict=True):
        assert box_orientation_error(found, truth, "C2", np.eye(3)) <= orientation_error(found, truth, "C2") + 1e-9


def test_what_chance_gives():
    """The figures beside the tables of `benchmark.ranking.columns`; Mackenzie (1958) has 40.7 degrees for cubes."""
    truth, found = np.eye(3), rotations(4000)
    assert np.mean([orientation_error(f, truth, "C1") for f in found]) == pytest.approx(126.5, abs=1.5)
    assert np.mean([box_orientation_error(f, truth, "C1", truth) for f in found]) == pytest.approx(40.7, abs=0.6)


def test_the_example_in_the_docstring():
    result = doctest.testmod(importlib.import_module("benchmark.metrics.orientation"), extraglobs={"np": np})
    assert result.attempted > 0
    assert result.failed == 0
