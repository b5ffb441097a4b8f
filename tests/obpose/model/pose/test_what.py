import torch

from obpose.config import LatentConfig
from obpose.model.pose.what import What


def test_one_latent_a_slot_and_frame_whose_first_prior_is_standard_normal():
    torch.manual_seed(0)
    what = What(10, LatentConfig(what=6, hidden=8))
    latent = what(torch.randn(2, 3, 4, 10, generator=torch.Generator().manual_seed(0)), "mean")
    assert latent.z.shape == (2, 3, 4, 6)
    assert torch.equal(latent.z, latent.mean)
    assert (latent.prior_mean[:, 0] == 0).all()
    assert (latent.prior_std[:, 0] == 1).all()
    assert latent.prior_mean[:, 1:].std() > 0
