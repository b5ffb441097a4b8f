from typing import Any

import pytest
import torch

from obpose.geometry import camera_rays
from obpose.model.nerf.components import Codes, Fields, decode
from obpose.model.nerf.field import Conditioning, Field, Hidden
from obpose.model.nerf.marching import Component, Picture, make_component, march, moved, thickness_towards
from obpose.model.nerf.render import Rendering, render
from obpose.types import Boxes
from tests.obpose.analytic_fields import SMALL, BallField, empty_field

WORLD = {"center": torch.tensor([0.0, 0.1, 0.0]), "rotation": torch.eye(3), "size": 2.0}
BOX = {"center": torch.tensor([0.1, 0.0, 0.05]), "rotation": torch.eye(3), "size": 0.3}
NEAR, FAR, SAMPLES, SIGMA = 0.4, 1.6, 100, 60.0


def rays(pixels: int = 12) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays of a camera one metre above the origin that looks down."""
    k = torch.tensor([[1.5 * pixels, 0, pixels / 2], [0, 1.5 * pixels, pixels / 2], [0, 0, 1]])
    pose = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
    pose[2, 3] = 1.0
    direction, origin = camera_rays(k, pose, pixels, pixels)
    return origin.expand_as(direction).flatten(0, 1), direction.flatten(0, 1)


def objects(count: int, seed: int = 0) -> tuple[torch.Tensor, Boxes]:
    generator = torch.Generator().manual_seed(seed)
    center = 0.3 * torch.rand(count, 3, generator=generator) - 0.15
    rotation = torch.linalg.qr(torch.randn(count, 3, 3, generator=generator))[0]
    rotation = rotation * torch.linalg.det(rotation)[:, None, None]
    return torch.randn(count, 2, generator=generator), Boxes(center[None, None], rotation[None, None], 0.3)


def of_code(field: Field, code: torch.Tensor, **options: Any) -> Component:
    return make_component(field, field.condition(code), **options)


def both(
    object_field: Field, background_field: Field, *, floor: float | None, threshold: float = 0.0
) -> tuple[Picture, Rendering]:
    """The scene marched, and rendered densely."""
    codes, boxes = objects(3)
    background_code = torch.tensor([0.5, -1.0])
    components = [
        of_code(background_field, background_code, **WORLD, bounded=False, resolution=24, threshold=threshold)
    ]
    for place in range(3):
        box = {"center": boxes.center[0, 0, place], "rotation": boxes.rotation[0, 0, place], "size": boxes.size}
        components.append(of_code(object_field, codes[place], **box, bounded=True, resolution=24, threshold=threshold))
    origin, direction = rays()
    along = {"near": NEAR, "far": FAR, "samples": SAMPLES, "sigma_max": SIGMA, "threshold": threshold}
    fast = march(components, origin, direction, **along, floor=floor)

    def everywhere(points: torch.Tensor, directions: torch.Tensor):
        fields = Fields(object_field, background_field, WORLD["center"], WORLD["size"], floor)
        active = torch.ones(1, 3, dtype=torch.bool)
        scene = Codes(active, codes[None, None], background_code[None, None], boxes)
        return decode(fields, scene, points, directions, colours="with")

    dense = render(everywhere, origin[None, None], direction[None, None], **along)
    return fast, dense


@pytest.mark.parametrize(("floor", "threshold"), [(None, 0.0), (0.02, 0.0), (None, 0.6)])
def test_the_picture_is_that_of_dense_rendering(floor: float | None, threshold: float):
    torch.manual_seed(0)
    with torch.no_grad():
        fast, dense = both(Field(SMALL, 2), Field(SMALL, 2), floor=floor, threshold=threshold)
    assert dense.weights[0, 0].sum(dim=0).max() > 0.2
    # Rays stop where less than a thousandth of the light gets through.
    torch.testing.assert_close(fast.colour, dense.colour[0, 0], atol=2e-3, rtol=0)
    torch.testing.assert_close(fast.depth, dense.depth[0, 0], atol=2e-3, rtol=0)
    torch.testing.assert_close(fast.weights, dense.weights[0, 0], atol=2e-3, rtol=0)


def test_so_it_is_where_most_of_the_world_is_empty():
    fast, dense = both(BallField(0.6), BallField(0.2), floor=None)
    assert 0.02 < float((fast.weights[1:].sum(dim=0) > 0.5).float().mean()) < 0.9
    torch.testing.assert_close(fast.colour, dense.colour[0, 0], atol=2e-3, rtol=0)
    torch.testing.assert_close(fast.weights, dense.weights[0, 0], atol=2e-3, rtol=0)


def test_colours_can_be_those_a_little_behind():
    """A field that is black in the half of its box that the camera sees, and white below."""

    class TwoColours(BallField):
        def density(self, points: torch.Tensor, codes) -> tuple[torch.Tensor, torch.Tensor]:
            return torch.full_like(points[:, 0], 9.0), points

        def colour(self, hidden: torch.Tensor, direction: torch.Tensor, codes) -> torch.Tensor:
            return (hidden[:, 2:] < 0).float().expand(-1, 3)

    box = {"center": torch.zeros(3), "rotation": torch.eye(3), "size": 0.3}
    component = of_code(TwoColours(0.5), torch.zeros(2), **box, bounded=True, resolution=8)
    down = torch.tensor([[0.0, 0.0, -1.0]])
    along = {"near": NEAR, "far": FAR, "samples": 1200, "sigma_max": 1000.0, "floor": None}
    seen = [
        march([component], torch.tensor([[0.0, 0.0, 1.0]]), down, **along, behind=behind).colour.mean().item()
        for behind in (0.0, 0.14, 0.16)
    ]
    assert seen == [pytest.approx(0.0, abs=5e-3), pytest.approx(0.0, abs=5e-3), pytest.approx(1.0, abs=5e-3)]


def test_fields_are_evaluated_in_few_places():
    class Counting(BallField):
        evaluated = 0

        def density(self, points: torch.Tensor, codes) -> tuple[torch.Tensor, torch.Tensor]:
            self.evaluated += len(points)
            return super().density(points, codes)

    field = Counting(0.3)
    component = of_code(field, torch.zeros(2), **BOX, bounded=True, resolution=16)
    field.evaluated = 0
    origin, direction = rays()
    march([component], origin, direction, near=NEAR, far=FAR, samples=SAMPLES, sigma_max=SIGMA, floor=None)
    assert 0 < field.evaluated < 0.01 * len(origin) * SAMPLES


def test_a_sheet_that_is_thinner_than_a_cell_is_there_where_cells_are_asked_at_enough_heights():
    """It lies on the border of two."""

    class Sheet(BallField):
        def density(self, points: torch.Tensor, codes: Conditioning) -> tuple[torch.Tensor, Hidden]:
            _, hidden = super().density(points, codes)
            return torch.where((points[..., 2] - 0.25).abs() < 0.03, 20.0, -20.0), hidden

    box = {"center": torch.zeros(3), "rotation": torch.eye(3), "size": 2.0}
    along = {"near": NEAR, "far": FAR, "samples": 400, "sigma_max": 400.0, "floor": None}
    opacity = []
    for layers in (1, 2, 8):
        sheet = of_code(Sheet(1.0), torch.zeros(2), **box, bounded=True, resolution=8, layers=layers)
        opacity.append(march([sheet], *rays(), **along).weights)
    assert not opacity[0].any()
    assert not opacity[1].any()
    assert (opacity[2] > 0.99).all()


def test_nothing_is_black_and_as_far_as_can_be_seen():
    component = of_code(empty_field(), torch.zeros(2), **BOX, bounded=True, resolution=8)
    assert not component.cells.any()
    origin, direction = rays()
    seen = march([component], origin, direction, near=NEAR, far=FAR, samples=10, sigma_max=SIGMA, floor=None)
    assert (seen.colour == 0).all()
    assert (seen.weights == 0).all()
    torch.testing.assert_close(seen.depth, torch.full_like(seen.depth, FAR))


@pytest.mark.parametrize(
    ("beside", "before", "expected"),
    [(0.0, 0.5, 0.24), (0.06, 0.5, 0.208), (0.13, 0.5, 0.0), (0.0, 0.0, 0.12), (0.0, -0.5, 0.0)],
)
def test_a_ball_is_as_thick_as_the_way_through_it_is_long(beside: float, before: float, expected: float):
    ball = of_code(BallField(0.8), torch.zeros(2), **BOX, bounded=True, resolution=16)
    toward = torch.tensor([0.0, 0.6, 0.8])
    origin = BOX["center"] + beside * torch.tensor([1.0, 0.0, 0.0]) - before * toward
    along = {"step": 0.002, "sigma_max": 10.0, "floor": None, "threshold": 0.5}
    apart = BOX["center"] + torch.tensor([9.0, 0.0, 0.0])
    found = thickness_towards([ball], torch.stack([apart, origin]), toward, **along)
    assert found.tolist() == [0.0, pytest.approx(10 * expected, abs=0.05)]


def test_nothing_is_thick_below_the_floor_and_two_balls_are_thicker_than_one():
    ball = of_code(BallField(0.8), torch.zeros(2), **BOX, bounded=True, resolution=16)
    other = moved(ball, BOX["center"] + torch.tensor([0.0, 0.0, 0.5]), torch.eye(3))
    up, start = torch.tensor([0.0, 0.0, 1.0]), BOX["center"][None] - torch.tensor([0.0, 0.0, 0.5])
    along = {"step": 0.002, "sigma_max": 10.0, "threshold": 0.5}
    middle = float(BOX["center"][2])
    thick = [
        thickness_towards(balls, start, up, **along, floor=floor).item()
        for balls, floor in (([ball], None), ([ball], middle), ([ball, other], middle), ([ball], 1.0), ([], None))
    ]
    assert thick == [pytest.approx(value, abs=0.05) for value in (2.4, 1.2, 3.6, 0.0, 0.0)]


def test_a_component_that_is_moved_is_as_if_it_had_been_made_there():
    made = of_code(BallField(0.5), torch.zeros(2), **BOX, bounded=True, resolution=16)
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    there = moved(made, torch.tensor([-0.1, 0.1, 0.0]), turn)
    anew = of_code(
        BallField(0.5), torch.zeros(2), center=there.center, rotation=turn, size=0.3, bounded=True, resolution=16
    )
    torch.testing.assert_close(seen_of(there).colour, seen_of(anew).colour)
    assert not torch.equal(seen_of(there).colour, seen_of(made).colour)


def seen_of(component: Component) -> Picture:
    along = {"near": NEAR, "far": FAR, "samples": SAMPLES, "sigma_max": SIGMA}
    return march([component], *rays(), **along, floor=None)
