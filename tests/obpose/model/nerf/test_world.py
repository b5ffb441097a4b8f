import math

import pytest
import torch

from obpose.config import FieldConfig
from obpose.model.nerf.components import Colours, decode_background
from obpose.model.nerf.compose import OUTSIDE, log_density
from obpose.model.nerf.field import Field
from obpose.model.nerf.world import decode_world
from obpose.types import Decoded
from tests.obpose.analytic_fields import SMALL

BATCH, FRAMES, SLOTS, RAYS = 2, 2, 4, 50
MIDDLE = torch.tensor([0.1, 0.0, 0.0])
SQUASHED = FieldConfig(width=16, depth=4, position_frequencies=2, direction_frequencies=1, density="squashed")


def decoded(
    config: FieldConfig = SMALL,
    *,
    background: bool = True,
    active: bool = True,
    colours: Colours = "with",
    floor: float | None = None,
    bias: float = 0.0,
) -> tuple[Decoded, Field, torch.Tensor, torch.Tensor, torch.Tensor]:
    """With the objects' field, their codes, the points and the directions."""
    torch.manual_seed(0)
    field, other = Field(config, 4), Field(config, 5) if background else None
    for each in (field, other):
        if each is not None:
            torch.nn.init.constant_(each.density_logit.bias, bias)
    codes, points, directions = (
        torch.randn(BATCH, FRAMES, SLOTS, 4),
        torch.randn(2, 2, RAYS, 3),
        torch.randn(2, 2, RAYS, 3),
    )
    z_background = torch.randn(BATCH, FRAMES, 5) if background else None
    use = torch.full((BATCH, SLOTS), active)
    options = {"workspace_center": MIDDLE, "workspace_size": 2.0, "colours": colours, "floor": floor}
    found = decode_world(field, other, use, codes, z_background, points, directions, **options)
    return found, field, codes, points, directions


def test_every_slot_is_evaluated_at_every_point_as_a_background_would_be():
    found, field, codes, points, directions = decoded()
    options = {"workspace_center": MIDDLE, "workspace_size": 2.0, "colours": "with"}
    assert found.colours is not None
    for slot in range(SLOTS):
        alone = decode_background(field, codes[:, :, slot], points, directions, **options)
        assert alone.colours is not None
        torch.testing.assert_close(found.logits[:, :, 1 + slot], alone.logits[:, :, 0])
        torch.testing.assert_close(found.colours[:, :, 1 + slot], alone.colours[:, :, 0])


def test_without_a_background_its_component_is_nowhere():
    found, *_ = decoded(background=False)
    assert (found.logits[:, :, 0] == OUTSIDE).all()
    torch.testing.assert_close(log_density(found.logits), log_density(found.logits[:, :, 1:]))
    assert found.colours is not None
    assert found.colours.shape == (BATCH, FRAMES, 1 + SLOTS, RAYS, 3)
    assert decoded(background=False, colours="without")[0].colours is None


def test_idle_slots_are_nowhere_and_objects_end_at_the_floor():
    assert (decoded(active=False)[0].logits[:, :, 1:] == OUTSIDE).all()
    found, _, _, points, _ = decoded(floor=0.2)
    below = (points[..., 2] <= 0.2)[:, :, None].expand(-1, -1, SLOTS, -1)
    assert torch.equal(found.logits[:, :, 1:] == OUTSIDE, below)
    assert (found.logits[:, :, 0] != OUTSIDE).all()


@pytest.mark.parametrize(("config", "least"), [(SMALL, 0.0), (SQUASHED, math.tanh(5 * math.log(2)))])
def test_only_raw_densities_can_be_empty(config: FieldConfig, least: float):
    """However low the logits: five squashed components have a density of .998."""
    density = log_density(decoded(config, bias=-50.0)[0].logits).exp()
    torch.testing.assert_close(density, torch.full_like(density, least), atol=1e-5, rtol=0)
    assert least == pytest.approx(0.998, abs=1e-3) or least == 0.0
