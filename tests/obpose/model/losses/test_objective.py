"""Weighted sum of the terms; each term is tested with its own function."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch.distributions import Normal, kl_divergence

from obpose.config import LossConfig
from obpose.model.build import build_obpose
from obpose.model.losses.objective import (
    KL,
    KL_WHERE,
    SCOPE,
    kl,
    observation_terms,
    remaining_scope,
    translation,
    weighted_terms,
)
from obpose.model.nerf.along import FieldsAlongRays
from obpose.types import Decoded, Latent, Rays
from obpose.variants import make_config
from tests.worlds.observations import table_scene

WEIGHTS = {
    "colour": 1.0,
    "surface": 1.0,
    "air": 1.0,
    "attention": 7.0,
    "scope": SCOPE,
    "translation": 13.0,
    "kl_background": KL,
    "kl_what": KL,
    "kl_where": KL_WHERE,
}
OBSERVED = {"colour", "surface", "air"}
OBJECTS = {"attention", "scope", "kl_what"}
POSED = {"translation", "kl_where"}
TERMS = {
    "obpose": OBSERVED | OBJECTS | POSED | {"kl_background"},
    "obpose-none": OBSERVED | OBJECTS | {"kl_background"},
    "ic-sbp": OBSERVED | OBJECTS,
}


@pytest.mark.parametrize(("variant", "names"), TERMS.items())
def test_a_variant_has_its_terms(variant: str, names: set[str]):
    assert losses(variant).keys() == names | {"total"}


def test_the_total_is_the_weighted_sum_and_has_the_only_gradient():
    terms = {name: torch.tensor(1.0 + i, requires_grad=True) for i, name in enumerate(WEIGHTS)}
    found = weighted_terms(terms, LossConfig(attention_weight=7.0, translation=13.0), fraction=0.0)
    expected = sum(weight * terms[name].item() for name, weight in WEIGHTS.items())
    assert found["total"].item() == pytest.approx(expected)
    assert {name for name, term in found.items() if term.requires_grad} == {"total"}


def test_rays_of_views_that_are_not_encoded_count_as_much_as_the_others(monkeypatch: pytest.MonkeyPatch):
    seen: list[dict[str, torch.Tensor]] = []

    def spy(fields: FieldsAlongRays, config: LossConfig) -> dict[str, torch.Tensor]:
        seen.append(observation_terms(fields, config))
        return seen[-1]

    monkeypatch.setattr("obpose.model.obpose.observation_terms", spy)
    both = losses("obpose", views=2, **{"train.views": "random"})
    encoded, others = seen
    for name in OBSERVED:
        assert encoded[name] != others[name]
        torch.testing.assert_close(both[name], ((encoded[name] + others[name]) / 2).detach())


def test_the_saturation_of_the_configuration_is_that_of_the_air_term():
    everywhere = torch.ones(1, 1, 5)
    rays = Rays(everywhere.long(), everywhere > 0, everywhere, *(torch.ones(1, 1, 5, 3) for _ in range(3)), everywhere)
    at_surface = Decoded(torch.zeros(1, 1, 2, 5), torch.zeros(1, 1, 2, 5, 3))
    fields = FieldsAlongRays(rays, at_surface, replace(at_surface, logits=torch.full((1, 1, 2, 5), 9.0)), everywhere)
    plain, tanh = (
        observation_terms(fields, LossConfig(air_saturation=saturation))["air"] for saturation in (3.0, None)
    )
    assert plain > tanh + 0.1


def losses(variant: str, *, views: int = 1, **changes: Any) -> dict[str, torch.Tensor]:
    """Losses of a fresh model on one scene, after the warm-up."""
    torch.manual_seed(0)
    model = build_obpose(make_config(variant, **{"model.spacing": 0.024, **changes}))
    generator = torch.Generator().manual_seed(0)
    return model.losses(table_scene(views=views), step=1000, generator=generator)


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
