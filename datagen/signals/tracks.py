"""Point tracks: surface points followed through the clip in all views, with their visibility (TAP-Vid's layout)."""

import numpy as np
from jaxtyping import Float, Int

from datagen.schema import SceneRecord
from datagen.signals.clip_surfaces import NOTHING, ClipSurfaces, Points

TRACKS = 256
"""Number of points tracked in each scene. If no image shows a surface, they are zeros and occluded everywhere."""

TABLE_SHARE = 0.25
"""Share of the points that lie on the table where there are objects; the rest is divided evenly among the objects."""


def track_fields(clip: ClipSurfaces, rng: np.random.Generator) -> SceneRecord:
    """Fields of the group `tracks`; `rng` chooses the points."""
    frames, views = clip.shape[:2]
    # Points on the surfaces that the chosen pixels show.
    images = _choose(clip, rng)
    if not len(images):
        return _no_tracks(frames, views)
    count = len(images)
    points, pixels = _points(clip, images, images[:, 2:] + rng.random((count, 2)))
    position_2d = np.zeros((views, count, frames, 2), np.float32)
    position_3d = np.zeros((count, frames, 3), np.float32)
    occluded = np.ones((views, count, frames), np.uint8)
    # Their places in every frame, and whether a view sees them there.
    for frame in range(frames):
        world = clip.move(points, frame)
        position_3d[:, frame] = world
        for view in range(views):
            places, depth = clip.project(points, world, frame, view)
            inside = (depth > 0) & clip.inside(np.nan_to_num(places, nan=-1.0))
            hidden = clip.hidden(places[inside], depth[inside], frame, view)
            occluded[view, inside, frame] = hidden
            position_2d[view, :, frame] = np.nan_to_num(places)
    return {
        "tracks/object": np.maximum(points.row + 1, 0).astype(np.uint8),
        "tracks/query": np.stack([images[:, 0], pixels[:, 1], pixels[:, 0]], axis=1).astype(np.float32),
        "tracks/query_view": images[:, 1].astype(np.uint16),
        "tracks/position_2d": position_2d,
        "tracks/occluded": occluded,
        "tracks/position_3d": position_3d,
    }


def _no_tracks(frames: int, views: int) -> SceneRecord:
    """Fields of a clip that shows no surface, of the shapes that all scenes have."""
    return {
        "tracks/object": np.zeros(TRACKS, np.uint8),
        "tracks/query": np.zeros((TRACKS, 3), np.float32),
        "tracks/query_view": np.zeros(TRACKS, np.uint16),
        "tracks/position_2d": np.zeros((views, TRACKS, frames, 2), np.float32),
        "tracks/occluded": np.ones((views, TRACKS, frames), np.uint8),
        "tracks/position_3d": np.zeros((TRACKS, frames, 3), np.float32),
    }


def _choose(clip: ClipSurfaces, rng: np.random.Generator) -> Int[np.ndarray, "point 4"]:
    """Choose pixels as frame, view, x and y: evenly among the objects, from all images that show them."""
    groups = [np.flatnonzero(clip.segmentation == row + 1) for row in range(clip.count)]
    table = np.flatnonzero((clip.segmentation == 0) & (clip.depth > 0))
    groups = [group for group in groups if len(group)]
    shares = np.full(len(groups), (1 - TABLE_SHARE) / max(1, len(groups)))
    if len(table):
        groups, shares = [*groups, table], np.append(shares, TABLE_SHARE if groups else 1.0)
    if not groups:
        return np.zeros((0, 4), int)
    ends = np.rint(np.cumsum(shares / np.sum(shares)) * TRACKS).astype(int)
    numbers = np.diff(ends, prepend=0)
    chosen = np.concatenate([rng.choice(group, count) for group, count in zip(groups, numbers, strict=True)])
    frame, view, y, x = np.unravel_index(chosen, clip.shape)
    return np.stack([frame, view, x, y], axis=1)


def _points(
    clip: ClipSurfaces, images: Int[np.ndarray, "point 4"], pixels: Float[np.ndarray, "point 2"]
) -> tuple[Points, Float[np.ndarray, "point 2"]]:
    """Surface points at the chosen places, and these places: pixels' centres where the backdrop lies beside them."""
    row, local, normal = np.zeros(len(images), int), np.zeros((len(images), 3)), np.zeros((len(images), 3))
    pixels = pixels.copy()
    for frame, view in np.unique(images[:, :2], axis=0).tolist():
        own = np.flatnonzero(np.all(images[:, :2] == [frame, view], axis=1))
        row[own] = clip.row_at(frame, view, pixels[own])
        beside = own[row[own] == NOTHING]
        pixels[beside] = images[beside, 2:] + 0.5
        row[beside] = clip.rows(frame, view).reshape(clip.shape[2:])[images[beside, 3], images[beside, 2]]
        points = clip.points_at(frame, view, pixels[own], row[own])
        local[own], normal[own] = points.local, points.normal
    return Points(row, local, normal), pixels
