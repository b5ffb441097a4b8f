import math

import pytest
import torch

from obpose.model.losses.observation import COLOUR_STD as STD
from obpose.model.losses.observation import air, colour_log_likelihood, colour_mixture, mean_over, surface
from obpose.model.nerf.compose import OUTSIDE, log_share

SHAPE = (2, 2, 3, 40)


def example(dtype: torch.dtype = torch.float32) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Logits, colours of the components, observed colours, valid rays; colours differ by up to three deviations."""
    generator = torch.Generator().manual_seed(0)
    logits = 2 * torch.randn(SHAPE, generator=generator)
    target = torch.rand(*SHAPE[:2], SHAPE[3], 3, generator=generator)
    colours = target[:, :, None] + 3 * STD * (2 * torch.rand(*SHAPE, 3, generator=generator) - 1)
    valid = torch.rand(*SHAPE[:2], SHAPE[3], generator=generator) < 0.7
    return logits.to(dtype), colours.to(dtype), target.to(dtype), valid


def colour_loss(logits: torch.Tensor, colours: torch.Tensor, target: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    return colour_mixture(log_share(logits), colour_log_likelihood(colours, target), valid.to(logits.dtype))


def direct_share(logits: torch.Tensor) -> torch.Tensor:
    logits = logits.double()
    return torch.tanh(torch.log1p(logits.exp()).sum(dim=2, keepdim=True)) * torch.softmax(logits, dim=2)


def direct_normal(colours: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    away = (colours - target[:, :, None]).double() / STD
    return torch.exp(-0.5 * away.square()) / (STD * math.sqrt(2 * math.pi))


def test_the_colour_term_is_the_authors_with_a_mixture_a_channel():
    logits, colours, target, valid = example()
    inside = (direct_normal(colours, target) * direct_share(logits)[..., None]).sum(dim=2)
    expected = -inside.log().sum(dim=-1)[valid].mean()
    assert colour_loss(logits, colours, target, valid).item() == pytest.approx(expected.item(), rel=1e-5)


def test_the_order_of_the_components_does_not_matter():
    logits, colours, target, valid = example()
    order = torch.tensor([2, 0, 1])
    turned = colour_loss(logits[:, :, order], colours[:, :, order], target, valid)
    torch.testing.assert_close(turned, colour_loss(logits, colours, target, valid))


def test_a_colour_that_is_far_off_is_still_pulled():
    colours = torch.zeros(1, 1, 2, 1, 3, requires_grad=True)
    logits = torch.tensor([5.0, OUTSIDE]).view(1, 1, 2, 1)
    loss = colour_loss(logits, colours, torch.ones(1, 1, 1, 3), torch.ones(1, 1, 1))
    (gradient,) = torch.autograd.grad(loss, colours)
    torch.testing.assert_close(gradient[0, 0, 0, 0], torch.full((3,), -1 / STD**2))
    assert (gradient[0, 0, 1] == 0).all()


def test_the_surface_term_is_the_log_of_the_density():
    logits, *_, valid = example()
    expected = -(10 * direct_share(logits).sum(dim=2)).log()[valid].mean()
    assert surface(logits, valid.to(logits.dtype)).item() == pytest.approx(expected.item(), rel=1e-5)


def test_the_air_term_is_the_weighted_density():
    logits, *_, valid = example()
    logits = logits.clamp(max=0.2)
    inverse_rho = torch.rand(valid.shape) + 0.5
    expected = (10 * direct_share(logits).sum(dim=2) * inverse_rho)[valid].mean()
    assert air(logits, inverse_rho, valid.to(logits.dtype), saturation=3.0).item() == pytest.approx(
        expected.item(), rel=1e-5
    )


def test_invalid_rays_have_no_say():
    logits, colours, target, valid = example()
    logits.requires_grad_()
    colours.requires_grad_()
    spoiled = torch.where(valid[..., None], target, 100.0)

    def total(target: torch.Tensor, weight: float) -> torch.Tensor:
        inverse_rho = torch.where(valid, 1.0, weight)
        return (
            colour_loss(logits, colours, target, valid)
            + surface(logits, valid.to(logits.dtype))
            + air(logits, inverse_rho, valid.to(logits.dtype), saturation=3.0)
        )

    torch.testing.assert_close(total(spoiled, 1e6), total(target, 1.0))
    gradients = torch.autograd.grad(total(spoiled, 1e6), (logits, colours))
    assert all((gradient.transpose(2, 3)[~valid] == 0).all() for gradient in gradients)


def test_a_ray_that_stands_for_more_pixels_counts_more():
    loss = mean_over(torch.tensor([1.0, 2.0, torch.nan]), torch.tensor([0.5, 2.0, 0.0]))
    assert loss.item() == pytest.approx((0.5 * 1 + 2 * 2) / 2.5)


def test_a_clip_without_valid_rays_has_no_loss():
    logits, colours, target, valid = example()
    nothing = torch.zeros(valid.shape)
    assert colour_loss(logits, colours, target, nothing) == 0
    assert surface(logits, nothing) == 0


def test_everything_is_finite_where_nothing_is_dense():
    _, colours, target, valid = example()
    logits = torch.full(SHAPE, OUTSIDE)
    logits[:, :, 0] = -1e4
    logits.requires_grad_()
    total = colour_loss(logits, colours, target, valid) + surface(logits, valid.to(logits.dtype))
    assert total.isfinite()
    assert torch.autograd.grad(total, logits)[0].isfinite().all()
