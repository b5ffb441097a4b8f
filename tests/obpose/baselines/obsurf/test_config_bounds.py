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
        ("model.encoder.width=10", "model.encoder.width is 10; expected a multiple of 4"),
        ("model.encoder.blocks=1,0", "model.encoder.blocks is (1, 0); expected 0 to 16, and 1 to 16"),
        ("model.last_octave=-9", "model.last_octave is -9; expected -5 to 24"),
        ("loss.overlap=-1", "loss.overlap is -1.0; expected 0 or more"),
        ("loss.overlap_full=0.1", "loss.overlap_full is 0.1; expected more than loss.overlap_start, which is 0.2"),
        ("train.warmup=9", "train.warmup is 9; expected 0, as ObSuRF has no background"),
        ("model.encoder.cell=3", "model.encoder.cell is 3; expected 2 or 4"),
        ("train.object_rays=1", "train.object_rays is 1.0; expected 0 or more, and less than 1"),
        ("train.batch=0", "train.batch is 0; expected 1 or more"),
        ("model.encoder.width=516", "model.encoder.width is 516; expected at most 512"),
        ("model.decoder.width=1025", "model.decoder.width is 1025; expected at most 1024"),
        ("model.encoder.blocks=17,1", "model.encoder.blocks is (17, 1); expected 0 to 16, and 1 to 16"),
    ],
)
def test_values_of_which_nothing_can_be_made_are_named(change: str, message: str):
    with pytest.raises(UsageError, match=re.escape(message)):
        check_obsurf_bounds(override(ObsurfConfig(), parse_changes([change], ObsurfConfig)))
