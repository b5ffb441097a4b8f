"""Pairs of pixels whose affinity the network predicts."""

OFFSETS = tuple((down * step, right * step) for step in (1, 3, 7) for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)))
"""Rows and columns from a pixel to its partners, at 64 pixels' width."""
