"""Check views of one moment against each other, using only pixels and cameras, not shapes or poses.

An image contains no information about the surface between its pixels: all pixels of a view may miss an edge, or an
object smaller than a pixel, that another view shows. Therefore only patches are compared: 3x3 pixels with one label on
one plane, up to the rounding of depth, so that the surface between them is known. If the ray of a pixel of another view
meets a patch, that pixel must show the patch or something in front of it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Integer

from datagen.schema import DEPTH_SCALE
from datagen.verify.scene_case import Case, Finding

SHARE = 0.01
"""Share of an object's or the table's patches that may disagree, e.g. if nine pixels hit only the bars of a grid."""

FEW = 3
"""Number of patches that may always disagree for the same reason, even if few are compared."""

FLAT = 4.0
"""Largest distance, in half steps of depth, of a patch's pixels from the plane through its middle pixel.

The pixel itself contributes one half step, the middle pixel one, and the two slopes, each from two pixels, two.
"""

PATCH_STEPS = 2 * FLAT
"""Largest distance of the surface between the pixels of a patch from its plane, in half steps of depth."""

MOST_PATCHES = 100_000
"""Approximate largest number of patches compared per view; of more, only every n-th is used."""

MOST_OTHERS = 24
"""Largest number of views that each view is compared with; of more, only every n-th after it is used."""

AROUND = np.array([(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
MIDDLE = 4


@dataclass(frozen=True, eq=False)
class Patches:
    """Flat pieces of surface that one view shows, in the frame of its camera."""

    pixel: Float[np.ndarray, "patch 2"]
    """Centre of the middle pixel, x and y in the image."""
    label: Integer[np.ndarray, "patch"]
    middle: Float[np.ndarray, "patch 3"]
    """Point shown by the middle pixel, metres."""
    plane: Float[np.ndarray, "patch 3"]
    """Vector n of the plane n . p = 1, 1/m."""
    error: Float[np.ndarray, "patch"]
    """Largest error of inverse depth anywhere on the patch, 1/m."""

    def chosen(self, rows: np.ndarray) -> "Patches":
        """Select patches by a mask."""
        return Patches(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class Meeting:
    """Intersections of each patch's plane with rays of another view, of the pixel there and its eight neighbours."""

    met: Bool[np.ndarray, "patch"]
    """Whether the ray of the middle pixel meets the patch itself."""
    beyond: Float[np.ndarray, "9 patch"]
    """Depth of each pixel minus the depth of the plane there, metres; inf if the pixel shows nothing."""
    allowed: Float[np.ndarray, "9 patch"]
    """Largest allowed magnitude of `beyond`, metres."""
    is_sharp: Bool[np.ndarray, "patch"]
    """Whether `allowed` of the middle pixel is at most the width of a pixel there."""
    labels: Integer[np.ndarray, "9 patch"]


