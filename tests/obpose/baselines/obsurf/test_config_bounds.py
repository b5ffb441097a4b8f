import re

import pytest

from obpose.baselines.obsurf.config import ObsurfConfig
from obpose.baselines.obsurf.config_bounds import check_obsurf_bounds
from obpose.config import override
from obpose.config_text import parse_changes
from obpose.errors import UsageError


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("model.slots=0", "model.slots is 0; expected 1 or more"),
        ("model.encoder.width=10", "model.encoder.width is 10; expected a multiple of 4 and of model.attention.heads"),
        ("model.attention.heads=5", "model.encoder.width is 48; expected a multiple of 4 and of model.attention.heads"),
        ("model.encoder.blocks=1,0", "model.encoder.blocks is (1, 0); expected 0 to 16, and 1 to 16"),
        ("model.sigma_max=0", "model.sigma_max is 0.0; expected more than 0"),
        ("model.last_octave=-9", "model.last_octave is -9; expected at least model.first_octave, which is -5"),
        ("loss.overlap=-1", "loss.overlap is -1.0; expected 0 or more"),
        ("loss.overlap_full=0.1", "loss.overlap_full is 0.1; expected more than loss.overlap_start, which is 0.2"),
        ("loss.near_share=1", "loss.near_share is 1.0; expected between 0 and 1"),
        ("train.warmup=9", "train.warmup is 9; expected 0, as ObSuRF has no background"),
        ("model.encoder.cell=3", "model.encoder.cell is 3; expected 2 or 4"),
        ("train.object_rays=1", "train.object_rays is 1.0; expected 0 or more, and less than 1"),
        ("train.half_life=0", "train.half_life is 0.0; expected more than 0"),
        ("train.batch=0", "train.batch is 0; expected 1 or more"),
        ("model.encoder.width=516", "model.encoder.width is 516; expected at most 512"),
        ("model.decoder.width=1025", "model.decoder.width is 1025; expected at most 1024"),
        ("model.decoder.depth=17", "model.decoder.depth is 17; expected at most 16"),
        ("model.attention.iterations=101", "model.attention.iterations is 101; expected at most 100"),
        ("model.first_octave=-25", "model.first_octave is -25; expected -24 or more"),
        ("model.encoder.blocks=17,1", "model.encoder.blocks is (17, 1); expected 0 to 16, and 1 to 16"),
    ],
)
def test_values_of_which_nothing_can_be_made_are_named(change: str, message: str):
    with pytest.raises(UsageError, match=re.escape(message)):
        check_obsurf_bounds(override(ObsurfConfig(), parse_changes([change], ObsurfConfig)))
