"""Pixels against the geometry of the scene: depth on the labelled surface, label of the nearest object, counts.

Everything is measured as distance to exact surfaces. A rendered mesh lies within `MESH_TOLERANCE` of the surface, and
stored depth is rounded to half a step, which is longer along the rays of wide views: the tolerances come from there and
from `precision`.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from datagen.meshes.distance import MeshSolid
from datagen.schema import DEPTH_SCALE
from datagen.shapes.shape import MESH_TOLERANCE
from datagen.verify.mesh_rays import bounds, grazes, mesh_of, surface_distances
from datagen.verify.scene_case import Case, Finding, rounding
from datagen.verify.sphere_tracing import clip_to_box, trace

SURFACE_STEPS, PLANE_STEPS = 0.7, 0.8
"""Steps of depth that stored depth may be off: half a step, and a reserve for arithmetic in float32."""

MEDIAN_TOLERANCE = 9e-5
"""Metres that the median of very many of an object's pixels may lie off its surface: just above a mesh's tolerance."""

DEVIATIONS = 6.0
"""Depths that differ are rounded independently, each by up to a half step. The median of n of them is off by less than
this times a half step over the square root of n, with a probability of 1 - 10^-7."""

MANY = 30
"""Pixels that make a median meaningful."""

PLANE_TOLERANCE = PLANE_STEPS * DEPTH_SCALE
"""Metres that pixels of the table may lie above or below its plane where a step of depth lifts them by no more."""

SHELL = MESH_TOLERANCE + 0.2 * DEPTH_SCALE
"""Metres below a surface from where on a ray must have met the mesh that stands for it."""

NEAR_MISS = 2 * MESH_TOLERANCE + SHELL
"""Metres to which tracing surely comes near a surface whose mesh a ray meets: its last step ends at most a shell and a
miss behind the nearest point."""

MOST_AT_ONCE = 1_000_000
"""Points or rays that are measured at once, so that memory is bounded."""

ORDER_TOLERANCE = 1.0 * DEPTH_SCALE
"""Metres of depth that a hidden surface may seem to lie in front of the visible one."""


def check_surfaces(case: Case) -> Iterator[Finding]:
    """Check that pixels with an object's id lie on its surface."""
    for frame, view in case.images:
        segmentation, depth, moment = case.segmentation(frame, view), case.depth(frame, view), case.at(frame)
        if np.max(segmentation) > case.count:
            message = f"id {np.max(segmentation)}, but the scene has {case.count} objects"
            yield Finding("surface", message, frame=frame, view=view)
        for row in range(case.count):
            pixels = segmentation == row + 1
            yield from _off_surface(moment, row, frame, view, moment.rays[view][pixels], depth[pixels])


