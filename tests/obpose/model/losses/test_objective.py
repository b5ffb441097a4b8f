"""The sum of the terms; each term is tested with its own function."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from obpose.config import LossConfig
from obpose.model.losses.objective import Evidence, growth, loss_terms
from obpose.model.obpose import ObPose
from obpose.variants import make_config
from tests.worlds.observations import table_scene

WEIGHTS = {
    "colour": 2.0,
    "surface": 3.0,
    "air": 5.0,
    "mask": 7.0,
    "scope": 11.0,
    "translation": 13.0,
    "kl": 17.0,
    "kl_where": 19.0,
}
"""Primes: no weight is another's, nor a sum that hides a term."""
WEIGHT_OF = {"attention": "mask", "kl_background": "kl", "kl_what": "kl"}
"""Terms that are not called as their weights are."""

OBSERVED = {"colour", "surface", "air"}
OBJECTS = {"attention", "scope", "kl_what"}
POSED = {"translation", "kl_where"}
TERMS = {
    "obpose": OBSERVED | OBJECTS | POSED | {"kl_background"},
    "obpose-none": OBSERVED | OBJECTS | {"kl_background"},
    "ic-sbp": OBSERVED | OBJECTS,
}


@pytest.mark.parametrize(("variant", "names"), TERMS.items())
def test_the_total_is_the_weighted_sum_of_the_terms_that_the_variant_has(variant: str, names: set[str]):
    assert_weighted_sum(losses(variant), names)


def test_in_the_warmup_it_is_that_of_background_and_prescope():
    assert_weighted_sum(losses("obpose", step=0), OBSERVED | {"attention", "kl_background"})


def test_terms_are_told_without_gradient_and_the_total_has_one():
    terms = losses("obpose")
    assert {name for name, term in terms.items() if term.requires_grad} == {"total"}


def test_rays_of_views_that_are_not_encoded_count_as_much_as_the_others(monkeypatch: pytest.MonkeyPatch):
    seen: list[Evidence] = []
    monkeypatch.setattr("obpose.model.obpose.loss_terms", lambda evidence, *_, **__: seen.append(evidence) or {})
    losses("obpose", views=2, **{"train.views": "one"})
    both = seen[0]
    assert both.beyond is not None
    together, encoded, others = (
        loss_terms(replace(both, fields=fields, beyond=beyond), LossConfig(), fraction=0.0)
        for fields, beyond in ((both.fields, both.beyond), (both.fields, None), (both.beyond, None))
    )
    for name in OBSERVED:
        assert encoded[name] != others[name]
        torch.testing.assert_close(together[name], (encoded[name] + others[name]) / 2)


def test_the_air_keeps_its_weight_where_it_does_not_grow():
    assert {growth(1.0, fraction) for fraction in (0.0, 0.6, 1.0)} == {1.0}


def test_numbers_of_the_configuration_are_those_of_the_terms(monkeypatch: pytest.MonkeyPatch):
    seen: list[Evidence] = []
    monkeypatch.setattr("obpose.model.obpose.loss_terms", lambda evidence, *_, **__: seen.append(evidence) or {})
    losses("obpose")
    (plain,) = seen
    dense = replace(plain.fields, air=replace(plain.fields.air, logits=plain.fields.air.logits.clamp(-9, 9).abs() + 9))
    for changed, evidence, term in (
        (LossConfig(air_saturation=None), replace(plain, fields=dense), "air"),
        (LossConfig(attention_floor=-0.5), plain, "attention"),
        (LossConfig(colour_std=0.3), plain, "colour"),
        (LossConfig(sigma_max=5.0), plain, "surface"),
    ):
        one, other = (loss_terms(evidence, config, fraction=0.0)[term] for config in (LossConfig(), changed))
        assert abs(float(one - other)) > 1e-3, term


def losses(variant: str, *, step: int = 1000, views: int = 1, **changes: Any) -> dict[str, torch.Tensor]:
    """Of a fresh model on one scene."""
    torch.manual_seed(0)
    weights = {f"loss.{name}": weight for name, weight in WEIGHTS.items()}
    model = ObPose(make_config(variant, **{"model.spacing": 0.024, **weights, **changes}))
    generator = torch.Generator().manual_seed(0)
    return model.losses(table_scene(views=views), step=step, generator=generator)


def assert_weighted_sum(terms: dict[str, torch.Tensor], names: set[str]) -> None:
    assert terms.keys() == names | {"total"}
    weighted = [WEIGHTS[WEIGHT_OF.get(name, name)] * terms[name] for name in names]
    torch.testing.assert_close(terms["total"].detach(), torch.stack(weighted).sum(), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("fraction", "expected"), [(0.0, 1.0), (0.5, 1.0), (0.5625, 10**0.5), (0.625, 10.0), (0.75, 100.0), (1.0, 100.0)]
)
def test_the_weight_of_the_air_grows_between_a_half_and_three_quarters_of_the_budget(fraction: float, expected: float):
    assert growth(100.0, fraction) == pytest.approx(expected)
