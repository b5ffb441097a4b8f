import math
from dataclasses import dataclass, fields, replace

import pytest
import torch
from einops import rearrange

from obpose.config import FieldConfig
from obpose.geometry import to_box
from obpose.model.nerf.components import Background, Codes, Colours, Fields, decode, decode_background
from obpose.model.nerf.compose import OUTSIDE, log_density
from obpose.model.nerf.field import Field
from obpose.types import Boxes, Decoded
from tests.obpose.analytic_fields import SMALL, random_boxes

BATCH, FRAMES, SLOTS, RAYS = 2, 2, 3, 400
MIDDLE = torch.tensor([0.1, 0.0, 0.0])


@dataclass(frozen=True)
class World:
    """Fields, boxes and codes, and points in and around the boxes."""

    object_field: Field
    background_field: Field
    boxes: Boxes
    active: torch.Tensor
    z_what: torch.Tensor
    z_background: torch.Tensor
    points: torch.Tensor
    directions: torch.Tensor

    def fields(self, floor: float | None = None) -> Fields:
        return Fields(self.object_field, self.background_field, MIDDLE, 1.0, floor)

    def decode(
        self, colours: Colours = "with", where_background: Background = "everywhere", floor: float | None = None
    ) -> Decoded:
        codes = Codes(self.active, self.z_what, self.z_background, self.boxes)
        options = {"colours": colours, "where_background": where_background}
        return decode(self.fields(floor), codes, self.points, self.directions, **options)

    def scene(self, place: int) -> "World":
        one = slice(place, place + 1)
        boxes = Boxes(self.boxes.center[one], self.boxes.rotation[one], self.boxes.size)
        tensors = {field.name: getattr(self, field.name)[one] for field in fields(self)[3:]}
        return replace(self, boxes=boxes, **tensors)

    def inside(self) -> torch.Tensor:
        in_box = to_box(self.points[:, :, None], self.boxes.center, self.boxes.rotation, self.boxes.size)
        return (in_box.abs().amax(dim=-1) <= 1) & self.active[:, None, :, None]


@pytest.fixture
def world() -> World:
    torch.manual_seed(0)
    return World(
        object_field=Field(SMALL, 4),
        background_field=Field(SMALL, 5),
        boxes=random_boxes(BATCH, FRAMES, SLOTS),
        active=torch.tensor([[True, True, True], [True, False, True]]),
        z_what=torch.randn(BATCH, FRAMES, SLOTS, 4),
        z_background=torch.randn(BATCH, FRAMES, 5),
        points=0.1 * torch.randn(BATCH, FRAMES, RAYS, 3),
        directions=torch.randn(BATCH, FRAMES, RAYS, 3),
    )


def test_evaluation_in_boxes_alone_is_dense_evaluation_masked(world: World):
    in_box = to_box(world.points[:, :, None], world.boxes.center, world.boxes.rotation, world.boxes.size)
    unit = world.directions / world.directions.norm(dim=-1, keepdim=True)
    turned = torch.einsum("bfsji,bfrj->bfsri", world.boxes.rotation, unit)
    codes = world.object_field.condition(world.z_what).of_all_points()
    logits, hidden = world.object_field.density(in_box, codes)
    colours = world.object_field.colour(hidden, turned, codes)
    inside, decoded = world.inside(), world.decode()
    assert 0.05 < inside.float().mean() < 0.8
    torch.testing.assert_close(decoded.logits[:, :, 1:], torch.where(inside, logits, OUTSIDE))
    assert decoded.colours is not None
    torch.testing.assert_close(decoded.colours[:, :, 1:], torch.where(inside[..., None], colours, 0.0))


def test_objects_end_at_the_floor_and_the_background_does_not(world: World):
    free, standing = world.decode(), world.decode(floor=0.02)
    above = (world.points[..., 2] > 0.02)[:, :, None]
    assert 0.1 < above.float().mean() < 0.9
    torch.testing.assert_close(standing.logits[:, :, :1], free.logits[:, :, :1])
    torch.testing.assert_close(standing.logits[:, :, 1:], torch.where(above, free.logits[:, :, 1:], OUTSIDE))


def test_the_background_is_evaluated_everywhere_in_workspace_coordinates(world: World):
    unit = world.directions / world.directions.norm(dim=-1, keepdim=True)
    field, codes = world.background_field, world.background_field.condition(world.z_background).of_all_points()
    logits, hidden = field.density(2 * (world.points - MIDDLE), codes)
    decoded = world.decode()
    torch.testing.assert_close(decoded.logits[:, :, 0], logits)
    assert decoded.colours is not None
    torch.testing.assert_close(decoded.colours[:, :, 0], field.colour(hidden, unit, codes))


@pytest.mark.parametrize("colours", ["with", "without"])
def test_where_only_order_counts_the_background_is_left_out_outside_the_boxes(world: World, colours: Colours):
    whole, culled = world.decode(colours), world.decode(colours, where_background="in boxes")
    contested = world.inside().any(dim=2)
    torch.testing.assert_close(culled.logits[:, :, 0], torch.where(contested, whole.logits[:, :, 0], 0.0))
    torch.testing.assert_close(culled.logits[:, :, 1:], whole.logits[:, :, 1:])
    assert (culled.colours is None) == (colours == "without")
    if culled.colours is not None and whole.colours is not None:
        expected = torch.where(contested[..., None], whole.colours[:, :, 0], 0.0)
        torch.testing.assert_close(culled.colours[:, :, 0], expected)


