import math
import re

import pytest

from benchmark.commands.flag_limits import LIMITS, check_flag
from datagen.errors import UsageError


@pytest.mark.parametrize(
    ("flag", "value"), [("seeds", 1), ("seeds", 1000), ("budget", 0.5), ("refine", 0), ("steps", None)]
)
def test_values_within_limits_are_accepted(flag: str, value: float | None):
    check_flag(flag, value)


@pytest.mark.parametrize(
    ("flag", "value", "message"),
    [
        ("seeds", 10**9, "--seeds is 1000000000; expected 1 to 1000."),
        ("seeds", 0, "--seeds is 0; expected 1 to 1000."),
        ("workers", 257, "--workers is 257; expected 1 to 256."),
        ("slots", 10**6, "--slots is 1000000; expected 1 to 255."),
        ("scenes", 10**12, "--scenes is 1000000000000; expected 1 to 1000000."),
        ("background-slot", -1, "--background-slot is -1; expected 0 to 255."),
        ("budget", math.nan, "--budget is nan; expected more than 0 and at most 2678400 seconds (31 days)."),
        ("budget", math.inf, "--budget is inf; expected more than 0"),
        ("budget", -5.0, "--budget is -5; expected more than 0"),
        ("budget", 0.0, "--budget is 0; expected more than 0"),
        ("time-limit", 1e9, "--time-limit is 1000000000; expected more than 0 and at most 44640 minutes (31 days)."),
        ("time-limit", -math.inf, "--time-limit is -inf; expected more than 0"),
        ("memory-limit", 1e30, "and at most 1073741824 MiB."),
        ("steps", 10**100, "--steps is 1000"),
    ],
)
def test_values_beyond_are_refused_with_the_limit(flag: str, value: float, message: str):
    with pytest.raises(UsageError, match=re.escape(message)) as error:
        check_flag(flag, value)
    assert len(str(error.value)) < 150


def test_limits_are_in_order():
    assert all(limit.low < limit.high for limit in LIMITS.values())
