import pytest
import torch

from obpose.baselines.obsurf.config import DecoderConfig
from obpose.baselines.obsurf.decoder import SlotField

IMAGES, SLOTS, POINTS = 2, 3, 5


def field(**options: object) -> SlotField:
    torch.manual_seed(0)
    return SlotField(DecoderConfig(width=16, **options), code=9, slot=8, pixel=4)


def draw(*shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(sum(shape)))


ENCODED, CODES = draw(IMAGES, POINTS, 9), draw(IMAGES, SLOTS, 8)
DIRECTIONS, PIXELS = draw(IMAGES, POINTS, 3), draw(IMAGES, POINTS, 4)


def test_layers_are_shifted_and_scaled_before_they_are_applied():
    module = field()
    logits, _ = module.density(ENCODED, CODES)
    values, slot = ENCODED[1, 4], CODES[1, 2]
    for shift, scale, layer in zip(module.shifts, module.scales, module.hidden, strict=True):
        values = layer((values + shift(slot)) * scale(slot)).relu()
    torch.testing.assert_close(logits[1, 2, 4], module.density_logit(values)[0])


def test_scales_can_begin_at_one_and_fresh_densities_then_depend_on_the_point():
    points = draw(1, 1000, 9)
    spread = []
    for begin in (False, True):
        module = field(unit_scales=begin)
        scales = torch.cat([scale(draw(1000, 8)) for scale in module.scales], dim=-1)
        assert scales.mean().item() == pytest.approx(float(begin), abs=0.1)
        spread.append(module.density(points, CODES[:1])[0].std(dim=-1).mean().item())
    assert spread[1] > 5 * spread[0]


def test_slots_share_weights_and_know_nothing_of_each_other():
    module, order = field(), torch.tensor([2, 0, 1])
    logits, hidden = module.density(ENCODED, CODES)
    turned, _ = module.density(ENCODED, CODES[:, order])
    torch.testing.assert_close(turned, logits[:, order])
    colours = module.colour(hidden, DIRECTIONS, PIXELS)
    assert colours.shape == (IMAGES, SLOTS, POINTS, 3)
    assert ((colours > 0) & (colours < 1)).all()


def test_colours_see_the_image_if_they_are_let():
    for lets in (True, False):
        module = field(pixel_features=lets)
        _, hidden = module.density(ENCODED, CODES)
        colours = [module.colour(hidden, DIRECTIONS, pixels) for pixels in (PIXELS, PIXELS + 1)]
        assert torch.equal(*colours) is not lets
