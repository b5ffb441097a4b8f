"""Optical flow: motion of the surface point behind each pixel to the frames before and after, with its occlusion."""

import numpy as np

from datagen.schema import HIDDEN, OUTSIDE, SHOWN, UNKNOWN, SceneRecord
from datagen.signals.clip_surfaces import ClipSurfaces

MOST_FLOW = 60000.0
"""Longest stored motion along an axis, pixels; farther points are far outside of any image."""


def flow_fields(clip: ClipSurfaces) -> SceneRecord:
    """Fields of the group `flow`."""
    record: SceneRecord = {}
    for name, step in (("forward", 1), ("backward", -1)):
        flow = np.zeros((*clip.shape, 2), np.float16)
        state = np.full(clip.shape, UNKNOWN, np.uint8)
        for frame in range(clip.shape[0]):
            if 0 <= frame + step < clip.shape[0]:
                for view in range(clip.shape[1]):
                    flow[frame, view], state[frame, view] = _flow(clip, frame, view, frame + step)
        record |= {f"flow/{name}": flow, f"flow/{name}_occlusion": state}
    return record


def _flow(clip: ClipSurfaces, frame: int, view: int, other: int) -> tuple[np.ndarray, np.ndarray]:
    """Flow of one image to another frame, and its occlusion."""
    points = clip.surface(frame, view)
    world = clip.move(points, other)
    pixels, depth = clip.project(points, world, other, view)
    state = np.full(len(pixels), OUTSIDE, np.uint8)
    inside = clip.inside(pixels)
    hidden = clip.hidden(pixels[inside], depth[inside], other, view)
    state[inside] = np.where(hidden, HIDDEN, SHOWN)
    flow = np.nan_to_num(np.clip(pixels - clip.centers, -MOST_FLOW, MOST_FLOW))
    state[depth == 0] = OUTSIDE
    height, width = clip.shape[2:]
    return flow.reshape(height, width, 2).astype(np.float16), state.reshape(height, width)
