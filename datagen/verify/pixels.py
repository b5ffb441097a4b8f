"""Pixels against the geometry of the scene: depth on the labelled surface, label of the nearest object, counts.

Everything is measured as distance to exact surfaces. A rendered mesh lies within `MESH_TOLERANCE` of the surface, and
stored depth is rounded to half a unit (1.1 times that along the ray at the image's corner): the tolerances come from
there, and none of them depends on the renderer or on the angle of view, since a distance to a surface does not.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from datagen.schema import DEPTH_SCALE
from datagen.shapes.shape import MESH_TOLERANCE
from datagen.verify.case import Case
from datagen.verify.finding import Finding
from datagen.verify.trace import clip_to_box, trace

SURFACE_TOLERANCE = MESH_TOLERANCE + 0.7 * DEPTH_SCALE
"""Metres that a single unprojected pixel may lie off the surface it is labelled with."""

MEDIAN_TOLERANCE = 9e-5
"""Metres that the median of an object's pixels in one image may lie off its surface: just above a mesh's tolerance."""

MANY = 30
"""Pixels that make a median meaningful."""

PLANE_TOLERANCE = 0.8 * DEPTH_SCALE
"""Metres that pixels of the table may lie above or below its plane."""

SHELL = MESH_TOLERANCE + 0.2 * DEPTH_SCALE
"""Metres below a surface from where on a ray must have met the mesh that stands for it."""

NEAR_MISS = 2 * MESH_TOLERANCE + SHELL
"""Metres to which tracing surely comes near a surface whose mesh a ray meets: its last step ends at most a shell and a
miss behind the nearest point."""

ORDER_TOLERANCE = 1.0 * DEPTH_SCALE
"""Metres of depth that a hidden surface may seem to lie in front of the visible one."""


def check_surfaces(case: Case) -> Iterator[Finding]:
    """Pixels that carry an object's id lie on that object's surface."""
    for frame, view in case.images:
        segmentation, depth = case.segmentation(frame, view), case.depth(frame, view)
        if np.max(segmentation) > case.count:
            message = f"id {np.max(segmentation)}, but the scene has {case.count} objects"
            yield Finding("surface", message, frame=frame, view=view)
        rows, columns = np.nonzero(segmentation)
        points = case.center(view) + depth[rows, columns, None] * case.rays[view][rows, columns]
        labels = segmentation[rows, columns]
        for row in range(case.count):
            distance = signed_distance(case, row, frame, points[labels == row + 1])
            yield from _off_surface(distance, row, frame, view)


def signed_distance(
    case: Case, row: int, frame: int, points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point"]:
    """Metres from world points to the surface of one object at its stored pose, negative inside."""
    pose = case.world_from_object[frame, row]
    return case.shapes[row].signed_distance((points - pose[:3, 3]) @ pose[:3, :3])


def _off_surface(distance: Float[np.ndarray, "point"], row: int, frame: int, view: int) -> Iterator[Finding]:
    off = np.abs(distance) > SURFACE_TOLERANCE
    if np.any(off):
        message = (
            f"{np.count_nonzero(off)} of {len(off)} pixels of object {row + 1} lie off its surface, "
            f"by up to {1e3 * np.max(np.abs(distance)):.2f} mm (allowed {1e3 * SURFACE_TOLERANCE:.2f})"
        )
        yield Finding("surface", message, frame=frame, view=view)
    elif len(distance) >= MANY and abs(median := float(np.median(distance))) > MEDIAN_TOLERANCE:
        message = (
            f"the median pixel of object {row + 1} lies {1e3 * median:.3f} mm off its surface "
            f"(allowed {1e3 * MEDIAN_TOLERANCE:.3f})"
        )
        yield Finding("surface", message, frame=frame, view=view)


def check_table(case: Case) -> Iterator[Finding]:
    """Pixels without an object show the table's top where their ray meets it and nothing where it does not."""
    for frame, view in case.images:
        depth, rays, center = case.depth(frame, view), case.rays[view], case.center(view)
        background = case.segmentation(frame, view) == 0
        height = center[2] + depth * rays[..., 2]
        seen = background & (depth > 0)
        off = seen & (np.abs(height) > PLANE_TOLERANCE)
        yield from _pixels(off, "of the table lie off its plane", np.abs(height), PLANE_TOLERANCE, frame, view)
        below = ~background & (depth > 0) & (height < -SURFACE_TOLERANCE)
        yield from _pixels(below, "of objects lie below the table", -height, SURFACE_TOLERANCE, frame, view)
        inside = _distance_to_border(case, view)
        wrong = seen & (inside < -PLANE_TOLERANCE)
        yield from _pixels(wrong, "return a depth beyond the table", -inside, PLANE_TOLERANCE, frame, view)
        missing = (depth == 0) & (inside > PLANE_TOLERANCE)
        yield from _pixels(missing, "return no depth where the table is", inside, PLANE_TOLERANCE, frame, view)
        if np.any(~background & (depth == 0)):
            yield Finding("table", "pixels of objects without depth", frame=frame, view=view)


