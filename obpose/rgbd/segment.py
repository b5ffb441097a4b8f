"""Segmentation of a user's frames in full resolution."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int, Integer, UInt8
from scipy.spatial import KDTree

from obpose.contact.clip import CAUTION, MOST_OBJECTS, LabelledImage, segment_clip
from obpose.geometry import unproject
from obpose.rgbd.frames import PreparedFrames, Trained
from obpose.types import Observation

Labels = Int[np.ndarray, "frame height width"]
Method = Callable[[Observation], Labels]
"""Function that labels the objects of a batch of one clip with one view; 0 is the background."""
UNTRAINED = Trained(spacing=0.006, learned=False)
"""Pixel spacing that methods without training get."""
GAP = 0.06
"""Largest distance in metres of neighbouring points of a new object of a video."""
BIAS = -CAUTION
"""Bias of joining parts of a video: with this one they are one object if most frames say so, unless they move apart."""
LEAST_SHARE = 4e-4
"""Segments that have a smaller share of the pixels in every frame are noise: 123 pixels of 640x480."""
NEAR = 3.0
"""Pixels farther from all reduced points than this many spacings of them are background."""
LEAST_HEIGHT = 0.5
"""Height in terms of the workspace's floor below which pixels are background whatever the method says."""
LEAST_STANDING = 0.25
"""Segments with a smaller share of pixels above the floor are noise of the table."""


def segment_frames(
    frames: PreparedFrames, method: Method, *, video: bool = False, most: int = MOST_OBJECTS
) -> UInt8[np.ndarray, "frame height width"]:
    """Label the objects of all frames in full resolution, at most `most` of them, from 1 by decreasing size.

    The method sees the reduced frames; with `video`, one by one (`obpose.contact.clip`). Each pixel of the full frames
    above the table then gets the label of the nearest reduced point in space. So the outlines are those of the depth
    image.
    """
    points = [unproject(frames.still(frame)).numpy()[0, 0, 0] for frame in range(len(frames.recording.depth))]
    labels = _followed(frames, method, points, most) if video else method(frames.observation)
    labels = _largest(labels, MOST_OBJECTS)
    refined = [_refined(frames, frame, *pair) for frame, pair in enumerate(zip(labels, points, strict=True))]
    return _largest(np.stack(refined), most)


def _followed(frames: PreparedFrames, method: Method, points: Sequence[np.ndarray], most: int) -> Labels:
    """Label each frame on its own, and join the largest objects over the video in the world frame."""
    images = []
    for frame, places in enumerate(points):
        still = frames.still(frame)
        found = _largest(np.where(still.valid[:, 0, 0].numpy(), method(still), 0), most)[0].astype(np.int64)
        images.append(LabelledImage(found > 0, places, still.rgb[0, 0, 0].numpy(), found[found > 0] - 1))
    return segment_clip(images, bias=BIAS, gap=GAP)


def _refined(frames: PreparedFrames, frame: int, labels: np.ndarray, points: np.ndarray) -> np.ndarray:
    full = frames.points(frame)
    depth = frames.recording.depth[frame]
    standing = frames.workspace.standing(full, depth, share=LEAST_HEIGHT) & (depth > 0)
    found = np.zeros(standing.shape, np.uint8)
    seen = frames.observation.valid[0, frame, 0].numpy()
    if not (labels[seen] > 0).any() or not standing.any():
        return found
    # Spacing of the reduced points, which depends on their distance from the camera.
    spacing = frames.every * np.median(depth[standing]) / frames.recording.k[0, 0]
    distance, nearest = KDTree(points[seen]).query(full[standing], distance_upper_bound=NEAR * spacing)
    near = np.isfinite(distance)
    found[standing] = np.where(near, labels[seen][np.where(near, nearest, 0)], 0)
    # Bumps of the table are low.
    masks = (standing, frames.workspace.standing(full, depth))
    sizes, high = (np.bincount(found[mask], minlength=256) for mask in masks)
    return np.where((high >= LEAST_STANDING * sizes)[found], found, 0).astype(np.uint8)


def _largest(labels: Integer[np.ndarray, "frame height width"], most: int) -> UInt8[np.ndarray, "frame height width"]:
    """Number objects from 1 by decreasing size; specks lose their label, and so do all but the largest ones."""
    names, inverse = np.unique(labels, return_inverse=True)
    sizes = np.stack([np.bincount(frame, minlength=len(names)) for frame in inverse.reshape(len(labels), -1)])
    # An object may be visible in a few frames only.
    large = (names > 0) & (sizes.max(axis=0) >= LEAST_SHARE * labels[0].size)
    order = [place for place in np.argsort(-sizes.sum(axis=0), kind="stable") if large[place]][:most]
    new = np.zeros(len(names), np.uint8)
    new[order] = np.arange(1, len(order) + 1)
    return new[inverse].reshape(labels.shape)
