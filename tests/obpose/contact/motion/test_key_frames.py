import numpy as np
import pytest

from obpose.contact.motion.key_frames import evenly_spread, follow_objects
from obpose.contact.motion.tracking import Cloud

NOTHING = Cloud(np.zeros((0, 3)), np.zeros((0, 3)))
CUBE = 0.01 * np.stack(np.meshgrid(*[np.arange(3.0)] * 3), axis=-1).reshape(-1, 3)
OBJECTS = np.repeat([0, 1], len(CUBE))


def two_cubes(step: int = 0) -> Cloud:
    """Cubes that touch, one centimetre further in each step."""
    points = np.concatenate([CUBE, CUBE + np.array([0.03, 0, 0])]) + np.array([0, 0.01 * step, 0])
    return Cloud(points, np.zeros_like(points))


@pytest.mark.parametrize("wrong", range(5))
def test_an_image_whose_objects_were_not_divided_gets_those_of_the_others(wrong: int):
    objects = [OBJECTS] * 5
    objects[wrong] = np.zeros_like(OBJECTS)
    found = follow_objects([two_cubes(step) for step in range(5)], objects, gap=0.012)
    assert all(np.array_equal(labels, OBJECTS) for labels in found)


def test_objects_of_a_single_image_stay_as_they_are():
    none = np.zeros(0, np.int64)
    found = follow_objects([NOTHING, two_cubes()], [none, OBJECTS], gap=0.012)
    assert [labels.tolist() for labels in found] == [[], OBJECTS.tolist()]


def test_key_frames_are_evenly_spread_over_the_images_with_points():
    seen = two_cubes()
    assert evenly_spread([NOTHING, *[seen] * 9]) == [1, 3, 5, 7, 9]
    assert evenly_spread([seen, NOTHING, seen]) == [0, 2]
    assert evenly_spread([NOTHING, seen]) == []
