"""Numbers as people read them: rounded, without exponents, and never 0.000 for what is known to differ from 0."""

import math
from collections.abc import Callable, Iterable

FEWEST_DECIMALS, MOST_DECIMALS = 3, 6


def plain_number(value: int | float, digits: int = 4) -> str:
    """Round to so many significant digits, larger numbers to whole ones, and write the number without an exponent.

    >>> [plain_number(value) for value in (13740.0, 0.00012346, 1e6, 2.5)]
    ['13740', '0.0001235', '1000000', '2.5']
    """
    if not math.isfinite(value) or not value:
        return f"{value:z.0f}"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:z.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def decimals_that_show(values: Iterable[float], is_shown: Callable[[float, float], bool]) -> int:
    """Find the fewest decimals, from 3 to 6, with which rounding keeps what matters about every value.

    Args:
        values: Numbers that are printed with the same number of decimals.
        is_shown: Tells whether a rounded value still says what its exact value, the second argument, says.

    >>> decimals_that_show([0.00031], lambda rounded, exact: bool(rounded) == bool(exact))
    4
    """
    known = [value for value in values if math.isfinite(value)]
    for decimals in range(FEWEST_DECIMALS, MOST_DECIMALS):
        if all(is_shown(round(value, decimals), value) for value in known):
            return decimals
    return MOST_DECIMALS
