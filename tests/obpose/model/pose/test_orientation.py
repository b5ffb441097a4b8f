"""From an image's pixels to rotations; the search for boxes is tested in test_minimum_volume.py."""

import math

import pytest
import torch

from obpose.model.pose.orientation import MIN_PIXELS, observed_rotation, standing_boxes
from obpose.model.pose.rotations import equivalents, geodesic_distance, rotation_from_vector
from tests.obpose.clouds import random_boxes

ROWS, COLUMNS = 40, 30
PIXELS = ROWS * COLUMNS


class Images:
    """Three boxes whose surface points lie in random pixels: 600, 400 and 200 of them, the same in two frames."""

    counts = 600, 400, 200

    def __init__(self) -> None:
        clouds, self.rotations, _ = random_boxes(3, max(self.counts), seed=2)
        generator = torch.Generator().manual_seed(0)
        place = torch.randperm(PIXELS, generator=generator)
        owners, points = torch.zeros(PIXELS, dtype=torch.long), torch.zeros(PIXELS, 3)
        for number, count in enumerate(self.counts):
            mine, place = place[:count], place[count:]
            owners[mine] = number + 1
            points[mine] = clouds[number, :count]
        self.owners = owners.view(1, 1, 1, ROWS, COLUMNS).expand(1, 2, -1, -1, -1).clone()
        self.points = points.view(1, 1, 1, ROWS, COLUMNS, 3).expand(1, 2, -1, -1, -1, -1).clone()

    def found(self, slots: int = 3) -> torch.Tensor:
        return observed_rotation(self.points, self.owners, slots=slots)


def test_each_slot_gets_the_orientation_of_the_box_that_its_pixels_show():
    images = Images()
    for frame in images.found()[0]:
        assert (angles_modulo_symmetry(frame, images.rotations) < math.radians(2)).all()


def test_pixels_of_others_have_no_say():
    images = Images()
    before = images.found()
    others = images.owners != 2
    images.points[others] = torch.rand(int(others.sum()), 3, generator=torch.Generator().manual_seed(7))
    assert torch.equal(images.found()[:, :, 1], before[:, :, 1])
    assert not torch.equal(images.found()[:, :, 0], before[:, :, 0])


def test_a_slot_of_more_pixels_than_are_looked_at_is_seen_on_all_of_its_sides():
    images = Images()
    images.owners[:] = 1
    inside = torch.rand(PIXELS, 3, generator=torch.Generator().manual_seed(1)) - 0.5
    cloud = torch.tensor([0.04, 0.03, 0.01]) * inside
    # What the first rows show is a smaller box within, turned by 30 degrees.
    turn = rotation_from_vector(torch.tensor([0.0, 0.0, math.pi / 6]))
    cloud[:300] = torch.tensor([0.012, 0.008, 0.01]) * inside[:300] @ turn.mT
    images.points[:] = cloud.view(1, 1, 1, ROWS, COLUMNS, 3)
    assert (angles_modulo_symmetry(images.found(1)[0, :, 0], torch.eye(3).expand(2, 3, 3)) < math.radians(5)).all()


@pytest.mark.parametrize("pixels", [0, MIN_PIXELS - 1])
def test_a_slot_of_too_few_pixels_keeps_its_orientation_and_has_none_at_first(pixels: int):
    images = Images()
    for frame in (0, 1):
        mine = (images.owners[0, frame] == 3).nonzero()
        if frame == 1:
            gone = mine[pixels:]
            images.owners[0, 1][tuple(gone.T)] = 0
    assert torch.equal(images.found()[0, 1, 2], images.found()[0, 0, 2])
    images.owners[0, 0] = images.owners[0, 1]
    assert torch.equal(images.found()[0, 0, 2], torch.eye(3))


def test_slots_without_pixels_and_scenes_without_depth_have_the_identity():
    images = Images()
    assert torch.equal(images.found(5)[0, :, 3:], torch.eye(3).expand(2, 2, 3, 3))
    images.owners[:] = 0
    assert torch.equal(images.found(2), torch.eye(3).expand(1, 2, 2, 3, 3))


def angles_modulo_symmetry(found: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """By the best of the 24 names of a box, radians."""
    named = equivalents(found)
    return geodesic_distance(named, truth[..., None, :, :].expand_as(named)).amin(dim=-1)


def upper_half(lift: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Points of the upper half of a block of 10 x 6 x 8 cm, turned by 20 degrees, and its centre; and their owners."""
    turn = rotation_from_vector(torch.tensor([0.0, 0.0, math.radians(20)]))
    unit = torch.rand(PIXELS, 3, generator=torch.Generator().manual_seed(3)) - 0.5
    unit[::2, 2] = 0.5  # the top
    unit[1::2, 0] = 0.5  # one side
    local = unit * torch.tensor([0.1, 0.06, 0.04]) + torch.tensor([0.0, 0.0, 0.02])
    points = local @ turn.mT + torch.tensor([0.2, -0.1, 0.04 + lift])
    owners = torch.ones(1, 1, 1, ROWS, COLUMNS, dtype=torch.long)
    return points.view(1, 1, 1, ROWS, COLUMNS, 3), owners


def test_boxes_of_standing_objects_reach_down_to_the_table():
    points, owners = upper_half(lift=-0.02)  # visible from 2 cm above the table
    center, rotation, found = standing_boxes(points, owners, slots=2, table=0.0)
    assert found[0, 0].tolist() == [True, False]
    torch.testing.assert_close(center[0, 0, 0], torch.tensor([0.2, -0.1, 0.03]), atol=2e-3, rtol=0)
    up = rotation[0, 0, 0].abs()[2].amax()
    assert up > math.cos(math.radians(2))


def test_boxes_of_objects_above_the_table_end_where_their_points_end():
    points, owners = upper_half(lift=0.05)
    center, _, _ = standing_boxes(points, owners, slots=1, table=0.0)
    torch.testing.assert_close(center[0, 0, 0], torch.tensor([0.2, -0.1, 0.11]), atol=2e-3, rtol=0)


def test_standing_boxes_move_with_the_world():
    points, owners = upper_half(lift=-0.02)
    turn, shift = rotation_from_vector(torch.tensor([0.0, 0.0, 1.0])), torch.tensor([1.0, -2.0, 0.5])
    center, _, _ = standing_boxes(points, owners, slots=1, table=0.0)
    moved, _, _ = standing_boxes(points @ turn.mT + shift, owners, slots=1, table=0.5)
    torch.testing.assert_close(moved, center @ turn.mT + shift, atol=2e-3, rtol=0)
