"""Objects that were found in single images, with one label each over time."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int64
from sklearn.metrics import adjusted_rand_score

from obpose.contact.motion.tracking import Cloud, track

KEY_FRAMES = 5
"""Number of images, evenly spread, whose objects are followed."""

Labels = list[Int64[np.ndarray, "_"]]
"""Labels of the points of each image, from 0."""


def evenly_spread(clouds: Sequence[Cloud]) -> list[int]:
    """Choose key frames among the images with points; none if fewer than two have any."""
    seen = [index for index, cloud in enumerate(clouds) if len(cloud.points)]
    places = np.linspace(0, len(seen) - 1, min(KEY_FRAMES, len(seen))).round().astype(int)
    return [seen[place] for place in places] if len(seen) > 1 else []


def follow_objects(clouds: Sequence[Cloud], objects: Labels, *, gap: float) -> Labels:
    """Follow the objects of several key frames, and keep the labels that agree best with the objects of all images.

    Agreement is the mean adjusted Rand index. Single images err independently; one in which the objects are clearly
    apart agrees with most of the others.

    Args:
        clouds: Foreground of each image, in the order of time.
        objects: Objects of its points, found in each image on its own.
        gap: Largest distance in metres of neighbouring points of a new object; points of no followed object start one.
    """
    candidates = [track(clouds, key, objects[key], gap) for key in evenly_spread(clouds)] or [objects]

    def agreement(found: Labels) -> float:
        pairs = [pair for pair in zip(objects, found, strict=True) if len(pair[0])]
        return float(np.mean([adjusted_rand_score(*pair) for pair in pairs])) if pairs else 0.0

    return max(candidates, key=agreement)
