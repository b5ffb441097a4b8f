"""Objects of a clip from the groups of its single images: those of one frame, followed through the others."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64
from sklearn.metrics import adjusted_rand_score

from obpose.contact.tracking import COLOUR_SCALE, Cloud, track

KEY_FRAMES = 5
"""Number of frames, evenly spread, whose objects are followed."""


class Frame(NamedTuple):
    """One image of a clip."""

    mask: Bool[np.ndarray, "height width"]
    """Foreground."""
    groups: Int64[np.ndarray, "height width"]
    """Objects of this image, from 1; 0 outside the mask."""
    points: Float[np.ndarray, "height width 3"]
    """Metres, in the same frame of reference for all images."""
    rgb: Float[np.ndarray, "height width 3"]
    """0 to 1."""


def segment_frames(images: Sequence[Frame], *, gap: float) -> Int64[np.ndarray, "frame height width"]:
    """Follow the groups of several key frames, and keep the labels that agree best with the groups of all frames.

    Agreement is the mean adjusted Rand index. Groups of single images err independently; a frame in which the objects
    are clearly apart agrees with most of the others.

    Args:
        images: Images in the order of time.
        gap: Points that belong to no followed object start new ones, connected if at most so many metres apart.

    Returns:
        Labels from 1, one for an object over time; 0 outside the masks.
    """
    clouds = [Cloud(image.points[image.mask], COLOUR_SCALE * image.rgb[image.mask]) for image in images]
    groups = [image.groups[image.mask] for image in images]
    seen = [frame for frame, cloud in enumerate(clouds) if len(cloud.points)]
    labels = np.zeros((len(images), *images[0].mask.shape), np.int64)
    if not seen:
        return labels
    keys = np.unique(np.linspace(0, len(seen) - 1, min(KEY_FRAMES, len(seen))).round().astype(int))
    candidates = [track(clouds, seen[key], groups[seen[key]] - 1, gap) for key in keys]

    def agreement(found: list[np.ndarray]) -> float:
        return float(np.mean([adjusted_rand_score(groups[frame], found[frame]) for frame in seen]))

    for frame, found in enumerate(max(candidates, key=agreement)):
        labels[frame, images[frame].mask] = found + 1
    return labels
