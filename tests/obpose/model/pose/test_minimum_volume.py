import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from obpose.model.pose.minimum_volume import Clouds, find_candidates, follow, gather_clouds, orient
from obpose.model.pose.rotations import equivalents, geodesic_distance, rotation_from_vector
from tests.obpose.clouds import (
    as_tensor,
    box_surface,
    minimum_volume_rotation,
    random_boxes,
    random_rotations,
    random_shapes,
    trimesh_volumes,
)

SEARCH = {"grid_level": 1, "refinements": 8}
FOLLOW = {**SEARCH, "tolerance": 0.01, "min_points": 10}
THICKENED = 5e-3
"""Boxes are compared with edges a little longer, which may change the order of volumes this close."""


@pytest.fixture(scope="module")
def shapes():
    return random_shapes(20, 300, seed=1)


@pytest.mark.parametrize(("points", "median", "astray"), [(300, 0.3, 0.0), (100, 0.3, 0.0), (30, 0.6, 0.05)])
def test_boxes_are_recovered(points, median, astray):
    clouds, truth, _ = random_boxes(40, points)
    errors = error_modulo_symmetry(tightest(clouds), truth)
    assert errors.median() < median
    assert (errors > 15).float().mean() <= astray


def test_boxes_are_as_tight_as_those_of_trimesh(shapes):
    ratios = volumes(shapes, tightest(shapes)) / trimesh_volumes(shapes)
    assert ratios.median() <= 1.02
    assert ratios.quantile(0.95) <= 1.05


def test_the_volume_does_not_depend_on_how_the_cloud_is_turned_or_where_it_is(shapes):
    turn = random_rotations(len(shapes), torch.Generator().manual_seed(5))
    turned = shapes @ turn.mT + torch.tensor([0.4, -0.3, 0.2])
    ratios = volumes(turned, tightest(turned)) / volumes(shapes, tightest(shapes))
    assert ratios.log().abs().median() < 0.01
    assert ratios.log().abs().quantile(0.9) < 0.06


def test_a_cloud_scaled_is_a_box_scaled(shapes):
    torch.testing.assert_close(tightest(4 * shapes), tightest(shapes), atol=1e-3, rtol=0)


def test_the_24_names_of_a_box_have_one_volume(shapes):
    named = equivalents(tightest(shapes))
    each = torch.stack([volumes(shapes, named[:, name]) for name in range(24)], dim=1)
    torch.testing.assert_close(each, each[:, :1].expand(-1, 24))


