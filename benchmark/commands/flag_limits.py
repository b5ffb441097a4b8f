"""Limits of the numbers that flags of `obpose-bench` accept; numbers beyond them are mistakes."""

from dataclasses import dataclass

from benchmark.models.interface import LARGEST_LABEL
from benchmark.ranking.text import plain_number
from datagen.errors import UsageError


@dataclass(frozen=True)
class Limit:
    """Range of a flag's value."""

    low: int | float
    high: int | float
    unit: str = ""
    above_low: bool = False
    """Whether `low` itself is not allowed."""

    def admits(self, value: int | float) -> bool:
        """Tell whether a value is in the range; nan and infinity are not."""
        return self.low <= value <= self.high and not (self.above_low and value == self.low)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        low = f"more than {plain_number(self.low)}" if self.above_low else f"{plain_number(self.low)}"
        return f"{low}{' and at most' if self.above_low else ' to'} {self.high:.0f}{unit}"


LIMITS = {
    "seeds": Limit(1, 1000),
    "workers": Limit(1, 256),
    "steps": Limit(1, 10**9),
    "scenes": Limit(1, 10**6),
    "refine": Limit(0, 100_000),
    "slots": Limit(1, LARGEST_LABEL),
    "background-slot": Limit(0, LARGEST_LABEL),
    "budget": Limit(0, 31 * 24 * 3600, "seconds (31 days)", above_low=True),
    "time-limit": Limit(0, 31 * 24 * 60, "minutes (31 days)", above_low=True),
    "memory-limit": Limit(0, 2**30, "MiB", above_low=True),
}
"""Limits by the name of the flag."""


def check_flag(flag: str, value: int | float | None) -> None:
    """Check the value of a flag; None stands for a flag that was left out."""
    if value is not None and not LIMITS[flag].admits(value):
        shown = str(value) if isinstance(value, int) else plain_number(value)
        raise UsageError(f"--{flag} is {shown:.40}; expected {LIMITS[flag]}.")