def _distance_to_border(case: Case, view: int) -> Float[np.ndarray, "height width"]:
    """Metres from where a ray meets the plane z = 0 to the table's border, negative outside, -inf if it never does."""
    center, rays = case.center(view), case.rays[view]
    t = -center[2] / np.where(rays[..., 2] < 0, rays[..., 2], -1e-300)
    meets = center[:2] + t[..., None] * rays[..., :2]
    return np.where(rays[..., 2] < 0, 0.5 * case.scene.table.size - np.max(np.abs(meets), axis=-1), -np.inf)


def _pixels(
    wrong: Bool[np.ndarray, "height width"],
    what: str,
    measure: Float[np.ndarray, "height width"],
    allowed: float,
    frame: int,
    view: int,
) -> Iterator[Finding]:
    if np.any(wrong):
        worst, share = np.max(measure[wrong]), np.count_nonzero(wrong)
        message = f"{share} pixels {what}, by up to {1e3 * worst:.2f} mm (allowed {1e3 * allowed:.2f})"
        yield Finding("table", message, frame=frame, view=view)


@dataclass(frozen=True, eq=False)
class Rays:
    """Pixels of all images whose rays may meet one object, in its frame."""

    image: Integer[np.ndarray, "ray 2"]
    """Frame and view."""
    origins: Float[np.ndarray, "ray 3"]
    directions: Float[np.ndarray, "ray 3"]
    depth: Float[np.ndarray, "ray"]
    """Stored, metres; inf where nothing returned."""


def check_order(case: Case) -> Iterator[Finding]:
    """No object lies in front of what a pixel shows, and amodal counts are what the shapes alone would cover."""
    for row in range(case.count):
        rays = _rays_near(case, row)
        near, far = clip_to_box(case.shapes[row].minimum_box, rays.origins, rays.directions, SHELL)
        hit, closest = trace(case.shapes[row].signed_distance, rays.origins, rays.directions, near, far, SHELL)
        yield from _in_front(rays, hit, row)
        if "visibility/amodal_pixels" in case.record:
            yield from _amodal(case, rays, np.isfinite(hit), closest <= NEAR_MISS, row)


def _in_front(rays: Rays, hit: Float[np.ndarray, "ray"], row: int) -> Iterator[Finding]:
    wrong = hit < rays.depth - ORDER_TOLERANCE
    for frame, view in np.unique(rays.image[wrong], axis=0):
        chosen = wrong & np.all(rays.image == (frame, view), axis=1)
        lead = np.max(np.minimum(rays.depth[chosen] - hit[chosen], 10.0))
        message = (
            f"object {row + 1} lies in front of what {np.count_nonzero(chosen)} pixels show, "
            f"by up to {1e3 * lead:.2f} mm (allowed {1e3 * ORDER_TOLERANCE:.2f})"
        )
        yield Finding("label", message, frame=int(frame), view=int(view))


def _amodal(
    case: Case, rays: Rays, covered: Bool[np.ndarray, "ray"], touched: Bool[np.ndarray, "ray"], row: int
) -> Iterator[Finding]:
    stored = case.record["visibility/amodal_pixels"]
    least, most = np.zeros(stored.shape[:2], int), np.zeros(stored.shape[:2], int)
    np.add.at(least, tuple(rays.image[covered].T), 1)
    np.add.at(most, tuple(rays.image[touched].T), 1)
    for frame, view in np.argwhere((stored[..., row] < least) | (stored[..., row] > most)):
        message = (
            f"object {row + 1} alone would cover {least[frame, view]} to {most[frame, view]} pixels, "
            f"stored are {stored[frame, view, row]}"
        )
        yield Finding("amodal", message, frame=int(frame), view=int(view))


def _rays_near(case: Case, row: int) -> Rays:
    parts = [_rays_in_image(case, row, frame, view) for frame, view in case.images]
    return Rays(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _rays_in_image(
    case: Case, row: int, frame: int, view: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    pose = case.world_from_object[frame, row]
    window = _window(case, row, frame, view)
    local = case.rays[view][window].reshape(-1, 3) @ pose[:3, :3]
    origin = (case.center(view) - pose[:3, 3]) @ pose[:3, :3]
    depth = case.depth(frame, view)[window].ravel()
    image = np.broadcast_to([frame, view], (len(local), 2))
    return image, np.broadcast_to(origin, local.shape), local, np.where(depth > 0, depth, np.inf)


def _window(case: Case, row: int, frame: int, view: int) -> tuple[slice, slice]:
    """Rows and columns of the image that one object's minimum box may cover."""
    height, width = case.record["segmentation"].shape[2:]
    pose = case.world_from_object[frame, row]
    pixels, z = case.project(case.shapes[row].minimum_box.corners @ pose[:3, :3].T + pose[:3, 3], view)
    if np.min(z) <= 0:
        return slice(0, height), slice(0, width)
    (x0, y0), (x1, y1) = np.floor(np.min(pixels, axis=0)) - 1, np.ceil(np.max(pixels, axis=0)) + 1
    x0, x1 = np.clip([x0, x1], 0, width).astype(int)
    y0, y1 = np.clip([y0, y1], 0, height).astype(int)
    return slice(y0, y1), slice(x0, x1)
