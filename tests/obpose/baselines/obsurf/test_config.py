import pytest

from obpose.baselines.obsurf import losses
from obpose.baselines.obsurf.config import OBSURF_PROFILES
from obpose.baselines.obsurf.decoder import DEPTH
from obpose.baselines.obsurf.encoder import FIRST_OCTAVE
from obpose.baselines.obsurf.model import JITTER
from obpose.baselines.obsurf.slots import HEADS, ITERATIONS
from obpose.model.nerf.along import NEAR_SHARE
from obpose.systems import find_system

STEPS = 100_000
"""ObSuRF's training steps in ObPose's paper; published numbers of steps are shares of these here."""


@pytest.mark.parametrize("profile", OBSURF_PROFILES)
def test_whatever_the_size_these_constants_are_the_published_ones(profile: str):
    """The published values are those of the ObSuRF authors' configuration for CLEVR-3D."""
    config = find_system("obsurf").config(profile)
    loss, model, train = config.loss, config.model, config.train
    assert (losses.SIGMA_MAX, JITTER, NEAR_SHARE) == (10, 0.07, 0.98)
    assert train.clip == 1
    assert (train.decay, loss.colour_std) == ("halving", 0.2)
    assert (loss.overlap, loss.overlap_start, loss.overlap_full) == (0.05, 20_000 / STEPS, 40_000 / STEPS)
    assert (ITERATIONS, HEADS) == (5, 4)
    assert (DEPTH, model.decoder.pixel_features, FIRST_OCTAVE) == (4, True, -5)
