import pytest

from obpose.baselines.obsurf.config import OBSURF_PROFILES
from obpose.systems import find_system

STEPS = 100_000
"""That ObPose's authors make with ObSuRF; of these the published numbers of steps are shares here."""


@pytest.mark.parametrize("profile", OBSURF_PROFILES)
def test_whatever_the_size_these_constants_are_the_published_ones(profile: str):
    """Of the ObSuRF authors' code, in its configuration for CLEVR-3D."""
    config = find_system("obsurf").config(profile)
    loss, model, train = config.loss, config.model, config.train
    assert model.sigma_max == 10
    assert train.clip == 1
    assert (train.decay, train.half_life) == ("halving", 100_000 / STEPS)
    assert (loss.overlap, loss.overlap_start, loss.overlap_full) == (0.05, 20_000 / STEPS, 40_000 / STEPS)
    assert (loss.colour, loss.surface, loss.air, loss.colour_std) == (1, 1, 1, 0.2)
    assert (loss.jitter, loss.near_share) == (0.07, 0.98)
    assert (model.attention.iterations, model.attention.heads) == (5, 4)
    assert (model.decoder.depth, model.decoder.pixel_features, model.first_octave) == (4, True, -5)
