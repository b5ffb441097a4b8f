"""Check amodal masks: along their outlines, the exact shape alone is hit inside and missed outside."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from datagen.storage.run_lengths import decode_mask
from datagen.verify.mesh_rays import bounds, mesh_of
from datagen.verify.pixels import NEAR_MISS, SHELL
from datagen.verify.scene_case import Case, Finding
from datagen.verify.sphere_tracing import clip_to_box, trace

Mask = Bool[np.ndarray, "height width"]

SHARE, FEW = 0.05, 3
"""Share and number of pixels by which a renderer that moves corners sideways may draw an object larger or smaller."""


def check_amodal(case: Case) -> Iterator[Finding]:
    """Check that masks hold the visible pixels, as many pixels as stored, and end where the solids do."""
    height, width = case.record["segmentation"].shape[2:]
    for row in range(case.count):
        borders: list[Border] = []
        for frame, view in case.images:
            try:
                mask = decode_mask(bytes(case.record["amodal/rle"][frame, view, row]), height, width)
                messages = list(_wrong_pixels(case, frame, view, row, mask))
                borders.append(_border(case, frame, view, row, mask))
            except ValueError as error:
                messages = [f"cannot be decoded: {error}"]
            for message in messages:
                yield Finding("amodal", f"mask of object {row + 1} {message}", frame=frame, view=view)
        for frame, view, message in _wrong_borders(case, row, borders):
            yield Finding("amodal", f"mask of object {row + 1} {message}", frame=frame, view=view)


def _wrong_pixels(case: Case, frame: int, view: int, row: int, mask: Mask) -> Iterator[str]:
    if missing := np.count_nonzero((case.segmentation(frame, view) == row + 1) & ~mask):
        yield f"lacks {missing} visible pixels"
    stored, counted = int(case.record["visibility/amodal_pixels"][frame, view, row]), np.count_nonzero(mask)
    if abs(stored - counted) > (FEW + int(SHARE * stored) if case.allowed.precision.snap else 0):
        yield f"has {counted} pixels, visibility/amodal_pixels is {stored}"


@dataclass(frozen=True, eq=False)
class Border:
    """Rays along the outline of a mask, on both sides, in the object's frame."""

    frame: int
    view: int
    origins: Float[np.ndarray, "ray 3"]
    directions: Float[np.ndarray, "ray 3"]
    inside: Bool[np.ndarray, "ray"]


def _wrong_borders(case: Case, row: int, borders: Sequence[Border]) -> Iterator[tuple[int, int, str]]:
    if not borders:
        return
    shape = case.shapes[row]
    origins, directions = (np.concatenate([getattr(b, name) for b in borders]) for name in ("origins", "directions"))
    focal = np.repeat(case.focal[[border.view for border in borders]], [len(border.inside) for border in borders])
    farthest = np.sqrt(np.sum(origins**2, axis=-1)) + shape.radius
    sideways = case.allowed.precision.sideways(farthest, focal)
    if mesh := mesh_of(shape):
        first, hit = bounds(mesh, origins, directions, sideways)
        missed = np.isinf(first)
    else:
        margin = NEAR_MISS + SHELL + float(np.max(sideways, initial=0))
        near, far = clip_to_box(shape.minimum_box, origins, directions, margin)
        hit, closest = trace(shape.signed_distance, origins, directions, near, far, SHELL + sideways)
        missed = closest > NEAR_MISS + sideways
    start = 0
    for border in borders:
        part = slice(start, start := start + len(border.inside))
        if wrong := np.count_nonzero(np.isfinite(hit[part]) & ~border.inside):
            yield border.frame, border.view, f"lacks {wrong} pixels at its outline that the object alone covers"
        if wrong := np.count_nonzero(missed[part] & border.inside):
            yield border.frame, border.view, f"has {wrong} pixels at its outline that the object does not cover"


def _border(case: Case, frame: int, view: int, row: int, mask: Mask) -> Border:
    border, pose, moment = _outline(mask), case.world_from_object[frame, row], case.at(frame)
    directions = moment.rays[view][border] @ pose[:3, :3]
    origin = (moment.center(view) - pose[:3, 3]) @ pose[:3, :3]
    return Border(frame, view, np.broadcast_to(origin, directions.shape), directions, mask[border])


def _outline(mask: Mask) -> Mask:
    """Pixels with a neighbour above, below, left or right on the other side of the outline."""
    border = np.zeros_like(mask)
    across, down = mask[:, 1:] != mask[:, :-1], mask[1:] != mask[:-1]
    border[:, 1:] |= across
    border[:, :-1] |= across
    border[1:] |= down
    border[:-1] |= down
    return border
