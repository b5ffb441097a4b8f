import pytest
import torch
from torch.distributions import Normal, kl_divergence

from obpose.model.losses.regularisers import kl, remaining_scope, translation
from obpose.types import Latent


def _latent(*shape: int, extreme: float = 0.0) -> Latent:
    generator = torch.Generator().manual_seed(0)
    mean, prior_mean = torch.randn((2, *shape, 6), generator=generator) * 10**extreme
    std, prior_std = 1e-4 + torch.rand((2, *shape, 6), generator=generator) * 10 ** (-extreme)
    return Latent(mean, mean, std, prior_mean, prior_std)


def test_scope_is_averaged_over_valid_points():
    scope = torch.tensor([[[0.5, 0.25, 1.0, 1.0]]])
    valid = torch.tensor([[[True, True, False, False]]])
    assert remaining_scope(scope.log(), valid).item() == pytest.approx(0.375)
    assert remaining_scope(scope.log(), torch.zeros_like(valid)).item() == 0


def test_translation_sums_square_metres_over_slots_in_use_and_averages_over_frames():
    predicted, shape = torch.zeros(2, 3, 4, 3), torch.zeros(2, 3, 4, 3)
    shape[0, 0, 1] = torch.tensor([0.1, -0.2, 0.2])
    shape[0, 0, 2] = torch.tensor([0.0, 0.3, 0.0])
    shape[1, 2] = 5.0
    found = torch.ones(2, 3, 4, dtype=torch.bool)
    found[1, 2, :2] = False
    active = torch.tensor([[True, True, True, False], [True, True, False, False]])
    loss = translation(predicted, shape, found, active)
    assert loss.item() == pytest.approx((0.09 + 0.09) / 6)


def test_translation_pulls_the_prediction_alone():
    predicted, shape = torch.zeros(1, 1, 2, 3, requires_grad=True), torch.ones(1, 1, 2, 3, requires_grad=True)
    loss = translation(predicted, shape, torch.ones(1, 1, 2, dtype=torch.bool), torch.tensor([[True, False]]))
    by_predicted, by_shape = torch.autograd.grad(loss, (predicted, shape), allow_unused=True)
    torch.testing.assert_close(by_predicted, torch.tensor([-2.0, 0.0])[:, None].expand(1, 1, 2, 3))
    assert by_shape is None


@pytest.mark.parametrize("shape", [(2, 3, 4), (2, 3)])
def test_kl_agrees_with_torch(shape: tuple[int, ...]):
    latent = _latent(*shape)
    exact = kl_divergence(Normal(latent.mean, latent.std), Normal(latent.prior_mean, latent.prior_std))
    torch.testing.assert_close(kl(latent), exact.sum() / 6, rtol=1e-4, atol=0)


def test_kl_of_idle_slots_does_not_count():
    latent = _latent(2, 3, 4)
    active = torch.tensor([[True, False, True, True], [False, False, True, False]])
    exact = kl_divergence(Normal(latent.mean, latent.std), Normal(latent.prior_mean, latent.prior_std)).sum(dim=-1)
    expected = (exact * active[:, None]).sum() / 6
    torch.testing.assert_close(kl(latent, active[:, None]), expected, rtol=1e-4, atol=0)


def test_kl_is_zero_where_posterior_and_prior_are_the_same():
    latent = _latent(2, 3, 4)
    same = Latent(latent.z, latent.mean, latent.std, latent.mean, latent.std)
    assert kl(same).item() == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("extreme", [4.0, -4.0])
def test_kl_and_its_gradient_are_finite_at_extremes(extreme: float):
    latent = _latent(2, 3, 4, extreme=extreme)
    inputs = [latent.mean, latent.std, latent.prior_mean, latent.prior_std]
    for value in inputs:
        value.requires_grad_()
    loss = kl(latent)
    assert loss.isfinite()
    assert all(gradient.isfinite().all() for gradient in torch.autograd.grad(loss, inputs))
