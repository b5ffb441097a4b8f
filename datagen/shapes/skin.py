"""Colours of a mesh: textures as pyramids of ever coarser images, and colours of vertices."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int, UInt8


@dataclass(frozen=True, eq=False)
class Skin:
    """Colour of every point of a mesh: the texture's, times the colour between the corners of the face."""

    uv: Float32[np.ndarray, "face 3 2"]
    """Texture coordinates of each face's corners; (0, 0) is the upper left corner; textures repeat."""
    colors: Float32[np.ndarray, "face 3 3"]
    """Linear RGB of each face's corners."""
    texture: Int[np.ndarray, "face"]
    """Texture of each face."""
    density: Float32[np.ndarray, "face"]
    """Texels per metre of each face at level 0 of its texture."""
    pyramids: tuple[tuple[UInt8[np.ndarray, "_ _ 3"], ...], ...]
    """Levels of each texture, sRGB; every level has half the size of the one before."""
    mean: tuple[float, float, float]
    """Mean colour of the surface, sRGB in 0..1."""