def signed_distance(
    case: Case, row: int, frame: int, points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point"]:
    """Metres from world points to the surface of one object at its stored pose, negative inside."""
    pose = case.world_from_object[frame, row]
    parts = np.array_split(points, 1 + len(points) // MOST_AT_ONCE)
    return np.concatenate([case.shapes[row].signed_distance((part - pose[:3, 3]) @ pose[:3, :3]) for part in parts])


def _off_surface(
    case: Case, row: int, frame: int, view: int, rays: Float[np.ndarray, "pixel 3"], depth: Float[np.ndarray, "pixel"]
) -> Iterator[Finding]:
    allowed = MESH_TOLERANCE + rounding(rays, SURFACE_STEPS) + _renderer_error(case, view, rays, depth)
    if mesh := mesh_of(case.shapes[row]):
        distance = surface_distances(mesh, *_local_rays(case, row, frame, view, rays), depth, allowed)
    else:
        distance = signed_distance(case, row, frame, case.center(view) + depth[:, None] * rays)
    off = np.abs(distance) > allowed
    if np.any(off) and case.allowed.precision.snap:
        off[off] = ~_grazes(case, row, frame, view, rays[off], depth[off])
    if np.any(off):
        worst = np.argmax(np.where(off, np.abs(distance), 0))
        message = (
            f"{np.count_nonzero(off)} of {len(off)} pixels of object {row + 1} lie off its surface, "
            f"by up to {1e3 * abs(distance[worst]):.2f} mm (allowed {1e3 * allowed[worst]:.2f})"
        )
        yield Finding("surface", message, frame=frame, view=view)
    elif len(distance) >= MANY:
        median, error = float(np.median(distance)), _median_error(case, view, rays, depth)
        if abs(median) > error:
            message = (
                f"the median pixel of object {row + 1} lies {1e3 * median:.3f} mm off its surface "
                f"(allowed {1e3 * error:.3f})"
            )
            yield Finding("surface", message, frame=frame, view=view)


def _median_error(
    case: Case, view: int, rays: Float[np.ndarray, "pixel 3"], depth: Float[np.ndarray, "pixel"]
) -> float:
    """Metres that the median of some pixels may lie off a surface."""
    independent = min(1.0, DEVIATIONS / np.sqrt(len(np.unique(depth))))
    error = rounding(rays, 0.5 * independent) + _renderer_error(case, view, rays, depth)
    return MEDIAN_TOLERANCE + float(np.median(error))


def _renderer_error(
    case: Case, view: int, rays: Float[np.ndarray, "*pixel 3"], depth: Float[np.ndarray, "*pixel"]
) -> Float[np.ndarray, "*pixel"]:
    """Metres that the renderer itself may have moved what it shows."""
    precision = case.allowed.precision
    length = np.sqrt(np.sum(rays**2, axis=-1))
    return precision.buffer(depth) * length + precision.sideways(depth, case.focal[view])


def _grazes(
    case: Case, row: int, frame: int, view: int, rays: Float[np.ndarray, "pixel 3"], depth: Float[np.ndarray, "pixel"]
) -> Bool[np.ndarray, "pixel"]:
    """Whether rays pass an object at its outline, so near that a renderer that moves corners sideways may show it.

    Such a pixel lies beside a triangle that is seen edge-on, and carries the depth to which that is extended.
    """
    shape = case.shapes[row]
    origins, local = _local_rays(case, row, frame, view, rays)
    if mesh := mesh_of(shape):
        return grazes(mesh, origins, local, case.allowed.precision.sideways(depth, case.focal[view]))
    distance = np.abs(shape.signed_distance(origins + depth[:, None] * local))
    sideways = case.allowed.precision.sideways(depth, case.focal[view])
    near, far = clip_to_box(shape.minimum_box, origins, local, float(np.max(sideways)) + NEAR_MISS)
    far = np.minimum(far, depth + 10 * distance + 0.002)
    hit, closest = trace(shape.signed_distance, origins, local, near, far, SHELL + sideways)
    return np.isinf(hit) & (closest <= NEAR_MISS + sideways)


def _local_rays(
    case: Case, row: int, frame: int, view: int, rays: Float[np.ndarray, "pixel 3"]
) -> tuple[Float[np.ndarray, "pixel 3"], Float[np.ndarray, "pixel 3"]]:
    """Origins and directions of a view's rays in the frame of one object."""
    pose = case.world_from_object[frame, row]
    origin, local = (case.center(view) - pose[:3, 3]) @ pose[:3, :3], rays @ pose[:3, :3]
    return np.broadcast_to(origin, local.shape), local


def check_table(case: Case) -> Iterator[Finding]:
    """Check that pixels without an object show the table's top where their ray meets it, and nothing elsewhere."""
    for frame, view in case.images:
        moment = case.at(frame)
        depth, rays, center = case.depth(frame, view), moment.rays[view], moment.center(view)
        background = case.segmentation(frame, view) == 0
        height = center[2] + depth * rays[..., 2]
        steep = np.maximum(np.abs(rays[..., 2]), 1)
        error = _renderer_error(case, view, rays, depth)
        plane = PLANE_TOLERANCE * steep + error
        seen = background & (depth > 0)
        off = seen & (np.abs(height) > plane)
        yield from _pixels(off, "of the table lie off its plane", np.abs(height), plane, frame, view)
        surface = MESH_TOLERANCE + SURFACE_STEPS * DEPTH_SCALE * steep + error
        below = ~background & (depth > 0) & (height < -surface)
        yield from _pixels(below, "of objects lie below the table", -height, surface, frame, view)
        inside, border = _distance_to_border(moment, view), PLANE_TOLERANCE + _border_error(moment, view)
        wrong = seen & (inside < -border)
        yield from _pixels(wrong, "return a depth beyond the table", -inside, border, frame, view)
        missing = (depth == 0) & (inside > border)
        yield from _pixels(missing, "return no depth where the table is", inside, border, frame, view)
        if np.any(~background & (depth == 0)):
            yield Finding("table", "pixels of objects without depth", frame=frame, view=view)


def _border_error(case: Case, view: int) -> Float[np.ndarray, "height width"]:
    """Metres along the table that the renderer may have moved its border, where each ray meets its plane."""
    rays = case.rays[view]
    drop = np.maximum(-rays[..., 2], 1e-9)
    sideways = case.allowed.precision.sideways(case.center(view)[2] / drop, case.focal[view])
    return sideways * np.sqrt(np.sum(rays**2, axis=-1)) / drop


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
    allowed: Float[np.ndarray, "height width"],
    frame: int,
    view: int,
) -> Iterator[Finding]:
    if np.any(wrong):
        worst = np.unravel_index(np.argmax(np.where(wrong, measure, -np.inf)), wrong.shape)
        message = (
            f"{np.count_nonzero(wrong)} pixels {what}, by up to {1e3 * measure[worst]:.2f} mm "
            f"(allowed {1e3 * allowed[worst]:.2f})"
        )
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
    """Check that no object lies in front of what a pixel shows, and that amodal counts are those of shapes alone."""
    for row in range(case.count):
        tally = Tally(case.record["segmentation"].shape[:2])
        for rays in _rays_near(case, row):
            _count(case, rays, row, tally)
        for frame, view in np.argwhere(tally.wrong):
            message = (
                f"object {row + 1} lies in front of what {tally.wrong[frame, view]} pixels show, "
                f"by up to {1e3 * tally.lead[frame, view]:.2f} mm (allowed {1e3 * ORDER_TOLERANCE:.2f})"
            )
            yield Finding("label", message, frame=int(frame), view=int(view))
        if "visibility/amodal_pixels" in case.record:
            yield from _check_amodal(case, tally, row)


def _check_amodal(case: Case, tally: "Tally", row: int) -> Iterator[Finding]:
    stored = case.record["visibility/amodal_pixels"][..., row]
    for frame, view in np.argwhere((stored < tally.covered) | (stored > tally.touched)):
        message = (
            f"object {row + 1} alone would cover {tally.covered[frame, view]} to {tally.touched[frame, view]} pixels, "
            f"stored are {stored[frame, view]}"
        )
        yield Finding("amodal", message, frame=int(frame), view=int(view))


class Tally:
    """Counts of one object's pixels in every image, by frame and view."""

    def __init__(self, images: tuple[int, int]):
        self.covered, self.touched = np.zeros(images, int), np.zeros(images, int)
        """Pixels that the object alone covers for sure, and those that it may cover."""
        self.wrong, self.lead = np.zeros(images, int), np.zeros(images)
        """Pixels that show something behind the object, and by how many metres at most."""


def _count(case: Case, rays: Rays, row: int, tally: Tally) -> None:
    box, solid = case.shapes[row].minimum_box, case.shapes[row].signed_distance
    precision, focal = case.allowed.precision, case.focal[rays.image[:, 1]]
    # The renderer may have moved the object sideways by so much, at the farthest point of its box.
    farthest = np.sqrt(np.sum(rays.origins**2, axis=-1)) + np.sqrt(np.sum((np.abs(box.center) + box.size) ** 2))
    sideways = precision.sideways(farthest, focal)
    near, far = clip_to_box(box, rays.origins, rays.directions, SHELL + float(np.max(sideways, initial=0)))
    if mesh := mesh_of(case.shapes[row]):
        hit, touched = _cast(mesh, rays, near <= far, sideways)
    else:
        hit, closest = trace(solid, rays.origins, rays.directions, near, far, SHELL + sideways)
        touched = closest <= NEAR_MISS + sideways
    wrong = hit < rays.depth - ORDER_TOLERANCE - precision.buffer(np.where(np.isfinite(hit), hit, 0))
    np.add.at(tally.covered, tuple(rays.image[np.isfinite(hit)].T), 1)
    np.add.at(tally.touched, tuple(rays.image[touched].T), 1)
    np.add.at(tally.wrong, tuple(rays.image[wrong].T), 1)
    np.maximum.at(tally.lead, tuple(rays.image[wrong].T), np.minimum(rays.depth[wrong] - hit[wrong], 10.0))


def _cast(
    mesh: MeshSolid, rays: Rays, near: Bool[np.ndarray, "ray"], sideways: Float[np.ndarray, "ray"]
) -> tuple[Float[np.ndarray, "ray"], Bool[np.ndarray, "ray"]]:
    """Hits that are sure, and whether a hit is possible, of the rays that come near a mesh."""
    first, last = np.full((2, len(near)), np.inf)
    first[near], last[near] = bounds(mesh, rays.origins[near], rays.directions[near], sideways[near])
    return last, np.isfinite(first)


def _rays_near(case: Case, row: int) -> Iterator[Rays]:
    """Rays of all images, of many images or part of one at a time."""
    parts: list[tuple[np.ndarray, ...]] = []
    for frame, view in case.images:
        columns = _rays_in_image(case.at(frame), row, frame, view)
        pieces = 1 + len(columns[0]) // MOST_AT_ONCE
        for piece in zip(*(np.array_split(column, pieces) for column in columns), strict=True):
            parts.append(piece)
            if sum(len(part[0]) for part in parts) >= MOST_AT_ONCE // 2:
                yield Rays(*(np.concatenate(column) for column in zip(*parts, strict=True)))
                parts = []
    if parts:
        yield Rays(*(np.concatenate(column) for column in zip(*parts, strict=True)))


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
