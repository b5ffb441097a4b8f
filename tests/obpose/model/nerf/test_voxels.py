from dataclasses import replace

import pytest
import torch

from obpose.geometry import from_box, to_box
from obpose.model.nerf.components import Codes, Fields, decode
from obpose.model.nerf.field import Field
from obpose.model.nerf.render import render
from obpose.model.nerf.voxels import (
    Voxels,
    estimate_shape,
    lattice_points,
    observed_free,
    occupancy,
    occupied_voxels,
    shape_of,
)
from obpose.types import Boxes, Observation
from tests.obpose.analytic_fields import BallField, ball_on_table, blind, empty_field, random_boxes, upright_box

ONE = torch.ones(1, 1, dtype=torch.bool)
CODE = torch.zeros(1, 1, 1, 2)
OPTIONS = {"resolution": 12, "threshold": 0.5, "table": -9.0}


def world_points(*points: tuple[float, float, float]) -> torch.Tensor:
    return torch.tensor(points).view(1, 1, 1, -1, 3)


def seen_points(observation: Observation, pixels: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
    """World points at planar depths along pixels (column, row)."""
    k, pose = observation.k[0, 0], observation.world_from_camera[0, 0]
    in_camera = torch.cat([(pixels - k[:2, 2]) / k.diagonal()[:2], torch.ones(len(pixels), 1)], dim=-1)
    return ((in_camera * depth[:, None]) @ pose[:3, :3].T + pose[:3, 3]).view(1, 1, 1, -1, 3)


def test_occupancy_is_the_papers_formula():
    logits = torch.linspace(-10, 10, 101)
    torch.testing.assert_close(occupancy(logits), torch.tanh(torch.nn.functional.softplus(logits)))


@pytest.mark.parametrize(
    ("logit", "threshold", "occupied"), [(-0.33, 0.5, False), (-0.30, 0.5, True), (-0.30, 0.6, False)]
)
def test_voxels_are_occupied_above_the_threshold(logit: float, threshold: float, occupied: bool):
    field = BallField(logit / 400)
    middle = {**OPTIONS, "resolution": 1, "threshold": threshold}
    voxels = occupied_voxels(field, random_boxes(1, 1, 1), ONE, CODE, blind(), **middle)
    assert voxels.occupied.all() == occupied


def test_a_point_is_in_the_middle_of_each_cell_or_anywhere_in_it():
    centers = lattice_points(4, None, torch.zeros(1))
    assert centers.unique(dim=0).shape == (64, 3)
    assert centers[:, 0].unique().tolist() == [-0.75, -0.25, 0.25, 0.75]
    offsets = lattice_points(4, torch.Generator().manual_seed(0), torch.zeros(1)) - centers
    assert offsets.abs().max() <= 0.25
    assert offsets.abs().max() > 0.23
    assert offsets.std(dim=0).min() > 0.1


def test_voxels_of_a_ball_are_those_in_it():
    boxes = random_boxes(1, 1, 1)
    voxels = occupied_voxels(BallField(0.6), boxes, ONE, CODE, blind(), **OPTIONS)
    radius = to_box(voxels.points, boxes.center, boxes.rotation, boxes.size).norm(dim=-1)
    assert voxels.occupied.equal(radius < 0.6 + 0.313 / 400)
    assert (
        estimate_shape(BallField(0.6), boxes, ONE, CODE, blind(), **OPTIONS)
        .center[0, 0, 0]
        .allclose(boxes.center[0, 0, 0], atol=1e-3)
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_voxels_agree_with_volume_rendering(axis: int):
    boxes, cell = random_boxes(1, 1, 1, seed=3), 0.2 / 12
    field = BallField(0.55, middle=(0.4, -0.2, 0.1))
    voxels = occupied_voxels(field, boxes, ONE, CODE, blind(), **OPTIONS).occupied[0, 0, 0].view(12, 12, 12)
    first = (
        lattice_points(12, None, torch.zeros(1)).view(12, 12, 12, 3).select(axis, 0).reshape(1, 1, 1, 144, 3).clone()
    )
    first[..., axis] = -1
    origin = from_box(first, boxes.center, boxes.rotation, boxes.size)[:, :, 0]
    direction = boxes.rotation[..., 0, :, axis][:, :, None].expand_as(origin)
    rendering = render(
        lambda points, directions: decode(
            Fields(field, empty_field(), torch.zeros(3), 1.0, None),
            Codes(ONE, CODE, CODE[:, :, 0], boxes),
            points,
            directions,
            colours="with",
        ),
        origin,
        direction.contiguous(),
        near=0.0,
        far=0.2,
        samples=96,
        sigma_max=2000.0,
    )
    solid = rendering.weights[0, 0, 1].view(12, 12) > 0.5
    silhouette = voxels.any(dim=axis)
    assert (solid & silhouette).sum() / (solid | silhouette).sum() > 0.95
    both = solid & silhouette
    depth_of_voxels = (voxels.int().argmax(dim=axis) + 0.5)[both] * cell
    assert (rendering.depth[0, 0].view(12, 12)[both] - depth_of_voxels).abs().max() < cell
    middle = torch.stack(torch.meshgrid(*[torch.arange(12.0)] * 2, indexing="ij"))
    assert (middle[:, solid].mean(dim=1) - middle[:, silhouette].mean(dim=1)).norm() * cell < 0.002


@pytest.mark.parametrize("jitter", [None, 0])
def test_the_shape_of_a_half_observed_ball_is_centred_on_the_ball(jitter: int | None):
    middle, radius = (0.02, 0.01, 0.06), 0.05
    observation = ball_on_table(middle, radius)
    boxes = upright_box(middle)
    points = seen_points(observation, _pixels(64), observation.depth.flatten())[0, 0, 0]
    on_ball = points[(points - torch.tensor(middle)).norm(dim=-1) < radius + 1e-3]
    generator = None if jitter is None else torch.Generator().manual_seed(jitter)
    shape = estimate_shape(BallField(0.5), boxes, ONE, CODE, observation, resolution=24, generator=generator)
    assert shape.found.all()
    assert (on_ball.mean(dim=0) - torch.tensor(middle)).norm() > 0.02
    assert (shape.center[0, 0, 0] - torch.tensor(middle)).norm() < 0.004


@pytest.mark.parametrize("table", [0.0, 0.03])
def test_what_was_seen_through_or_is_under_the_table_is_empty_whatever_the_field_says(table: float):
    middle, radius = torch.tensor([0.02, 0.01, 0.06]), 0.05
    observation = ball_on_table((0.02, 0.01, 0.06), radius)
    boxes = upright_box((0.02, 0.01, 0.06), size=0.15)
    voxels = occupied_voxels(BallField(9.0), boxes, ONE, CODE, observation, resolution=16, table=table)
    points, occupied = voxels.points[0, 0, 0], voxels.occupied[0, 0, 0]
    eye = observation.world_from_camera[0, 0, :3, 3]
    nearest = _distance_to_segment(middle, eye, points)
    free = (points[:, 2] > 0.004) & (nearest > radius + 0.004)
    solid = ((points - middle).norm(dim=-1) < radius - 0.008) & (points[:, 2] > table)
    assert free.sum() > 200
    assert solid.sum() > 50
    assert not occupied[free].any()
    assert not occupied[points[:, 2] < table - 0.002].any()
    assert occupied[solid].all()


def test_free_space_is_where_a_camera_saw_farther():
    observation = ball_on_table((0.0, 0.0, 0.06), 0.05)
    pixels = torch.tensor([[31.3, 31.6], [5.2, 60.8]])
    depth = observation.depth[0, 0, 0, pixels[:, 1].long(), pixels[:, 0].long()]

    def free(shift: float) -> list[bool]:
        return observed_free(seen_points(observation, pixels, depth + shift), observation).flatten().tolist()

    assert free(-0.01) == [True, True]
    assert free(0.01) == [False, False]
    blind_there = replace(observation, valid=torch.zeros_like(observation.valid))
    assert not observed_free(seen_points(observation, pixels, depth - 0.1), blind_there).any()


def test_nothing_is_known_outside_the_image_and_behind_the_camera():
    observation = ball_on_table((0.0, 0.0, 0.06), 0.05)
    beside = torch.tensor([[-0.2, 30.0], [64.2, 30.0], [30.0, -0.2], [30.0, 64.2]])
    assert not observed_free(seen_points(observation, beside, torch.full((4,), 0.1)), observation).any()
    behind = seen_points(observation, torch.tensor([[32.0, 32.0], [-3e-4, -3e-4]]), torch.tensor([-0.1, -0.1]))
    assert not observed_free(behind, observation).any()


def test_one_camera_that_sees_through_is_enough():
    observation = ball_on_table((0.0, 0.0, 0.06), 0.05)
    other = blind()
    both = Observation(
        observation.rgb.repeat(1, 1, 2, 1, 1, 1),
        torch.cat([torch.zeros_like(observation.depth), observation.depth], dim=2),
        torch.cat([torch.zeros_like(observation.valid), observation.valid], dim=2),
        torch.cat([other.k, observation.k], dim=1),
        torch.cat([other.world_from_camera, observation.world_from_camera], dim=1),
    )
    points = from_box(lattice_points(8, None, torch.zeros(1)), *_placed(upright_box((0.0, 0.0, 0.06))))
    assert observed_free(points, both).equal(observed_free(points, observation))


def test_idle_slots_and_empty_fields_have_no_shape():
    boxes = random_boxes(1, 2, 3)
    active = torch.tensor([[True, False, True]])
    codes = torch.zeros(1, 2, 3, 2)
    shape = estimate_shape(BallField(0.6), boxes, active, codes, blind(frames=2), **OPTIONS)
    assert shape.found.all(dim=1).tolist() == [[True, False, True]]
    nothing = estimate_shape(empty_field(), boxes, active, codes, blind(frames=2), **OPTIONS)
    assert not nothing.found.any()
    assert nothing.center.isfinite().all()


def test_one_frame_of_each_clip_is_found_as_if_all_were_looked_at():
    boxes, active = random_boxes(2, 3, 2), torch.ones(2, 2, dtype=torch.bool)
    codes = torch.randn(2, 3, 2, 5, generator=torch.Generator().manual_seed(0))
    torch.manual_seed(0)
    field, observation = Field(BallField(0.6).config, 5), blind(2, 3)
    everything = estimate_shape(field, boxes, active, codes, observation, **OPTIONS)
    frame = torch.tensor([2, 0])
    some = estimate_shape(field, boxes, active, codes, observation, frame=frame, **OPTIONS)
    expected = torch.zeros(2, 3, 2, dtype=torch.bool)
    expected[0, 2] = expected[1, 0] = True
    assert some.found.equal(expected)
    torch.testing.assert_close(some.center[expected], everything.center[expected])


def test_the_centre_does_not_depend_on_where_voxels_are_dense():
    points = torch.rand(1, 1, 1, 50, 3, generator=torch.Generator().manual_seed(0))
    corners = world_points((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    crowded = torch.cat([corners, 0.1 * points], dim=-2)
    shape = shape_of(Voxels(crowded, torch.ones(crowded.shape[:-1], dtype=torch.bool)))
    torch.testing.assert_close(shape.center[0, 0, 0], torch.full((3,), 0.5))


def _pixels(size: int) -> torch.Tensor:
    rows, columns = torch.meshgrid(*[torch.arange(size) + 0.5] * 2, indexing="ij")
    return torch.stack([columns.flatten(), rows.flatten()], dim=-1)


def _placed(boxes: Boxes) -> tuple[torch.Tensor, torch.Tensor, float]:
    return boxes.center, boxes.rotation, boxes.size


def _distance_to_segment(center: torch.Tensor, start: torch.Tensor, ends: torch.Tensor) -> torch.Tensor:
    along = ends - start
    share = (((center - start) * along).sum(dim=-1) / along.square().sum(dim=-1)).clamp(0, 1)
    return (start + share[:, None] * along - center).norm(dim=-1)
