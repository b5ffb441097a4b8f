import math

import numpy as np
import pytest

from benchmark.commands import selftest
from benchmark.metrics import score


def test_a_wrong_metric_is_reported():
    def sloppy(*maps: np.ndarray, ignore: np.ndarray | None = None) -> dict[str, float]:
        scores = score(*maps, ignore=ignore)
        return scores | {"msc_fg": scores["msc_fg_allslots"]}

    assert "one_object_in_bg: msc_fg is 0.5714286, expected 0.5000000" in selftest.run(sloppy)


@pytest.mark.parametrize(
    ("expected", "found", "passed"),
    [
        (0.5, 0.5 + 1e-6, True),
        (0.5, 0.5 + 3e-6, False),
        (math.nan, math.nan, True),
        (1.0, math.nan, False),
        (math.nan, 1.0, False),
    ],
)
def test_what_passes(expected: float, found: float, passed: bool):
    assert selftest.Check("case", "ari", expected, found, tolerance=2e-6).passed is passed
