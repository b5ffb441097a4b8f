from dataclasses import replace
from pathlib import Path

import torch

from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.codes import CodePrior
from obpose.scenes.priors.flow_prior import save_flow
from obpose.scenes.priors.gaussian import save_gaussian
from obpose.scenes.priors.learned import learned_prior
from obpose.scenes.priors.mixture import Mixture
from obpose.viewer.sampling import Sampler
from tests.obpose.scenes.small_scenes import CAMERA, dense_flow, some_model


def test_seeds_follow_each_other_and_begin_anew():
    origin = Origin(some_model(), Path("no-prior-here"), "name", "hash")
    first, second = Sampler(origin), Sampler(origin)
    one, two = first.next(1, (CAMERA,)), first.next(1, (CAMERA,))
    again = second.next(1, (CAMERA,))
    assert torch.equal(one.what, again.what)
    assert not torch.equal(one.what, two.what)
    assert first.seed == 1


def test_scenes_are_of_the_best_prior_that_there_is(tmp_path: Path):
    origin = Origin(some_model(), tmp_path, "name", "hash")
    learned = Sampler(origin).next(1, (CAMERA,))
    save_gaussian(origin, replace(learned_prior(origin), objects=CodePrior(Mixture(*centred_on(3.0)))))
    fitted = Sampler(origin).next(1, (CAMERA,))
    assert float((learned.what - 3).abs().max()) > 1 > float((fitted.what - 3).abs().max())
    assert not fitted.appearance.detail.any()
    save_flow(origin, dense_flow(latent=32))
    assert Sampler(origin).next(1, (CAMERA,)).appearance.detail.any()


def centred_on(value: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    return torch.ones(1), torch.full((1, 32), value), 0.01 * torch.eye(32)[None]
