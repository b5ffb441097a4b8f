"""Limits of the numbers that flags of `obpose-bench` accept; numbers beyond them are mistakes."""

from benchmark.models.interface import LARGEST_LABEL
from benchmark.ranking.text import plain_number
from datagen.errors import UsageError

LIMITS: dict[str, tuple[float, float]] = {
    "seeds": (1, 1000),
    "workers": (1, 256),
    "steps": (1, 10**9),
    "scenes": (1, 10**6),
    "refine": (0, 100_000),
    "slots": (1, LARGEST_LABEL),
    "background-slot": (0, LARGEST_LABEL),
    "budget": (0.001, 31 * 24 * 3600),
    "time-limit": (0.001, 31 * 24 * 60),
    "memory-limit": (1, 2**30),
}
"""Smallest and largest value by the name of the flag, in the flag's unit."""


def check_flag(flag: str, value: float | None) -> None:
    """Check the value of a flag; None stands for a flag that was left out.

    Raises:
        UsageError: the value is out of range; states the range.
    """
    low, high = LIMITS[flag]
    if value is not None and not low <= value <= high:  # also nan
        shown = str(value) if isinstance(value, int) else plain_number(value)
        raise UsageError(f"--{flag} is {shown:.40}; expected {plain_number(low)} to {plain_number(high)}.")
