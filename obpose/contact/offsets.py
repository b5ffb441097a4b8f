"""Pairs of pixels whose affinity the network predicts."""

_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
_STEPS = (1, 3, 7)
OFFSETS = len(_DIRECTIONS) * len(_STEPS)
"""Number of partners of each pixel."""


def offsets(scale: int) -> list[tuple[int, int]]:
    """Rows and columns from a pixel to its partners, for a network trained on images with `scale` times 64 columns.

    Longer steps grow with the training images. Direct neighbours remain partners, so that all pixels are connected.
    """
    steps = [step if step == 1 else step * scale for step in _STEPS]
    return [(down * step, right * step) for step in steps for down, right in _DIRECTIONS]
