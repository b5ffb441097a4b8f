"""Check point tracks: points ride on their objects' surfaces, and are seen where the camera and the solids say."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Integer

from datagen.shapes.shape import MESH_TOLERANCE
from datagen.verify.mesh_rays import mesh_of
from datagen.verify.scene_case import Case, Finding
from datagen.verify.signals.flow import disagreements
from datagen.verify.signals.occlusion import Sight, judge

ROUNDING = 2e-6
"""Metres that rounding to float32 moves a point."""

RESERVE = 1e-2
"""Pixels that rounding moves most points in the image."""


def check_tracks(case: Case) -> Iterator[Finding]:
    """Check that points are rigid with their objects, on their surfaces, and at their places in all images."""
    if not (np.any(case.record["segmentation"]) or np.any(case.record["depth"])):
        if not np.all(case.record["tracks/occluded"]):
            yield Finding("tracks", "points are visible in a clip that shows no surface")
        return
    row = case.record["tracks/object"].astype(int) - 1
    if np.any(row >= case.count):
        yield Finding("tracks", f"a point is on object {np.max(row) + 1}, but the scene has {case.count}")
        return
    position = case.record["tracks/position_3d"].astype(np.float64)
    yield from _check_bodies(case, row, position)
    yield from _check_queries(case)
    sights, occluded = [], []
    for frame, view in case.images:
        messages, sight, hidden = _check_image(case.at(frame), frame, view, row, position[:, frame])
        for message in messages:
            yield Finding("tracks", message, frame=frame, view=view)
        sights.append(sight)
        occluded.append(hidden)
    for sight, hidden, verdicts in zip(sights, occluded, judge(case, sights), strict=True):
        for message in disagreements(verdicts, ~hidden, hidden):
            yield Finding("tracks", message, frame=sight.frame, view=sight.view)


def _check_bodies(
    case: Case, row: Integer[np.ndarray, "point"], position: Float[np.ndarray, "point frame 3"]
) -> Iterator[Finding]:
    height = np.max(np.abs(position[row < 0][..., 2]), initial=0)
    moves = np.max(np.ptp(position[row < 0], axis=1), initial=0)
    if max(height, moves) > ROUNDING:
        message = f"points of the table are up to {1e3 * height:.3f} mm off it, and move by {1e3 * moves:.3f} mm"
        yield Finding("tracks", message)
    for place, shape in enumerate(case.shapes):
        poses = case.world_from_object[:, place]
        world = position[row == place]
        if not len(world):
            continue
        local = np.einsum("pfj,fji->pfi", world - poses[:, :3, 3], poses[:, :3, :3])
        moves = np.max(np.ptp(local, axis=1))
        if moves > 2 * ROUNDING:
            yield Finding("tracks", f"points of object {place + 1} move by {1e3 * moves:.3f} mm in its frame")
        mesh = mesh_of(shape)
        distance = mesh.distance if mesh else shape.signed_distance
        off = np.max(np.abs(distance(local[:, 0])))
        if off > MESH_TOLERANCE + ROUNDING + 1e-3 * bool(case.allowed.precision.snap):
            yield Finding("tracks", f"points of object {place + 1} are up to {1e3 * off:.3f} mm off its surface")


def _check_queries(case: Case) -> Iterator[Finding]:
    query, view = case.record["tracks/query"].astype(np.float64), case.record["tracks/query_view"].astype(int)
    frame, point = query[:, 0].astype(int), np.arange(len(query))
    frames, views = case.record["segmentation"].shape[:2]
    if np.any((frame < 0) | (frame >= frames) | (view >= views)):
        yield Finding("tracks", "a query is in no image of the clip")
        return
    there = case.record["tracks/position_2d"][view, point, frame].astype(np.float64)
    if np.max(np.abs(there - query[:, [2, 1]]), initial=0) > RESERVE:
        yield Finding("tracks", "a point is not where its query is")
    if np.any(case.record["tracks/occluded"][view, point, frame]):
        yield Finding("tracks", "a point is hidden at its query")


def _check_image(
    case: Case, frame: int, view: int, row: Integer[np.ndarray, "point"], world: Float[np.ndarray, "point 3"]
) -> tuple[list[str], Sight, Bool[np.ndarray, "inner"]]:
    """Errors of the points' places in an image, and the points in it with their stored occlusion."""
    pixels, z = case.project(world, view)
    stored = case.record["tracks/position_2d"][view, :, frame].astype(np.float64)
    occluded = case.record["tracks/occluded"][view, :, frame] > 0
    before, messages = z > 0, []
    expected = np.where(before[:, None], pixels, 0)
    # Rounding moves the image of a point that is near the camera's plane farther.
    k = case.record["camera/K"][view]
    focal, principal = np.diag(k)[:2], k[:2, 2]
    reserve = np.maximum(RESERVE, ROUNDING * (focal + np.abs(expected - principal)) / np.maximum(z, 1e-9)[:, None])
    error = np.abs(stored - expected) / np.maximum(1, 1e-3 * np.abs(expected))
    if np.any(error > reserve):
        messages.append(f"points are up to {np.max(error):.3f} pixels from where their positions project")
    size = np.array(case.record["segmentation"].shape[:1:-1])
    outside = ~before | np.any((pixels < -reserve) | (pixels > size + reserve), axis=1)
    if wrong := np.count_nonzero(outside & ~occluded):
        messages.append(f"{wrong} points outside of the image count as visible")
    inner = before & np.all((pixels > reserve) & (pixels < size - reserve), axis=1)
    return messages, Sight(frame, view, row[inner], pixels[inner], z[inner]), occluded[inner]
