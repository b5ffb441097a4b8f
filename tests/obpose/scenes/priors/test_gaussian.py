import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from obpose.errors import CorruptFile, UsageError
from obpose.scenes.appearance.table_texture import SPOT
from obpose.scenes.model_ref import Origin, load_origin
from obpose.scenes.priors.gaussian import Mixture, fit_mixture, fit_prior, learned_prior, load_prior, save_prior
from obpose.storage.pretrained import shipped_names
from tests.obpose.scenes.small_scenes import some_model, some_tables
from tests.worlds.observations import table_scene


def gaussian(mean: Tensor, factor: Tensor) -> Mixture:
    return Mixture(torch.ones(1), mean[None], factor[None])


def test_a_gaussian_draws_with_its_mean_and_covariance():
    factor = torch.tensor([[2.0, 0.0], [1.0, 0.5]])
    drawn = gaussian(torch.tensor([3.0, -1.0]), factor).draw(20000, torch.Generator().manual_seed(0))
    torch.testing.assert_close(drawn.mean(dim=0), torch.tensor([3.0, -1.0]), atol=0.05, rtol=0)
    torch.testing.assert_close(drawn.T.cov(), factor @ factor.T, atol=0.1, rtol=0)


def test_a_mixture_draws_from_its_parts_by_their_weights():
    mixture = Mixture(torch.tensor([0.25, 0.75]), torch.tensor([[-9.0], [9.0]]), torch.tensor([[[1.0]], [[2.0]]]))
    drawn = mixture.draw(20000, torch.Generator().manual_seed(0))[:, 0]
    low, high = drawn[drawn < 0], drawn[drawn > 0]
    assert len(low) / len(drawn) == pytest.approx(0.25, abs=0.01)
    assert [float(low.mean()), float(low.std())] == pytest.approx([-9, 1], abs=0.05)
    assert [float(high.mean()), float(high.std())] == pytest.approx([9, 2], abs=0.05)
    assert mixture.draw(0, torch.Generator()).shape == (0, 1)


def test_a_fitted_mixture_has_as_many_parts_as_there_are_clusters():
    noise, places = torch.Generator().manual_seed(0), 10 * torch.eye(4)
    values = places.repeat(100, 1) + torch.randn(400, 4, generator=noise)
    mixture = fit_mixture(values)
    nearest = torch.cdist(places, mixture.means).min(dim=1)
    torch.testing.assert_close(mixture.weights[nearest.indices], torch.full((4,), 0.25), atol=0.01, rtol=0)
    assert nearest.values.max() < 0.4
    covariances = mixture.factors @ mixture.factors.mT
    torch.testing.assert_close(covariances[nearest.indices], torch.eye(4).expand(4, 4, 4), atol=0.5, rtol=0)
    assert torch.equal(fit_mixture(values).means, mixture.means)


def test_one_cluster_is_one_gaussian():
    values = torch.randn(400, 4, generator=torch.Generator().manual_seed(0))
    mixture = fit_mixture(values)
    assert mixture.weights.tolist() == [1]
    torch.testing.assert_close(mixture.factors[0] @ mixture.factors[0].T, values.T.cov(), atol=1e-5, rtol=0)


def test_the_first_learned_prior_is_that_of_training():
    model = some_model()
    prior = learned_prior(model)
    inference = model.infer(table_scene(batch=1))
    assert inference.background is not None
    torch.testing.assert_close(prior.background.means[0], inference.background.prior_mean[0, 0])
    torch.testing.assert_close(prior.background.factors[0].diag(), inference.background.prior_std[0, 0])
    torch.testing.assert_close(prior.what.means[0], inference.what.prior_mean[0, 0, 0])
    torch.testing.assert_close(prior.what.factors[0], torch.diag(inference.what.prior_std[0, 0, 0]))


def test_a_fitted_prior_has_the_moments_of_what_was_inferred():
    model = some_model()
    clips = [table_scene(batch=1, frames=1, seed=seed) for seed in range(6)]
    prior = fit_prior(model, clips, some_tables())
    seen = torch.stack([model.segment(clip).inference.background.mean[0, 0] for clip in clips])  # pyright: ignore
    torch.testing.assert_close(prior.background.means[0], seen.mean(dim=0))
    factor = prior.background.factors[0]
    torch.testing.assert_close(factor @ factor.T, seen.T.cov(), atol=1e-5, rtol=1e-4)
    assert (prior.low <= prior.high).all()
    assert torch.equal(prior.tables.lights, some_tables().lights)


