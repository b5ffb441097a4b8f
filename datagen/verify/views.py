"""Views of one moment against each other: no shapes, no poses, only pixels and cameras."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Integer

from datagen.verify.case import Case
from datagen.verify.finding import Finding

FRONT_TOLERANCE = 2e-3
"""Metres by which a point of one view may lie in front of all that another view shows around it."""

SAME_SURFACE = 1e-3
"""Metres within which two views see the same surface."""

SHARE = 0.01
"""Share of points that may disagree: thin edges that fall between pixels, and crevices where objects touch."""

NEIGHBOURS = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]


def check_views(case: Case) -> Iterator[Finding]:
    """Points that one view sees are hidden or seen, never in front, in every other view of the same moment."""
    frames, views = case.record["segmentation"].shape[:2]
    pairs = [(a, b) for a in range(views) for b in range(views) if a != b]
    for frame in range(frames):
        for a, b in pairs:
            yield from _check_pair(case, frame, a, b)


def _check_pair(case: Case, frame: int, a: int, b: int) -> Iterator[Finding]:
    depth, labels = case.depth(frame, a), case.segmentation(frame, a)
    seen = depth > 0
    points = case.center(a) + depth[seen, None] * case.rays[a][seen]
    pixels, z = case.project(points, b)
    height, width = depth.shape
    column, row = np.floor(pixels[:, 0]).astype(int), np.floor(pixels[:, 1]).astype(int)
    inner = (z > 0) & (row >= 1) & (row < height - 1) & (column >= 1) & (column < width - 1)
    around = (row[inner], column[inner])
    nearest, farthest = _depth_range(case.depth(frame, b), around)
    front = nearest - z[inner] > FRONT_TOLERANCE
    yield from _share(front, "lie in front of what it shows", frame, a, b)
    label, uniform = _uniform_label(case.segmentation(frame, b), around)
    same = uniform & (z[inner] >= nearest - SAME_SURFACE) & (z[inner] <= farthest + SAME_SURFACE)
    yield from _share((labels[seen][inner] != label)[same], "carry another label there", frame, a, b)


def _depth_range(
    depth: Float[np.ndarray, "height width"], around: tuple[Integer[np.ndarray, "point"], Integer[np.ndarray, "point"]]
) -> tuple[Float[np.ndarray, "point"], Float[np.ndarray, "point"]]:
    """Least and greatest depth of the nine pixels around each point; nothing returned counts as infinitely far."""
    far = np.where(depth > 0, depth, np.inf)
    block = np.stack([far[around[0] + dy, around[1] + dx] for dy, dx in NEIGHBOURS])
    return np.min(block, axis=0), np.max(block, axis=0)


def _uniform_label(
    labels: Integer[np.ndarray, "height width"],
    around: tuple[Integer[np.ndarray, "point"], Integer[np.ndarray, "point"]],
) -> tuple[Integer[np.ndarray, "point"], Bool[np.ndarray, "point"]]:
    """Label of the pixel at each point, and whether its eight neighbours share it."""
    block = np.stack([labels[around[0] + dy, around[1] + dx] for dy, dx in NEIGHBOURS])
    return block[4], np.min(block, axis=0) == np.max(block, axis=0)


def _share(wrong: Bool[np.ndarray, "point"], what: str, frame: int, a: int, b: int) -> Iterator[Finding]:
    if len(wrong) and np.mean(wrong) > SHARE:
        message = (
            f"{100 * np.mean(wrong):.1f} % of the points that view {b} also covers {what} (allowed {100 * SHARE:.0f} %)"
        )
        yield Finding("views", message, frame=frame, view=a)
