from dataclasses import replace

import pytest
import torch

from obpose.model.nerf.detail import EDGE
from obpose.model.obpose import ObPose
from obpose.scenes.priors.grids import COLOUR_LIMIT, DENSITY_LIMIT, Grids, facing, grids_of, together
from obpose.scenes.rendering import conditioning
from obpose.scenes.scene import Camera, Scene, upright
from tests.obpose.analytic_fields import BallField
from tests.obpose.scenes.small_scenes import CAMERA, some_model, some_scene

HIGH = 0.3
"""Metres above the table, out of its way."""
SIGHT = torch.tensor([-0.6, 0.0, -0.8])


def beside(x: float, y: float, z: float) -> Camera:
    """A camera at this place; where it looks is of no importance."""
    pose = torch.eye(4)
    pose[:3, 3] = torch.tensor([x, y, z])
    return replace(CAMERA, world_from_camera=pose)


def lopsided() -> tuple[ObPose, Scene]:
    """An object whose detail makes it dense in one of eight corners only, and the camera on its x side."""
    model, scene = some_model(), some_scene(objects=1, frames=1)
    detail = torch.zeros_like(scene.appearance.detail)
    detail[..., 0] = -60.0
    detail[:, 9:15, 9:15, 9:15, 0] = 60.0
    detail[:, :, :, 12:, 1] = 3.0
    center, rotation = torch.tensor([[[0.0, 0.0, HIGH]]]), torch.eye(3)[None, None]
    return model, replace(
        scene, center=center, rotation=rotation, cameras=(beside(2.0, 0.0, HIGH + 1.0),)
    ).with_appearance(detail=detail)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_grids_apart_are_single_objects(count: int):
    apart = Grids(torch.zeros(count, EDGE, EDGE, EDGE, 4), torch.ones(count)).apart()
    assert [len(each.half) for each in apart] == [1] * count


def close(one: Grids, other: Grids, by: float = 1e-3) -> bool:
    sizes = torch.allclose(one.half, other.half, atol=1e-6)
    return sizes and torch.allclose(one.values, other.values, atol=by)


def test_the_first_axis_points_to_the_camera_and_the_last_one_up():
    rotation = facing(torch.tensor([1.0, 2.0, 0.0]), torch.tensor([1.0, 5.0, 4.0]))
    torch.testing.assert_close(rotation, torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), atol=1e-6, rtol=0)
    below = facing(torch.tensor([1.0, 2.0, 0.0]), torch.tensor([1.0, 2.0, 4.0]))
    torch.testing.assert_close(below @ below.T, torch.eye(3))


def test_a_grid_is_as_large_as_its_object_and_holds_its_logits():
    model, scene = lopsided()
    grids = grids_of(model, scene, 0)
    # Lattice points of 13.3 mm, 9 to 14, are dense, and a part of the cell around them; then a point that is not.
    assert float(grids.half[0]) * (EDGE - 3) / (EDGE - 1) == pytest.approx(0.5 * 6 * 0.2 / 15, abs=0.0067)
    assert grids.values[0, 7:9, 7:9, 7:9, 0].min() == DENSITY_LIMIT
    # It wastes no room: but for a point or two on either side the object fills it.
    assert (grids.values[0, ..., 0] > 0).any(dim=2).any(dim=1).sum() >= EDGE - 3
    outer = torch.ones(EDGE, EDGE, EDGE, dtype=torch.bool)
    outer[1:-1, 1:-1, 1:-1] = False
    assert grids.values[0, ..., 0][outer].max() == -DENSITY_LIMIT
    assert (grids.values[0, 8, 8, 11:14, 1] > grids.values[0, 8, 8, 4, 1] + 1).all()
    assert grids.values[..., 1:].abs().max() <= COLOUR_LIMIT


def test_turning_all_about_the_vertical_and_moving_all_changes_nothing():
    model, scene = lopsided()
    turn, way = upright(0.7, scene.center), torch.tensor([0.3, -0.2, 0.0])
    camera = scene.cameras[0].world_from_camera[:3, 3]
    moved = replace(
        scene,
        center=scene.center @ turn.T + way,
        rotation=turn @ scene.rotation,
        cameras=(beside(*(turn @ camera + way).tolist()),),
    )
    assert close(grids_of(model, moved, 0), grids_of(model, scene, 0))


