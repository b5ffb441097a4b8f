"""Rounded numbers for a scene's description."""

from collections.abc import Iterable

from datagen.scene import Vector

DIGITS = 6
"""Decimals that a scene's numbers keep, so that its text stays short."""


def rounded(value: float) -> float:
    """Round a number to the digits of a scene's description."""
    return round(float(value), DIGITS)


def vector(values: Iterable[float]) -> Vector:
    """Round three numbers, see `rounded`."""
    x, y, z = (rounded(value) for value in values)
    return x, y, z
