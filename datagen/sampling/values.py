"""Numbers as a scene's description holds them."""

from collections.abc import Iterable

from datagen.scene import Vector

DIGITS = 6
"""Decimals that a scene's numbers keep, so that its text stays short."""


def rounded(value: float) -> float:
    """A plain float of few digits."""
    return round(float(value), DIGITS)


def vector(values: Iterable[float]) -> Vector:
    """Three such floats."""
    x, y, z = (rounded(value) for value in values)
    return x, y, z
