"""Segment the clearest frame of a clip by connected components, and follow its objects through the other frames.

Objects that touch in one frame are often apart in another. The frame with the most components is segmented; its objects
are then followed forwards and backwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from benchmark.models.classical.above_plane import standing
from benchmark.models.classical.points import Untrained, keep_largest, pixel_width, scene_points
from benchmark.models.interface import Clip, Prediction
from obpose.contact.motion.tracking import COLOUR_SCALE, Cloud, join_small, large, split, track


@dataclass
class ClipTracker(Untrained):
    """RANSAC plane removal, components of the clearest frame, tracking; implements `Segmenter`."""

    gap: float = 3.0
    """Largest gap over which components are connected, in pixel widths."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, points below it, and holes; another label is one object in the whole clip."""
        points, gap = scene_points(clip), self.gap * pixel_width(clip)
        mask = standing(clip, points, seed=self.seed)
        scaled = clip.rgb * (COLOUR_SCALE / 255)
        clouds = [Cloud(points[frame][seen], scaled[frame][seen]) for frame, seen in enumerate(mask)]
        labels = np.zeros(clip.depth.shape, np.int64)
        for frame, found in enumerate(follow_clearest(clouds, gap)):
            labels[frame][mask[frame]] = found + 1
        return Prediction(keep_largest(labels), background_slot=0)


def follow_clearest(clouds: Sequence[Cloud], gap: float) -> list[Int64[np.ndarray, "_"]]:
    """Label the points of all frames, from 0, with one label for an object over time; `gap` is in metres."""
    components = [split(cloud.points, gap) for cloud in clouds]
    key = max(range(len(clouds)), key=lambda frame: (len(large(components[frame])), len(clouds[frame].points)))
    return track(clouds, key, join_small(clouds[key].points, components[key]), gap)
