import math

import pytest
import torch

from obpose.model.losses.attention import attention_l2, attention_mixture, attention_warmup
from obpose.model.losses.observation import COLOUR_STD as STD
from obpose.model.losses.observation import colour_log_likelihood
from obpose.model.nerf.along import FieldsAlongRays
from obpose.types import Decoded, Rays

FLOOR = -18.0
SHAPE = (2, 3, 5, 7)


def _fields(*, scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Log masks, colours, log shares of the components at a few rays, and which of the rays are valid."""
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: scale * torch.randn(shape, generator=generator)  # noqa: E731
    colours = torch.rand((*SHAPE, 3), generator=generator)
    valid = torch.rand((2, 3, 7), generator=generator) < 0.7
    return draw(*SHAPE).log_softmax(dim=2), colours, draw(*SHAPE).log_softmax(dim=2) - 0.1, valid


def _target() -> torch.Tensor:
    return torch.rand((2, 3, 7, 3), generator=torch.Generator().manual_seed(1))


def _likelihood(colours: torch.Tensor) -> torch.Tensor:
    """N(x | c_k, std) in each channel, in double precision."""
    distribution = torch.distributions.Normal(colours.double(), STD)
    return distribution.log_prob(_target().double()[:, :, None]).exp()


def test_mixture_by_channel_agrees_with_the_formula():
    log_masks, colours, log_share, valid = _fields()
    likelihood = colour_log_likelihood(colours, _target())
    masks, share, floor = log_masks.double().exp(), log_share.double().exp(), math.exp(FLOOR)
    colour = torch.log((masks * share)[..., None].mul(_likelihood(colours)).sum(dim=2) + floor).sum(dim=-1)
    density = torch.log((masks * share).sum(dim=2) + floor)
    loss = attention_mixture(log_masks, likelihood, log_share, valid.float(), floor=FLOOR)
    torch.testing.assert_close(loss.double(), -(colour + density)[valid].mean(), rtol=1e-5, atol=0)


def test_l2_agrees_with_the_formula():
    log_masks, colours, log_share, valid = _fields()
    values = colour_log_likelihood(colours, _target())
    masks, share = log_masks.double().exp(), log_share.double().exp()
    match = (_likelihood(colours) * STD * math.sqrt(2 * math.pi)).prod(dim=-1)
    expected = ((match - masks) ** 2 * share + (masks - share) ** 2).sum(dim=2)[valid].mean()
    loss = attention_l2(log_masks, values, log_share, valid.float())
    torch.testing.assert_close(loss.double(), expected, rtol=1e-5, atol=0)


def test_l2_is_zero_for_right_masks_of_one_opaque_component_with_the_right_colour():
    log_masks = torch.full(SHAPE, -1e4)
    log_masks[:, :, 2] = 0
    target = _target()
    values = colour_log_likelihood(target[:, :, None].expand(-1, -1, 5, -1, -1), target)
    loss = attention_l2(log_masks, values, log_masks, torch.ones(2, 3, 7))
    assert loss.item() == pytest.approx(0, abs=1e-6)


def test_the_mixture_is_least_at_masks_that_take_the_component_that_explains_the_ray():
    _, colours, _, valid = _fields()
    colours[:, :, 3] = _target()
    share = torch.full(SHAPE, -math.log(5))
    values = colour_log_likelihood(colours, _target())
    certain = (100 * torch.eye(5)).log_softmax(dim=-1)
    losses = [
        attention_mixture(row[:, None].expand(SHAPE), values, share, valid.float(), floor=FLOOR).item()
        for row in certain
    ]
    assert losses.index(min(losses)) == 3


def test_the_decoder_gets_no_gradient_and_invalid_rays_give_none():
    log_masks, colours, log_share, valid = _fields()
    values = colour_log_likelihood(colours, _target())
    for loss in (attention_mixture, attention_l2):
        option = {"floor": FLOOR} if loss is attention_mixture else {}
        inputs = [value.clone().requires_grad_() for value in (log_masks, values, log_share)]
        result = loss(inputs[0], inputs[1], inputs[2], valid.float(), **option)
        gradients = torch.autograd.grad(result, inputs, allow_unused=True)
        assert gradients[0] is not None
        assert gradients[0].movedim(2, -1)[~valid].eq(0).all()
        assert gradients[0].movedim(2, -1)[valid].ne(0).all()
        assert gradients[1] is None
        assert gradients[2] is None


@pytest.mark.parametrize("scale", [1.0, 300.0, 1e4])
def test_finite_with_finite_gradients_at_extremes_also_for_one_that_nothing_explains(scale: float):
    log_masks, colours, log_share, valid = _fields(scale=scale)
    values = colour_log_likelihood(scale * colours, -_target())
    for loss in (attention_mixture, attention_l2):
        option = {"floor": FLOOR} if loss is attention_mixture else {}
        masks = log_masks.clone().requires_grad_()
        result = loss(masks, values, log_share, valid.float(), **option)
        (gradient,) = torch.autograd.grad(result, masks)
        assert result.isfinite()
        assert gradient.isfinite().all()


def test_the_floor_bounds_what_a_ray_can_cost():
    log_masks, colours, log_share, valid = _fields()
    values = colour_log_likelihood(colours + 100, _target())
    loss = attention_mixture(log_masks, values, log_share - 1e4, valid.float(), floor=FLOOR)
    assert loss.item() == pytest.approx(-4 * FLOOR)


def test_no_valid_ray_no_loss():
    log_masks, colours, log_share, valid = _fields()
    values = colour_log_likelihood(colours, _target())
    nothing = torch.zeros(valid.shape)
    assert attention_mixture(log_masks, values, log_share, nothing, floor=FLOOR).item() == 0
    assert attention_l2(log_masks, values, log_share, nothing).item() == 0


def _warmup_inputs(distance: float) -> tuple[torch.Tensor, FieldsAlongRays]:
    """Log pre-scopes at two rays, and a background whose colour at the first is `distance` deviations off."""
    log_prescope = torch.tensor([[0.3, 0.6], [0.7, 0.4]]).log()[None, None].requires_grad_()
    colours = torch.zeros(1, 1, 1, 2, 3)
    colours[..., 0, :] = distance * STD
    every, points = torch.ones(1, 1, 2), torch.zeros(1, 1, 2, 3)
    rays = Rays(every.long(), every > 0, every, points, points, points, every)
    background = Decoded(torch.zeros(1, 1, 1, 2), colours.requires_grad_())
    return log_prescope, FieldsAlongRays(rays, background, background, every)


def test_warmup_agrees_with_the_formula_and_pulls_only_at_the_prescope():
    log_prescope, fields = _warmup_inputs(2.0)
    loss = attention_warmup(log_prescope, fields)
    background, scope = log_prescope.detach().double().exp()[0, 0]
    known = torch.distributions.Normal(0.0, STD).log_prob(torch.tensor([2 * STD, 0.0])).double().exp()
    torch.testing.assert_close(loss.double(), -3 * (background * known + scope).log().mean())
    loss.backward()
    assert fields.surface.colours is not None
    assert fields.surface.colours.grad is None
    assert log_prescope.grad is not None


@pytest.mark.parametrize(("distance", "grows"), [(0.0, 0), (4.0, 1)])
def test_in_the_warmup_the_prescope_goes_to_what_the_background_does_not_explain(distance: float, grows: int):
    logits = torch.zeros(1, 1, 2, 2, requires_grad=True)
    attention_warmup(logits.log_softmax(dim=2), _warmup_inputs(distance)[1]).backward()
    assert logits.grad is not None
    assert (-logits.grad[0, 0, :, 0]).argmax() == grows
