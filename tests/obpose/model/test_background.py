import torch

from obpose.config import LatentConfig
from obpose.model.background import BackgroundLatent


def test_one_latent_a_frame_whose_first_prior_is_learned():
    torch.manual_seed(0)
    background = BackgroundLatent(10, LatentConfig(background=6, hidden=8))
    scene = torch.randn(2, 3, 10, generator=torch.Generator().manual_seed(0))
    latent = background(scene, "mean")
    assert latent.z.shape == (2, 3, 6)
    assert torch.equal(latent.prior_mean[0, 0], latent.prior_mean[1, 0])
    starts = background.get_parameter("_starts")
    (posterior,) = torch.autograd.grad(latent.z.sum(), starts)
    assert (posterior.abs().sum(dim=-1) > 0).tolist() == [True, False]
    (prior,) = torch.autograd.grad(background(scene, "mean").prior_mean[:, 0].sum(), starts)
    assert (prior.abs().sum(dim=-1) > 0).tolist() == [False, True]
