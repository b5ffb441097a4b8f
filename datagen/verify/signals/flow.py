"""Check optical flow against stored depth, stored poses and the exact solids."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from datagen.schema import DEPTH_SCALE, HIDDEN, OUTSIDE, SHOWN, UNKNOWN
from datagen.verify.scene_case import Case, Finding
from datagen.verify.signals.occlusion import Sight, Verdicts, judge

STEPS = 0.7
"""Steps of depth that stored depth may be off, see `datagen.verify.pixels.SURFACE_STEPS`."""

HALF = 2.0**-11
"""Relative rounding of float16."""

RESERVE = 2e-3
"""Pixels that flow may be off for other reasons: poses are stored in float32."""

FARTHEST = 1000.0
"""Pixels from which a point may lie so close to the camera's plane that rounding decides where it is."""

MOST_AT_ONCE = 300_000
"""Points whose occlusion is decided at once, so that memory is bounded."""

SHARE, FEW = 0.02, 3
"""Share and number of an image's pixels in which a renderer that moves corners sideways, or the last millimetre before
a surface, may decide otherwise."""


def check_flow(case: Case) -> Iterator[Finding]:
    """Check that flow follows from stored poses and depth, and occlusion from the solids."""
    for name, step in (("forward", 1), ("backward", -1)):
        pending: list[Pending] = []
        for frame, view in case.images:
            for found in _check_image(case, name, frame, view, frame + step):
                if isinstance(found, str):
                    yield Finding("flow", f"{name}: {found}", frame=frame, view=view)
                else:
                    pending.append(found)
            if sum(len(image.sight.row) for image in pending) > MOST_AT_ONCE:
                yield from _check_occlusion(case, name, pending)
                pending = []
        yield from _check_occlusion(case, name, pending)


@dataclass(frozen=True, eq=False)
class Pending:
    """Occlusion of an image's points in another frame, to be checked together with that of other images."""

    frame: int
    sight: Sight
    state: Integer[np.ndarray, "point"]


def _check_image(case: Case, name: str, frame: int, view: int, other: int) -> Iterator[str | Pending]:
    flow = case.record[f"flow/{name}"][frame, view].reshape(-1, 2).astype(np.float64)
    state = case.record[f"flow/{name}_occlusion"][frame, view].ravel()
    # A flow beyond the clip is 0 and unknown.
    if not 0 <= other < case.record["segmentation"].shape[0]:
        if np.any(flow != 0) or np.any(state != UNKNOWN):
            yield "there is no such frame, but a flow to it"
        return
    if np.any(state >= UNKNOWN):
        yield f"{np.count_nonzero(state >= UNKNOWN)} pixels have no flow, but there is such a frame"
    # Expected flow from depth and poses, and its change by one step of depth.
    depth = case.depth(frame, view).ravel()
    row = np.where(depth > 0, case.segmentation(frame, view).ravel().astype(int) - 1, -2)
    pixels, z = _moved(case, frame, other, view, row, depth)
    shifted, _ = _moved(case, frame, other, view, row, depth + DEPTH_SCALE)
    height, width = case.record["segmentation"].shape[2:]
    start = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1).reshape(-1, 2)
    before = z > 0
    expected = np.where(before[:, None], pixels - start, 0)
    allowed = np.where(before[:, None], STEPS * np.abs(shifted - pixels), 0) + HALF * np.abs(expected) + RESERVE
    error = np.where(np.max(np.abs(expected), axis=1) < FARTHEST, np.max(np.abs(flow - expected) - allowed, axis=1), 0)
    if np.count_nonzero(error > 0) > (FEW + int(SHARE * len(error)) if case.allowed.precision.snap else 0):
        worst = np.argmax(error)
        yield (
            f"{np.count_nonzero(error > 0)} of {len(error)} pixels are off, by up to "
            f"{np.max(np.abs(flow[worst] - expected[worst])):.3f} pixels (allowed {np.max(allowed[worst]):.3f})"
        )
    # Targets clearly inside or outside of the image have that state.
    margin, size = np.max(allowed, axis=1)[:, None], np.array([width, height])
    inner = before & np.all((pixels > margin) & (pixels < size - margin), axis=1)
    outer = ~before | np.any((pixels < -margin) | (pixels > size + margin), axis=1)
    wrong = (inner & (state == OUTSIDE)) | (outer & (state != OUTSIDE))
    if np.any(wrong):
        yield f"{np.count_nonzero(wrong)} pixels are in the image where they should be outside, or the reverse"
    yield Pending(frame, Sight(other, view, row[inner], pixels[inner], z[inner]), state[inner])


def _check_occlusion(case: Case, name: str, pending: Sequence[Pending]) -> Iterator[Finding]:
    if not pending:
        return
    for image, verdicts in zip(pending, judge(case, [image.sight for image in pending]), strict=True):
        for message in disagreements(verdicts, image.state == SHOWN, image.state == HIDDEN):
            yield Finding("flow", f"{name}: {message}", frame=image.frame, view=image.sight.view)


def _moved(
    case: Case,
    frame: int,
    other: int,
    view: int,
    row: Integer[np.ndarray, "pixel"],
    depth: Float[np.ndarray, "pixel"],
) -> tuple[Float[np.ndarray, "pixel 2"], Float[np.ndarray, "pixel"]]:
    """Image position and depth in another frame of the points at some depth behind each pixel of an image."""
    now, then = case.at(frame), case.at(other)
    rays = now.rays[view].reshape(-1, 3)
    points = np.where(row[:, None] == -2, rays, now.center(view) + depth[:, None] * rays)
    for place in range(case.count):
        own = row == place
        start, end = case.world_from_object[frame, place], case.world_from_object[other, place]
        points[own] = (points[own] - start[:3, 3]) @ start[:3, :3] @ end[:3, :3].T + end[:3, 3]
    # The backdrop is infinitely far away: only its direction counts.
    points = np.where(row[:, None] == -2, then.center(view) + points, points)
    pixels, z = then.project(points, view)
    return pixels, np.where((row == -2) & (z > 0), np.inf, z)


def disagreements(
    verdicts: Verdicts, shown: Bool[np.ndarray, "point"], hidden: Bool[np.ndarray, "point"]
) -> Iterator[str]:
    """Describe stored occlusion that the exact solids contradict in more than a few points."""
    for wrong, sure, what in (
        (verdicts.hidden & shown, verdicts.hidden, "shown, but lie behind a surface"),
        (verdicts.shown & hidden, verdicts.shown, "hidden, but nothing lies in front of them"),
    ):
        if np.count_nonzero(wrong) > FEW + int(SHARE * np.count_nonzero(sure)):
            yield f"{np.count_nonzero(wrong)} of {np.count_nonzero(sure)} points count as {what}"
