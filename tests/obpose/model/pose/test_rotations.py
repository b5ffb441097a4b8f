import math

import pytest
import torch
from scipy.spatial.transform import Rotation

from obpose.model.pose.rotations import (
    box_grid,
    box_rotations,
    equivalents,
    geodesic_distance,
    healpix_directions,
    rotation_from_vector,
    rotation_grid,
    small_rotations,
)
from tests.obpose.clouds import random_rotations

LEVELS = (0, 1, 2)


@pytest.mark.parametrize("level", LEVELS)
def test_pixels_stand_for_equal_areas(level):
    """Half of a ring and all before it cover as much of the sphere as lies above the ring: (1 - z) / 2."""
    directions = healpix_directions(level).double()
    assert len(directions) == 12 * 4**level
    heights, counts = torch.unique(directions[:, 2].round(decimals=6), return_counts=True)
    heights, counts = heights.flip(0), counts.flip(0)
    share = (counts.cumsum(0) - 0.5 * counts).double() / len(directions)
    torch.testing.assert_close(share, (1 - heights) / 2, atol=1e-6, rtol=0)


@pytest.mark.parametrize("level", LEVELS)
def test_directions_are_unit_vectors_around_a_middle_of_zero(level):
    directions = healpix_directions(level)
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(len(directions)))
    torch.testing.assert_close(directions.mean(dim=0), torch.zeros(3), atol=1e-6, rtol=0)


def test_the_twelve_base_pixels_are_where_healpix_has_them():
    """Gorski et al. 2005, figure 2: four at z = 2/3, four on the equator, four at -2/3, turned by 45 degrees."""
    directions = healpix_directions(0)
    azimuth = torch.atan2(directions[:, 1], directions[:, 0]).rad2deg() % 360
    torch.testing.assert_close(directions[:, 2], torch.tensor([2 / 3] * 4 + [0.0] * 4 + [-2 / 3] * 4))
    expected = torch.tensor([45.0, 135, 225, 315, 0, 90, 180, 270, 45, 135, 225, 315])
    torch.testing.assert_close(azimuth, expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize(("level", "spacing", "gap"), [(0, 60, 52), (1, 30, 27), (2, 15, 13)])
def test_grids_leave_no_gaps(level, spacing, gap):
    grid = rotation_grid(level)
    assert len(grid) == 72 * 8**level
    assert_rotations(grid)
    to_others = angles_between(grid[:: len(grid) // 72], grid).sort(dim=1).values[:, 1]
    assert to_others.median().item() == pytest.approx(spacing, abs=1)
    assert angles_between(random_rotations(300, torch.Generator().manual_seed(0)), grid).amin(dim=1).max() < gap


def test_each_rotation_of_the_grid_takes_the_z_axis_to_its_direction():
    expected = healpix_directions(1).repeat_interleave(12, dim=0)
    torch.testing.assert_close(rotation_grid(1)[:, :, 2], expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize(("level", "members", "gap"), [(1, 24, 30), (2, 204, 14)])
def test_reduced_grids_reach_every_box(level, members, gap):
    grid = box_grid(level)
    assert len(grid) == members
    boxes = equivalents(random_rotations(200, torch.Generator().manual_seed(0)))
    nearest = angles_between(boxes.flatten(0, 1), grid).unflatten(0, (200, 24)).amin(dim=(1, 2))
    assert nearest.max() < gap


def test_members_of_a_reduced_grid_are_nearest_to_the_identity_of_their_equivalents():
    angles = angles_between(torch.eye(3)[None], equivalents(box_grid(2)).flatten(0, 1)).reshape(-1, 24)
    assert bool((angles[:, 0] <= angles.amin(dim=1) + 1e-2).all())


def test_box_rotations_are_the_group_of_the_cube():
    group = box_rotations()
    assert_rotations(group)
    torch.testing.assert_close(group[0], torch.eye(3))
    products = torch.einsum("aij,bjk->abik", group, group).flatten(0, 1)
    assert len(torch.unique(group.reshape(24, 9), dim=0)) == 24
    assert len(torch.unique(torch.cat([group, products]).reshape(-1, 9), dim=0)) == 24


def test_equivalents_rename_the_axes_of_a_box():
    rotation = random_rotations(1, torch.Generator().manual_seed(1))[0]
    names = equivalents(rotation)
    torch.testing.assert_close(names[0], rotation)
    corners = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    turned = (names @ corners.T).mT
    distances = torch.cdist(turned, (rotation @ corners.T).T.expand(24, -1, -1))
    torch.testing.assert_close(distances.amin(dim=1), torch.zeros(24, 8), atol=1e-5, rtol=0)


@pytest.mark.parametrize("degrees", [0.0, 1e-3, 1.0, 90.0, 179.0])
def test_the_distance_of_a_turn_is_its_angle(degrees):
    axis = torch.tensor([2.0, -1.0, 2.0]) / 3
    start = random_rotations(1, torch.Generator().manual_seed(2))[0].double()
    turned = start @ rotation_from_vector(axis.double() * math.radians(degrees))
    assert geodesic_distance(start, turned).rad2deg().item() == pytest.approx(degrees, rel=1e-4, abs=1e-6)


def test_distances_do_not_depend_on_the_frame_and_are_finite_at_both_ends():
    a, b, frame = random_rotations(3, torch.Generator().manual_seed(3))
    torch.testing.assert_close(geodesic_distance(a, b), geodesic_distance(frame @ a, frame @ b))
    torch.testing.assert_close(geodesic_distance(a, b), geodesic_distance(b, a))
    assert geodesic_distance(a, a) == 0
    half_turn = rotation_from_vector(torch.tensor([math.pi, 0.0, 0.0]))
    assert geodesic_distance(a, a @ half_turn).item() == pytest.approx(math.pi, abs=1e-3)


def test_rotations_of_vectors_agree_with_scipy():
    vectors = torch.randn(50, 3, generator=torch.Generator().manual_seed(0)).double() * 2
    vectors[0] = 0
    vectors[1] *= 1e-9
    expected = torch.from_numpy(Rotation.from_rotvec(vectors.numpy()).as_matrix())
    torch.testing.assert_close(rotation_from_vector(vectors), expected)


def test_random_rotations_have_no_preference_and_repeat_with_their_generator():
    drawn = random_rotations(4000, torch.Generator().manual_seed(0))
    assert_rotations(drawn)
    assert drawn.mean(dim=0).abs().max() < 0.03
    assert torch.equal(drawn, random_rotations(4000, torch.Generator().manual_seed(0)))


def test_small_rotations_fill_a_ball():
    """The cube of the angle is spread evenly, and no direction is preferred."""
    small = small_rotations(64, 0.3)
    angles = geodesic_distance(small, torch.eye(3).expand(64, 3, 3))
    assert angles.max() <= 0.3
    share = (angles / 0.3) ** 3
    torch.testing.assert_close(share.sort().values, (torch.arange(64) + 0.5) / 64, atol=0.05, rtol=0)
    skew = small - small.mT
    axes = torch.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], dim=1)
    assert axes.mean(dim=0).norm() < 0.03


def angles_between(a, b):
    """Degrees, of all pairs."""
    traces = torch.einsum("aij,bij->ab", a.double(), b.double())
    return torch.acos(((traces - 1) / 2).clamp(-1, 1)).rad2deg()


def assert_rotations(rotations):
    torch.testing.assert_close(rotations.mT @ rotations, torch.eye(3).expand_as(rotations), atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(len(rotations)))