def check_views(case: Case) -> Iterator[Finding]:
    """Check that each other view of the same moment shows a view's patches, or something in front of them."""
    frames, views = case.record["segmentation"].shape[:2]
    for frame in range(frames if views > 1 else 0):
        moment = case.at(frame)
        for a in range(views):
            patches = find_patches(moment, frame, a)
            for step in range(1, views, -(-(views - 1) // MOST_OTHERS)):
                yield from _check_pair(moment, frame, patches, a, (a + step) % views)


def _check_pair(case: Case, frame: int, patches: Patches, a: int, b: int) -> Iterator[Finding]:
    pose = case.record["camera/world_from_camera"][a]
    pixels, z = case.project(pose[:3, 3] + patches.middle @ pose[:3, :3].T, b)
    height, width = case.record["segmentation"].shape[2:]
    inner = (z > 0) & np.all((pixels >= 1) & (pixels < (width - 1, height - 1)), axis=-1)
    patches = patches.chosen(inner)
    with np.errstate(all="ignore"):
        meeting = _meet(case, frame, patches, np.floor(pixels[inner]).astype(int), a, b)
        through = meeting.met & np.all(meeting.beyond > meeting.allowed, axis=0)
        same = meeting.met & (np.abs(meeting.beyond[MIDDLE]) <= meeting.allowed[MIDDLE])
    yield from _findings(patches, through, meeting.met, "lie in front of what it shows", frame, a, b)
    # Where two objects touch, a pixel at the foot of one shows the surface of both within the error.
    same &= meeting.is_sharp & (np.min(meeting.labels, axis=0) == np.max(meeting.labels, axis=0))
    other = same & (meeting.labels[MIDDLE] != patches.label)
    yield from _findings(patches, other, same, "carry another label there", frame, a, b)


def find_patches(case: Case, frame: int, view: int) -> Patches:
    """Patches of an image, at most about `MOST_PATCHES`."""
    depth, labels, k = case.depth(frame, view), case.segmentation(frame, view), case.record["camera/K"][view]
    with np.errstate(all="ignore"):
        inverse = 1 / depth
        middle, around = inverse[1:-1, 1:-1], _around(inverse)
        slope_x, slope_y = (around[5] - around[3]) / 2, (around[7] - around[1]) / 2
        planes = np.stack([middle + dx * slope_x + dy * slope_y for dx, dy in AROUND])
        half_step = 0.5 * DEPTH_SCALE * np.max(around, axis=0) ** 2
        flat = np.max(np.abs(around - planes), axis=0) <= FLAT * half_step
    uniform = np.min(_around(labels), axis=0) == np.max(_around(labels), axis=0)
    row, column = np.nonzero(flat & uniform)
    every = slice(None, None, 1 + len(row) // MOST_PATCHES)
    row, column = row[every], column[every]
    gx, gy, w = slope_x[row, column] * k[0, 0], slope_y[row, column] * k[1, 1], middle[row, column]
    x, y = (column + 1.5 - k[0, 2]) / k[0, 0], (row + 1.5 - k[1, 2]) / k[1, 1]
    return Patches(
        pixel=np.stack([column + 1.5, row + 1.5], axis=-1),
        label=labels[row + 1, column + 1],
        middle=np.stack([x / w, y / w, 1 / w], axis=-1),
        # On a plane, inverse depth is linear in the image: 1/z = w + gx (x' - x) + gy (y' - y) with x' = p_x / p_z.
        plane=np.stack([gx, gy, w - gx * x - gy * y], axis=-1),
        error=PATCH_STEPS * half_step[row, column],
    )


def _around(image: np.ndarray) -> np.ndarray:
    """Each pixel inside the border with its eight neighbours, in the order of `AROUND`."""
    height, width = image.shape
    return np.stack([image[1 + dy : height - 1 + dy, 1 + dx : width - 1 + dx] for dx, dy in AROUND])


def _meet(case: Case, frame: int, patches: Patches, place: Integer[np.ndarray, "patch 2"], a: int, b: int) -> Meeting:
    """Intersect patches of view `a` with the rays of view `b` at and around the pixels `place`."""
    pose, k = case.record["camera/world_from_camera"][a], case.record["camera/K"][a]
    column, row = np.moveaxis(place + AROUND[:, None], -1, 0)
    origin = (case.center(b) - pose[:3, 3]) @ pose[:3, :3]
    rays = case.rays[b][row, column] @ pose[:3, :3]
    approach = np.abs(np.sum(patches.plane * rays, axis=-1))
    expected = (1 - patches.plane @ origin) / np.sum(patches.plane * rays, axis=-1)
    points = origin + expected[..., None] * rays
    shown = points[MIDDLE, :, :2] / points[MIDDLE, :, 2:] * (k[0, 0], k[1, 1]) + k[:2, 2]
    in_front = np.all((expected > 0) & (points[..., 2] > 0), axis=0)
    depth = case.depth(frame, b)[row, column]
    # An error of the patch, as a distance from its plane, is longer along rays that meet it at a small angle.
    precision, length = case.allowed.precision, np.sqrt(np.sum(patches.plane**2, axis=-1))
    moved = precision.sideways(patches.middle[:, 2], case.focal[a]) + precision.sideways(expected, case.focal[b])
    buffers = precision.buffer(patches.middle[:, 2]) + precision.buffer(expected)
    allowed = (points[..., 2] * patches.error + length * (moved + buffers)) / approach + DEPTH_SCALE + buffers
    return Meeting(
        met=in_front & np.all(np.abs(shown - patches.pixel) <= 1, axis=-1),
        beyond=np.where(depth > 0, depth, np.inf) - expected,
        allowed=allowed,
        is_sharp=allowed[MIDDLE] <= expected[MIDDLE] / case.focal[b],
        labels=case.segmentation(frame, b)[row, column],
    )


def _findings(
    patches: Patches,
    wrong: Bool[np.ndarray, "patch"],
    compared: Bool[np.ndarray, "patch"],
    what: str,
    frame: int,
    a: int,
    b: int,
) -> Iterator[Finding]:
    for label in np.unique(patches.label[wrong]):
        own = patches.label == label
        count, total = np.count_nonzero(wrong & own), np.count_nonzero(compared & own)
        allowed = max(FEW, int(SHARE * total))
        if count > allowed:
            message = f"{count} of {total} patches with id {label} that view {b} also covers {what} (allowed {allowed})"
            yield Finding("views", message, frame=frame, view=a)
