"""Guess the unit and the upward axis of a mesh file, and say why."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

Unit = Literal["m", "cm", "mm", "in"]
Up = Literal["x", "y", "z"]

METRES: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
"""Metres of each unit."""

SMALLEST, LARGEST = 0.005, 0.30
"""Longest sides that are reported as too small and too large for a table, metres."""

_METRES = (0.005, 0.5)
"""Longest sides that are taken for metres."""
_MILLIMETRES = (20.0, 500.0)
"""Longest sides that are taken for millimetres."""


@dataclass(frozen=True)
class Guess:
    """A unit with its reason."""

    unit: Unit
    reason: str
    certain: bool = True
    """Whether the unit could be inferred; otherwise `unit` is only the better guess."""


def guess_unit(suffix: str, longest: float) -> Guess:
    """Unit of a file whose longest side has the given length in the file's units."""
    if suffix == ".glb":
        return Guess("m", "glTF is in metres")
    if _METRES[0] <= longest <= _METRES[1]:
        return Guess("m", f"longest side {longest:.3g}")
    if _MILLIMETRES[0] <= longest <= _MILLIMETRES[1]:
        return Guess("mm", f"longest side {longest:.3g}")
    return Guess("m" if longest < 5 else "mm", f"longest side {longest:.3g} fits neither m nor mm", certain=False)


def guess_up(suffix: str) -> Up:
    """Upward axis of a file: y in glTF, z in all others."""
    return "y" if suffix == ".glb" else "z"


def rotation_to_z(up: Up) -> Float[np.ndarray, "3 3"]:
    """Rotation that turns an upward axis to z."""
    if up == "y":
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    if up == "x":
        return np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    return np.eye(3)