def test_it_needs_two_clips():
    with pytest.raises(UsageError, match="in 1 clip; expected at least 2"):
        fit_prior(some_model(), [table_scene(batch=1, frames=1)], some_tables())


def some_origin(folder: Path) -> Origin:
    return Origin(some_model(), folder, "name", "hash")


def test_a_stored_prior_is_the_same_and_others_are_refused(tmp_path: Path):
    origin = some_origin(tmp_path)
    with pytest.raises(UsageError, match="make one with obpose-edit fit first"):
        load_prior(origin)
    prior = replace(learned_prior(origin.model), tables=some_tables())
    save_prior(origin, prior)
    found = load_prior(origin)
    assert torch.equal(found.tables.lights, prior.tables.lights)
    assert torch.equal(found.tables.spots, prior.tables.spots.half().float())
    assert torch.equal(found.what.factors, prior.what.factors)
    assert torch.equal(found.high, prior.high)
    short = gaussian(torch.zeros(3), torch.eye(3))
    save_prior(origin, replace(prior, what=short))
    with pytest.raises(CorruptFile, match="is damaged"):
        load_prior(origin)
    save_prior(origin, replace(prior, what=replace(prior.what, weights=torch.zeros(1))))
    with pytest.raises(CorruptFile, match="is damaged"):
        load_prior(origin)
    save_prior(origin, replace(prior, low=prior.low * torch.nan))
    with pytest.raises(CorruptFile, match="is damaged"):
        load_prior(origin)
    for tables in (
        {"lights": torch.tensor([[1.0, 1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]])},
        {"lights": torch.zeros(3, 4)},
        {"lights": torch.zeros(2, 4, dtype=torch.float64)},
        {"what.weights": torch.ones(())},
        {"lights": torch.zeros(4)},
        {"spots": torch.zeros(2, SPOT, SPOT - 1, 3)},
        {"spots": torch.full((2, SPOT, SPOT, 3), torch.nan)},
        {"spots": torch.zeros(())},
        {"spots": torch.zeros(2, SPOT, SPOT, 3)},
        {"spots": None},
        {"lights": None},
        {"low": None},
        {"what.means": None},
        {"more": torch.zeros(1)},
        {"low": torch.zeros(3)},
        {"low": prior.high + 1},
        {"low": prior.low.double()},
        {"what.weights": torch.full((1,), 0.5)},
        {"what.weights": -torch.ones(1)},
        {"what.weights": torch.zeros(0)},
        {"what.factors": 1e30 * prior.what.factors},
        {"background.means": torch.zeros(1, 3)},
    ):
        save_prior(origin, prior)
        path = tmp_path / "prior.safetensors"
        changed = {name: value for name, value in {**load_file(path), **tables}.items() if value is not None}
        save_file(changed, path, metadata={"weights": "hash"})
        with pytest.raises(CorruptFile, match="is damaged"):
            load_prior(origin)
    (tmp_path / "prior.safetensors").write_bytes(b"other")
    with pytest.raises(CorruptFile, match="is damaged"):
        load_prior(origin)


def test_a_pipe_in_the_place_of_a_prior_does_not_hang(tmp_path: Path):
    os.mkfifo(tmp_path / "prior.safetensors")
    with pytest.raises(UsageError, match="make one with obpose-edit fit first"):
        load_prior(some_origin(tmp_path))


def test_priors_of_older_versions_know_no_tables(tmp_path: Path):
    origin, path = some_origin(tmp_path), tmp_path / "prior.safetensors"
    save_prior(origin, replace(learned_prior(origin.model), tables=some_tables()))
    values = load_file(path)
    del values["lights"], values["spots"]
    save_file(values, path, metadata={"weights": "hash"})
    assert not len(load_prior(origin).tables.lights)


def test_a_prior_is_of_the_weights_that_it_was_fitted_to(tmp_path: Path):
    origin = some_origin(tmp_path)
    save_prior(origin, learned_prior(origin.model))
    with pytest.raises(CorruptFile, match="was fitted to other weights than those beside it; make it again"):
        load_prior(replace(origin, hash="another"))
    save_file(load_file(tmp_path / "prior.safetensors"), tmp_path / "prior.safetensors")
    with pytest.raises(CorruptFile, match="does not say which weights it was fitted to"):
        load_prior(origin)


@pytest.mark.parametrize("name", shipped_names())
def test_priors_that_ship_are_of_the_weights_beside_them(name: str):
    assert load_prior(load_origin(name)).what.means.isfinite().all()
