"""Weighted sum of the terms; each term is tested with its own function."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from obpose.config import LossConfig
from obpose.model.build import build_obpose
from obpose.model.losses.objective import KL, KL_WHERE, SCOPE, growth, observation_terms, weighted_terms
from obpose.model.nerf.along import FieldsAlongRays
from obpose.types import Decoded, Rays
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


def test_the_warmup_has_the_terms_of_background_and_prescope():
    assert losses("obpose", step=0).keys() == OBSERVED | {"attention", "kl_background", "total"}


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


@pytest.mark.parametrize(
    ("fraction", "expected"), [(0.0, 1.0), (0.5, 1.0), (0.5625, 10**0.5), (0.625, 10.0), (0.75, 100.0), (1.0, 100.0)]
)
def test_the_weight_of_the_air_grows_between_a_half_and_three_quarters_of_the_budget(fraction: float, expected: float):
    assert growth(100.0, fraction) == pytest.approx(expected)
    assert growth(1.0, fraction) == 1.0


def test_the_saturation_of_the_configuration_is_that_of_the_air_term():
    everywhere = torch.ones(1, 1, 5)
    rays = Rays(everywhere.long(), everywhere > 0, everywhere, *(torch.ones(1, 1, 5, 3) for _ in range(3)), everywhere)
    at_surface = Decoded(torch.zeros(1, 1, 2, 5), torch.zeros(1, 1, 2, 5, 3))
    fields = FieldsAlongRays(rays, at_surface, replace(at_surface, logits=torch.full((1, 1, 2, 5), 9.0)), everywhere)
    plain, tanh = (
        observation_terms(fields, LossConfig(air_saturation=saturation))["air"] for saturation in (3.0, None)
    )
    assert plain > tanh + 0.1


def losses(variant: str, *, step: int = 1000, views: int = 1, **changes: Any) -> dict[str, torch.Tensor]:
    """Losses of a fresh model on one scene."""
    torch.manual_seed(0)
    model = build_obpose(make_config(variant, **{"model.spacing": 0.024, **changes}))
    generator = torch.Generator().manual_seed(0)
    return model.losses(table_scene(views=views), step=step, generator=generator)