def test_turning_the_object_alone_turns_its_grid():
    model, scene = lopsided()
    before = grids_of(model, scene, 0).values[0]
    turned = replace(scene, rotation=upright(torch.pi / 2, scene.center) @ scene.rotation)
    after = grids_of(model, turned, 0).values[0]
    # x becomes y, y becomes -x.
    torch.testing.assert_close(after[..., 0], before[..., 0].flip(1).transpose(0, 1), atol=1e-3, rtol=0)


@pytest.mark.parametrize("table", [0.0, 0.2])
def test_nothing_is_dense_below_the_table(table: float):
    model = some_model(**{"model.table": table + 0.001})
    model.object_field = BallField(0.6, latent=32)
    scene = some_scene(objects=1, frames=1).with_appearance(detail=torch.zeros(1, 16, 16, 16, 4))
    scene = replace(scene, center=torch.tensor([[[0.0, 0.0, table]]]), cameras=(beside(1.0, 0.0, 1.0 + table),))
    grids = grids_of(model, scene, 0)
    height = torch.linspace(-1, 1, EDGE) * float(grids.half[0])
    # A half ball of 6 cm: its middle is 3 cm high, and the grid as wide as the ball.
    middle = 0.03
    assert (grids.values[0, :, :, height + middle < -0.007, 0] == -DENSITY_LIMIT).all()
    assert (grids.values[0, 7:9, 7:9, (height + middle > 0.01) & (height + middle < 0.05), 0] == DENSITY_LIMIT).all()


def test_objects_that_are_nowhere_are_left_out():
    model, scene = some_model(), some_scene(objects=3, frames=1)
    model.object_field = BallField(0.5, latent=32)
    high = scene.center.clone()
    high[0, :, 2] = torch.tensor([0.3, -0.3, 0.3])
    assert len(grids_of(model, replace(scene, center=high), 0).half) == 2
    model.object_field = BallField(-10.0, latent=32)
    assert grids_of(model, scene, 0).values.shape == (0, EDGE, EDGE, EDGE, 4)


def test_a_grid_alone_is_the_object_that_it_is_of():
    """Its logits at the grid's points, whatever the code; here the box's middle is the grid's."""
    model, what = some_model(), torch.randn(32, generator=torch.Generator().manual_seed(0))
    model.object_field = BallField(0.6, latent=32)
    scene = some_scene(objects=1, frames=1).with_appearance(detail=torch.zeros(1, 16, 16, 16, 4))
    scene = replace(scene, center=torch.tensor([[[0.0, 0.0, HIGH]]]), cameras=(beside(1.0, 0.0, 1.0),))
    grids = grids_of(model, scene, 0)
    steps = torch.linspace(-1, 1, EDGE) * float(grids.half[0]) / 0.1
    points = torch.cartesian_prod(steps, steps, steps)
    before = some_model()
    codes = conditioning(before, what, grids.values[0], grids.half[0] / 0.1)
    with torch.no_grad():
        density, hidden = before.object_field.density(points, codes)
        colour = before.object_field.colour(hidden, SIGHT.expand_as(points), codes)
    found = torch.cat([density[:, None], torch.logit(colour)], dim=-1).view(EDGE, EDGE, EDGE, 4)
    torch.testing.assert_close(found, grids.values[0], atol=1e-4, rtol=0)
    inside = points.norm(dim=-1) < 0.6 - 0.1
    assert (density[inside] == DENSITY_LIMIT).all()


def test_grids_are_taken_apart_and_put_together():
    grids = Grids(torch.randn(3, EDGE, EDGE, EDGE, 4), torch.rand(3))
    some = together([grids.apart()[2], grids.take(torch.tensor([0, 1]))], like=grids.half)
    assert torch.equal(some.values, grids.values[[2, 0, 1]])
    assert torch.equal(some.half, grids.half[[2, 0, 1]])
    assert together([], like=grids.half).values.shape == (0, EDGE, EDGE, EDGE, 4)
