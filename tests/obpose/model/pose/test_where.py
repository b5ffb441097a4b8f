import torch

from obpose.config import LatentConfig, ModelConfig, PoseConfig
from obpose.model.layers.latent import LATENT
from obpose.model.pose.encoder import ObjectEncoder
from obpose.model.pose.where import Where
from tests.obpose.model.pose.clouds import crop, half_a_cube, table

CODE = ObjectEncoder(4, LatentConfig()).size


def where(max_translation: float = 0.05) -> Where:
    torch.manual_seed(0)
    return Where(CODE, ModelConfig(pose=PoseConfig(max_translation=max_translation)))


def test_translations_stay_within_their_maximum_and_reach_it():
    z = 1e4 * torch.randn(4, 2, 3, LATENT, generator=torch.Generator().manual_seed(0))
    largest = where(0.03).translation(z).abs().max()
    torch.testing.assert_close(largest, torch.tensor(0.03))


def test_a_small_latent_is_translated_in_proportion_to_the_maximum():
    z = 0.1 * torch.randn(1, 1, 1, LATENT, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(where(0.1).translation(z), 2 * where(0.05).translation(z))


def test_the_translation_trains_the_encoder():
    torch.manual_seed(0)
    encoder, module = ObjectEncoder(4, LatentConfig()), where()
    latent = module(encoder(crop(half_a_cube(0.025), table(0.025))), "sample", torch.Generator().manual_seed(0))
    assert latent.z.shape == (1, 1, 1, LATENT)
    corrected = torch.zeros(3) + module.translation(latent.z)
    corrected.square().sum().backward()
    for name, parameter in encoder.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


def test_the_first_prior_is_standard_normal():
    latent = where()(torch.ones(1, 2, 3, CODE), "mean")
    assert (latent.prior_mean[:, 0] == 0).all()
    assert (latent.prior_std[:, 0] == 1).all()