def test_the_background_alone_is_the_first_component(world: World):
    alone = decode_background(world.fields(), world.z_background, world.points, world.directions, colours="with")
    together = world.decode()
    assert alone.colours is not None
    assert together.colours is not None
    torch.testing.assert_close(alone.logits, together.logits[:, :, :1])
    torch.testing.assert_close(alone.colours, together.colours[:, :, :1])


def test_idle_slots_are_outside(world: World):
    decoded = world.decode()
    assert (decoded.logits[1, :, 2] == OUTSIDE).all()
    assert (decoded.logits[0, :, 2] != OUTSIDE).any()
    nothing = replace(world, active=torch.zeros_like(world.active)).decode()
    assert (nothing.logits[:, :, 1:] == OUTSIDE).all()


def test_without_colours_the_densities_are_the_same(world: World):
    without = world.decode("without")
    assert without.colours is None
    torch.testing.assert_close(without.logits, world.decode().logits)


def test_an_object_looks_the_same_wherever_its_box_is(world: World):
    turn, shift = random_boxes(1, 1, 1, seed=5).rotation[0, 0, 0], torch.tensor([0.3, -1.0, 0.2])
    moved = replace(world.boxes, center=world.boxes.center @ turn.T + shift, rotation=turn @ world.boxes.rotation)
    there = replace(
        world,
        boxes=moved,
        points=world.points @ turn.T + shift,
        directions=3 * world.directions @ turn.T,
    ).decode()
    here = world.decode()
    same = (here.logits[:, :, 1:] == OUTSIDE) == (there.logits[:, :, 1:] == OUTSIDE)
    assert same.float().mean() > 0.999
    torch.testing.assert_close(
        torch.where(same, here.logits[:, :, 1:], 0), torch.where(same, there.logits[:, :, 1:], 0), atol=1e-4, rtol=1e-3
    )


def test_each_code_hears_of_its_own_points_alone(world: World):
    z_what = world.z_what.requires_grad_()
    decoded = world.decode("without")
    (gradient,) = torch.autograd.grad(decoded.logits[0, 1, 2].sum(), z_what)
    heard = rearrange(gradient.abs().sum(dim=-1) > 0, "b f s -> (b f s)").nonzero()[:, 0].tolist()
    assert heard == [1 * SLOTS + 1]


SQUASHED = FieldConfig(width=16, depth=4, position_frequencies=2, direction_frequencies=1, density="squashed")


def unposed(
    config: FieldConfig = SMALL,
    *,
    background: bool = True,
    active: bool = True,
    colours: Colours = "with",
    floor: float | None = None,
    bias: float = 0.0,
) -> tuple[Decoded, Fields, Codes, torch.Tensor, torch.Tensor]:
    """Decode objects without boxes; also give fields, codes, points and directions."""
    torch.manual_seed(0)
    field, other = Field(config, 4), Field(config, 5) if background else None
    for each in (field, other):
        if each is not None:
            torch.nn.init.constant_(each.density_logit.bias, bias)
    world = Fields(field, other, MIDDLE, 2.0, floor)
    z_background = torch.randn(BATCH, FRAMES, 5) if background else None
    codes = Codes(torch.full((BATCH, 4), active), torch.randn(BATCH, FRAMES, 4, 4), z_background, None)
    points, directions = torch.randn(BATCH, FRAMES, 50, 3), torch.randn(BATCH, FRAMES, 50, 3)
    return decode(world, codes, points, directions, colours=colours), world, codes, points, directions


def test_without_boxes_every_slot_is_evaluated_at_every_point_as_a_background_would_be():
    found, world, codes, points, directions = unposed()
    assert found.colours is not None
    for slot in range(4):
        as_background = replace(world, background=world.objects)
        alone = decode_background(as_background, codes.what[:, :, slot], points, directions, colours="with")
        assert alone.colours is not None
        torch.testing.assert_close(found.logits[:, :, 1 + slot], alone.logits[:, :, 0])
        torch.testing.assert_close(found.colours[:, :, 1 + slot], alone.colours[:, :, 0])


def test_without_a_background_its_component_is_nowhere():
    found, *_ = unposed(background=False)
    assert (found.logits[:, :, 0] == OUTSIDE).all()
    torch.testing.assert_close(log_density(found.logits), log_density(found.logits[:, :, 1:]))
    assert found.colours is not None
    assert found.colours.shape == (BATCH, FRAMES, 5, 50, 3)
    assert unposed(background=False, colours="without")[0].colours is None


def test_without_boxes_inactive_slots_are_nowhere_and_objects_end_at_the_floor():
    assert (unposed(active=False)[0].logits[:, :, 1:] == OUTSIDE).all()
    found, _, _, points, _ = unposed(floor=0.2)
    below = (points[..., 2] <= 0.2)[:, :, None].expand(-1, -1, 4, -1)
    assert torch.equal(found.logits[:, :, 1:] == OUTSIDE, below)
    assert (found.logits[:, :, 0] != OUTSIDE).all()


@pytest.mark.parametrize(("config", "least"), [(SMALL, 0.0), (SQUASHED, math.tanh(5 * math.log(2)))])
def test_only_raw_densities_can_be_empty(config: FieldConfig, least: float):
    """However low the logits: five squashed components have a density of .998."""
    density = log_density(unposed(config, bias=-50.0)[0].logits).exp()
    torch.testing.assert_close(density, torch.full_like(density, least), atol=1e-5, rtol=0)
