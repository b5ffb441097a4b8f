import numpy as np

from obpose.contact.motion.tracking import Cloud, track

CUBE = 0.01 * np.stack(np.meshgrid(*[np.arange(3.0)] * 3), axis=-1).reshape(-1, 3)
ROW = np.concatenate([CUBE, CUBE + np.array([0.06, 0, 0])])
"""Two cubes of 2 cm, 6 cm apart."""
OBJECTS = np.repeat([0, 1], len(CUBE))


def test_objects_that_speed_up_are_not_taken_for_those_before_them():
    # In the last step the cube behind comes nearer to where the other one was than to its own place.
    clouds = [Cloud(ROW + np.array([place, 0, 0]), 0 * ROW) for place in (0.0, 0.02, 0.06, 0.12, 0.2)]
    assert all(np.array_equal(labels, OBJECTS) for labels in track(clouds, 0, OBJECTS, 0.02))
