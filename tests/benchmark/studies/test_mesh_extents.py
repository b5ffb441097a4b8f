import numpy as np
import pytest

from benchmark.studies.mesh_extents import DENSITIES, match, summary


def test_objects_are_matched_by_the_overlap_of_their_masks():
    truth, found = np.zeros((20, 20), int), np.zeros((20, 20), int)
    truth[:8, :8], found[:8, :7] = 1, 5  # IoU 0.875
    truth[10:18, :8], found[10:18, 4:12] = 2, 3  # IoU 1/3
    truth[:8, 12:], found[:8, 12:] = 3, 0  # not found
    truth[18:, 18:], found[18:, 18:] = 4, 2  # too few pixels
    assert match(truth, found) == [(0, 5)]


def test_errors_are_medians_over_objects_and_axes():
    pair = [
        {"density": 0.5, "cut": True, "x": 0.1, "y": 0.2, "z": 0.3},
        {"density": 0.5, "cut": True, "x": -0.2, "y": 0.2, "z": 0.2},
    ]
    first, *others = summary(pair)
    assert len(others) == len(DENSITIES) - 1
    assert (first["objects, whole"], first["objects, cut at the table"]) == (0, 2)
    assert first["median error, cut at the table"] == pytest.approx(0.2)
    assert first["signed, cut at the table"] == pytest.approx(0.2)
