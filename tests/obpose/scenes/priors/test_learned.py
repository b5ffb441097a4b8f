from pathlib import Path

import torch

from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.codes import CodePrior
from obpose.scenes.priors.learned import learned_prior
from tests.obpose.scenes.small_scenes import some_model
from tests.worlds.observations import table_scene


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
