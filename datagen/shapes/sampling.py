"""Help for drawing the parameters of shapes."""

from typing import Any

import numpy as np

from datagen.shapes.shape import MESH_TOLERANCE

Size = tuple[float, float]
"""Least and greatest longest side, metres."""

DECIMALS = 6
"""Parameters are multiples of a micrometre, so that they are short in files and equal after reading back."""


def longest(rng: np.random.Generator, size: Size) -> float:
    """A longest side within `size`, metres; leaves room for rounded parameters and for the mesh's tolerance."""
    room = min(3 * MESH_TOLERANCE, 0.5 * (size[1] - size[0]))
    return rng.uniform(size[0] + room, size[1] - room)


def draw(rng: np.random.Generator, **values: float | tuple[float, float]) -> dict[str, float]:
    """Draw a number from each range, in their order; single numbers are kept."""
    return {name: rng.uniform(*value) if isinstance(value, tuple) else value for name, value in values.items()}


def rounded(parameters: dict[str, Any], scale: float = 1.0) -> dict[str, Any]:
    """Parameters as plain values: floats and lists times `scale` (metres) and rounded, counts and names as they are."""
    return {name: value if isinstance(value, int | str) else _plain(value, scale) for name, value in parameters.items()}


def _plain(value: Any, scale: float) -> Any:
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item, scale) for item in value]
    return round(float(value) * scale, DECIMALS)
