from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from obpose.errors import CorruptFile, UsageError
from obpose.scenes.appearance.table_texture import PATCH
from obpose.scenes.model_ref import Origin, load_origin
from obpose.scenes.priors.codes import CodePrior
from obpose.scenes.priors.gaussian import fit_codes, learned_prior, load_gaussian, save_gaussian
from obpose.scenes.priors.interface import ScenePrior
from obpose.scenes.priors.mixture import Mixture, normal
from tests.obpose.scenes.small_scenes import some_model, some_tables
from tests.worlds.observations import table_scene

SHIPPED = [
    f"obpose-contact--{name}" for name in ("clevr3d--80x60", "moving--64x64", "multishape--80x60", "static--64x64")
]


def test_a_fitted_prior_has_the_moments_of_what_was_inferred():
    model = some_model()
    clips = [table_scene(batch=1, frames=1, seed=seed) for seed in range(6)]
    prior = fit_codes(model, clips, some_tables())
    seen = torch.stack([model.segment(clip).inference.background.mean[0, 0] for clip in clips])  # pyright: ignore
    torch.testing.assert_close(prior.background.means[0], seen.mean(dim=0))
    factor = prior.background.factors[0]
    torch.testing.assert_close(factor @ factor.T, seen.T.cov(), atol=1e-5, rtol=1e-4)
    assert (prior.low <= prior.high).all()
    assert torch.equal(prior.tables.lights, some_tables().lights)


def test_it_needs_two_clips():
    with pytest.raises(UsageError, match="in 1 clip; expected at least 2"):
        fit_codes(some_model(), [table_scene(batch=1, frames=1)], some_tables())


def codes_of(prior: ScenePrior) -> Mixture:
    assert isinstance(prior.objects, CodePrior)
    return prior.objects.what


def some_origin(folder: Path) -> Origin:
    return Origin(some_model(), folder, "name", "hash")


def test_a_stored_prior_is_the_same_and_others_are_refused(tmp_path: Path):
    origin = some_origin(tmp_path)
    with pytest.raises(UsageError, match="make one with obpose-edit fit-prior --kind gaussian first"):
        load_gaussian(origin)
    prior = replace(learned_prior(origin), tables=some_tables())
    save_gaussian(origin, prior)
    found = load_gaussian(origin)
    torch.testing.assert_close(found.tables.lights, prior.tables.lights, rtol=1e-3, atol=1e-3)
    step = float(prior.tables.patches.abs().max()) / 127
    torch.testing.assert_close(found.tables.patches, prior.tables.patches, rtol=0, atol=step)
    assert isinstance(found.objects, CodePrior)
    codes = codes_of(prior)
    torch.testing.assert_close(found.objects.what.factors, codes.factors, rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(found.high, prior.high, rtol=1e-3, atol=0)
    save_gaussian(origin, replace(prior, objects=CodePrior(normal(torch.zeros(3), torch.ones(3)))))
    with pytest.raises(CorruptFile, match="is damaged"):
        load_gaussian(origin)
    save_gaussian(origin, replace(prior, objects=CodePrior(replace(codes, weights=torch.zeros(1)))))
    with pytest.raises(CorruptFile, match="is damaged"):
        load_gaussian(origin)
    save_gaussian(origin, replace(prior, low=prior.low * torch.nan))
    with pytest.raises(CorruptFile, match="is damaged"):
        load_gaussian(origin)
    for tables in (
        {"lights": torch.tensor([[1.0, 1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]])},
        {"lights": torch.zeros(2, 4, dtype=torch.float64)},
        {"spots": torch.zeros(2, PATCH, PATCH - 1, 3)},
        {"spots": torch.full((2, PATCH, PATCH, 3), torch.nan)},
        {"spots": None},
        {"low": None},
        {"what.means": None},
        {"more": torch.zeros(1)},
        {"low": prior.high + 1},
        {"what.weights": torch.full((1,), 0.5)},
        {"what.factors": 1e30 * codes.factors},
        {"background.means": torch.zeros(1, 3)},
    ):
        save_gaussian(origin, prior)
        path = tmp_path / "prior.safetensors"
        changed = {name: value for name, value in {**load_file(path), **tables}.items() if value is not None}
        save_file(changed, path, metadata={"weights": "hash"})
        with pytest.raises(CorruptFile, match="is damaged"):
            load_gaussian(origin)
    (tmp_path / "prior.safetensors").write_bytes(b"other")
    with pytest.raises(CorruptFile, match="is damaged"):
        load_gaussian(origin)


def test_priors_of_older_versions_know_no_tables(tmp_path: Path):
    origin, path = some_origin(tmp_path), tmp_path / "prior.safetensors"
    save_gaussian(origin, replace(learned_prior(origin), tables=some_tables()))
    values = load_file(path)
    del values["lights"], values["spots"], values["spots.step"]
    save_file(values, path, metadata={"weights": "hash"})
    assert not len(load_gaussian(origin).tables.lights)


def test_a_prior_is_of_the_weights_that_it_was_fitted_to(tmp_path: Path):
    origin = some_origin(tmp_path)
    save_gaussian(origin, learned_prior(origin))
    with pytest.raises(CorruptFile, match="was fitted to other weights than those beside it; make it again"):
        load_gaussian(replace(origin, hash="another"))
    save_file(load_file(tmp_path / "prior.safetensors"), tmp_path / "prior.safetensors")
    with pytest.raises(CorruptFile, match="was fitted to other weights"):
        load_gaussian(origin)


@pytest.mark.parametrize("name", SHIPPED)
def test_priors_that_ship_are_of_the_weights_beside_them(name: str):
    origin = load_origin(name)
    assert load_gaussian(origin).background.means.isfinite().all()


def test_the_learned_prior_is_the_first_one_of_training():
    model = some_model()
    prior = learned_prior(Origin(model, Path("folder"), "name", "hash"))
    inference = model.infer(table_scene(batch=1))
    assert inference.background is not None
    assert isinstance(prior.objects, CodePrior)
    torch.testing.assert_close(prior.background.means[0], inference.background.prior_mean[0, 0])
    torch.testing.assert_close(prior.background.factors[0].diag(), inference.background.prior_std[0, 0])
    torch.testing.assert_close(prior.objects.what.means[0], inference.what.prior_mean[0, 0, 0])
    torch.testing.assert_close(prior.objects.what.factors[0], torch.diag(inference.what.prior_std[0, 0, 0]))
