"""PNG files of exports."""

from pathlib import Path

import numpy as np
from jaxtyping import Shaped


def write_png(path: Path, image: Shaped[np.ndarray, "height width *channel"]) -> None:
    """Write an 8-bit colour image, or an 8-bit or 16-bit image of one channel; its folder is created."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path, compress_level=4)


def depth_units(depth: np.ndarray, metres_per_unit: float) -> np.ndarray:
    """Convert metres to 16-bit units; depths beyond the greatest unit have no return (0)."""
    units = np.rint(depth.astype(np.float64) / metres_per_unit)
    return np.where(units <= np.iinfo(np.uint16).max, units, 0).astype(np.uint16)
