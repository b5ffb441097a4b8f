"""Amodal masks: every object as if it were alone."""

import numpy as np

from datagen.schema import SceneRecord
from datagen.signals.clip_surfaces import ClipSurfaces
from datagen.storage.run_lengths import encode_mask


def amodal_fields(clip: ClipSurfaces, rows: int) -> SceneRecord:
    """Fields of the group `amodal`; `rows` is the length of the object axis."""
    frames, views = clip.shape[:2]
    texts = [[[b""] * rows for _ in range(views)] for _ in range(frames)]
    for frame in range(frames):
        for view in range(views):
            projection = clip.projection(frame, view)
            for row in range(clip.count):
                # A renderer may draw a pixel more at an outline than the mesh covers.
                mask = clip.labels(frame, view) == row + 1
                mask[projection.covered(row)] = True
                texts[frame][view][row] = encode_mask(mask)
    return {"amodal/rle": np.array(texts, "S").reshape(frames, views, rows)}