@pytest.mark.parametrize(
    "cloud",
    [
        torch.zeros(12, 3),
        torch.full((12, 3), 0.7),
        torch.linspace(0, 1, 12)[:, None] * torch.tensor([0.1, 0.2, -0.1]),
        torch.rand(12, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([0.1, 0.2, 0.0]),
    ],
    ids=["origin", "point", "line", "plane"],
)
def test_degenerate_clouds_have_rotations_too(cloud):
    for seen in (0, 1, 12):
        assert_rotations(minimum_volume_rotation(cloud[None], torch.arange(12)[None] < seen, **SEARCH))


def test_a_flat_cloud_gets_the_smallest_rectangle():
    """As of one visible side of a box, whose boxes all have no volume."""
    flat = as_tensor(np.random.default_rng(0).uniform(-0.5, 0.5, (1, 200, 3)) * [0.1, 0.06, 0.0])
    flat[0, :4] = torch.tensor([[x, y, 0] for x in (-0.05, 0.05) for y in (-0.03, 0.03)])
    turn = random_rotations(1, torch.Generator().manual_seed(1))
    assert error_modulo_symmetry(tightest(flat @ turn.mT), turn) < 1


def test_clouds_are_centred_on_their_valid_points_wherever_the_world_s_origin_is(shapes):
    points, valid = shapes + torch.tensor([3.0, 0.0, 0.0]), torch.arange(shapes.shape[1]) % 3 == 1
    clouds = gather_clouds(points, valid.expand(points.shape[:2]))
    expected = gather_clouds(points[:, valid], torch.ones(len(points), int(valid.sum()), dtype=torch.bool))
    torch.testing.assert_close(clouds.points[valid], expected.points)
    torch.testing.assert_close(clouds.thickness, expected.thickness)


def test_points_that_are_not_valid_have_no_say(shapes):
    generator = torch.Generator().manual_seed(0)
    valid = torch.rand(shapes.shape[:2], generator=generator) < 0.7
    noise = torch.randn(shapes.shape, generator=generator)
    expected = minimum_volume_rotation(shapes, valid, **SEARCH)
    hidden = torch.where(valid[..., None], shapes, noise)
    torch.testing.assert_close(minimum_volume_rotation(hidden, valid, **SEARCH), expected)
    padded = torch.cat([noise[:, :50], hidden, torch.full_like(noise[:, :20], torch.nan)], dim=1)
    mask = torch.nn.functional.pad(valid, (50, 20))
    torch.testing.assert_close(minimum_volume_rotation(padded, mask, **SEARCH), expected)


def test_the_search_is_in_single_precision(shapes):
    clouds = shapes[None, None]
    seen = seen_everywhere(clouds)
    expected = orient(clouds, seen, **FOLLOW)
    with torch.autocast("cpu", torch.bfloat16):
        torch.testing.assert_close(orient(clouds, seen, **FOLLOW), expected)
    torch.testing.assert_close(orient(clouds.double(), seen, **FOLLOW), expected)


def test_a_turning_box_keeps_its_names():
    """Through more than a right angle; the nearest box of its own would take another name at 45 degrees."""
    step, frames = 6.0, 30
    points = turning_box(frames=frames, step=step)
    rotation = orient(points, seen_everywhere(points), **FOLLOW)
    assert_rotations(rotation)
    moves = geodesic_distance(rotation[:, 1:], rotation[:, :-1]).rad2deg()
    assert (moves - step).abs().max() < 2
    whole = geodesic_distance(rotation[:, 0], rotation[:, -1]).rad2deg()
    assert (whole - step * (frames - 1)).abs().max() < 2


def test_the_first_orientation_is_that_name_of_the_box_that_is_nearest_to_the_identity():
    clouds, truth, _ = random_boxes(20, 300, seed=3)
    first = orient(clouds[None, None], seen_everywhere(clouds[None, None]), **FOLLOW)[0, 0]
    angles = geodesic_distance(equivalents(truth), torch.eye(3).expand(20, 24, 3, 3))
    nearest = equivalents(truth)[torch.arange(20), angles.argmin(dim=1)]
    assert geodesic_distance(first, nearest).rad2deg().median() < 1


def test_the_nearest_candidate_is_the_one_at_the_least_geodesic_distance(shapes):
    """Against all names of all small boxes, measured one by one."""
    tolerance = 0.2
    clouds = gather_clouds(shapes, torch.ones(shapes.shape[:2], dtype=torch.bool))
    candidates = find_candidates(clouds, **SEARCH)
    followed = follow(
        Clouds(clouds.points[:, None], clouds.thickness[None]),
        candidates[None],
        torch.ones(1, len(shapes), dtype=torch.bool),
        tolerance=tolerance,
    )[0]
    for cloud, found, chosen in zip(shapes, candidates, followed, strict=True):
        every = torch.cat([found, torch.eye(3)[None]])
        each = volumes(cloud.expand(len(every), -1, -1), every)
        larger = each / each.min() / (1 + tolerance)
        angle = geodesic_distance(chosen, torch.eye(3))
        assert least_angle(every[larger <= 1 + THICKENED]) - 1e-3 <= angle
        assert angle <= least_angle(every[larger <= 1 - THICKENED]) + 1e-3


@pytest.mark.parametrize("tolerance", [0.0, 0.01, 0.2])
def test_boxes_are_larger_than_the_smallest_by_no_more_than_the_tolerance(shapes, tolerance):
    clip = shapes.unflatten(0, (1, 4, 5))
    rotation = orient(clip, seen_everywhere(clip), **{**FOLLOW, "tolerance": tolerance})
    ratios = volumes(shapes, rotation.flatten(0, 2)) / volumes(shapes, tightest(shapes))
    assert ratios.max() <= (1 + tolerance) * (1 + THICKENED)


def test_a_cloud_that_changes_little_is_not_turned():
    """Candidates of noise differ from frame to frame; within the tolerance the last orientation remains."""
    noise = torch.randn(1, 10, 1, 200, 3, generator=torch.Generator().manual_seed(0))
    ball = torch.nn.functional.normalize(noise[:, :1], dim=-1) + 1e-3 * noise
    rotation = orient(ball, seen_everywhere(ball), **{**FOLLOW, "tolerance": 0.05})
    torch.testing.assert_close(rotation, rotation[:, :1].expand_as(rotation))


def test_an_object_seen_in_few_points_keeps_its_orientation():
    points = turning_box(frames=6, step=10)
    valid = seen_everywhere(points)
    valid[:, 0, :, 9:] = valid[:, 3:5, :, 9:] = False
    rotation = orient(points, valid, **FOLLOW)
    torch.testing.assert_close(rotation[:, 0], torch.eye(3).expand_as(rotation[:, 0]))
    torch.testing.assert_close(rotation[:, 3], rotation[:, 2])
    torch.testing.assert_close(rotation[:, 4], rotation[:, 2])
    assert geodesic_distance(rotation[:, 5], rotation[:, 2]).min().rad2deg() > 20


def least_angle(rotations: torch.Tensor) -> torch.Tensor:
    """Smallest angle to the identity over all boxes and their equivalents."""
    named = equivalents(rotations)
    return geodesic_distance(named, torch.eye(3).expand_as(named)).min()


def turning_box(frames: int, step: float = 5.0) -> torch.Tensor:
    """Two different boxes (slots) that turn about slanted axes by `step` degrees a frame."""
    rng = np.random.default_rng(2)
    boxes = as_tensor([box_surface(rng, 200, np.array(size)) for size in ([0.04, 0.06, 0.1], [0.05, 0.05, 0.08])])
    axes = as_tensor(Rotation.random(2, rng=rng).as_matrix())[:, 0]
    angles = torch.arange(frames)[:, None, None] * math.radians(step)
    turns = rotation_from_vector(angles * axes) @ random_rotations(2, torch.Generator().manual_seed(0))
    return (boxes @ turns.mT)[None] + 0.3


def seen_everywhere(points: torch.Tensor) -> torch.Tensor:
    return torch.ones(points.shape[:-1], dtype=torch.bool)


def tightest(clouds: torch.Tensor) -> torch.Tensor:
    return minimum_volume_rotation(clouds, seen_everywhere(clouds), **SEARCH)


def volumes(clouds: torch.Tensor, rotations: torch.Tensor) -> torch.Tensor:
    inside = (clouds - clouds[:, :1]).double() @ rotations.double()
    return (inside.amax(dim=1) - inside.amin(dim=1)).prod(dim=1).float()


def error_modulo_symmetry(rotations: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Degrees."""
    named = equivalents(truth)
    return geodesic_distance(named, rotations[:, None].expand_as(named)).amin(dim=1).rad2deg()


def assert_rotations(rotations: torch.Tensor) -> None:
    torch.testing.assert_close(rotations.mT @ rotations, torch.eye(3).expand_as(rotations), atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(rotations.shape[:-2]))
