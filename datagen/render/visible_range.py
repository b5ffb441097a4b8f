"""Checks of what cameras see: depths in the range that renderers show and the format holds, and visible objects.

Renderers cut away what is nearer than `NEAREST`, and would show what lies behind it. The format holds depths up to
`MAX_DEPTH`. Distances along a camera's axis are meant throughout: planar depth.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int

from datagen.config import Recipe
from datagen.errors import UsageError
from datagen.geometry import invert_rigid, transform
from datagen.render.raster import RasterRenderer
from datagen.render.renderer import NEAREST
from datagen.scene import Camera, Scene
from datagen.schema import MAX_DEPTH
from datagen.shapes.shape import Shape

_MARGIN = 1.001
"""Factor on `NEAREST`; the excess is kept free for renderers that work in float32."""

_NEAR = _MARGIN * NEAREST


def check_range(
    scene: Scene,
    shapes: Sequence[Shape],
    world_from_object: Float[np.ndarray, "frame object 4 4"],
    resolution: tuple[int, int],
    *,
    name: str = "",
) -> None:
    """Check all cameras of a scene before images of this width and height are rendered; `name` begins a message.

    Raises:
        UsageError: a camera stands below the table or in an object, or sees something from too near or too far.
    """
    for view, camera in enumerate(scene.cameras):
        fault = table_fault(camera, scene.table.size, *resolution)
        if near := near_object(camera, shapes, world_from_object, *resolution):
            frame, row = near
            fault = (
                f"is inside object {row + 1} in frame {frame}, or sees it from {100 * NEAREST:.0f} cm or less; "
                "expected more"
            )
        if fault:
            raise UsageError(
                f"{name}Camera {view} {fault}. Move the cameras with --rig.distance, --rig.elevation or --rig.target, "
                f"or lower --rig.field-of-view or --rig.jitter, or change the --cameras file; "
                f"images of {resolution[0]}x{resolution[1]} show all of "
                "the frame and more."
            )


def table_fault(camera: Camera, table_size: float, width: int, height: int) -> str | None:
    """Describe why a camera does not see the table from above and within range; None if it does. Size in pixels."""
    for frame in range(len(camera.path)) if camera.moves else ():
        if fault := table_fault(camera.at(frame), table_size, width, height):
            return f"in frame {frame} {fault}"
    if camera.moves:
        return None
    elevation = camera.world_from_camera[2, 3]
    if elevation <= 0:
        return f"stands {100 * abs(elevation):.1f} cm below the table's top; expected above it"
    # Depths of the part of the table that lies in the view.
    corners = 0.5 * table_size * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    corners = transform(invert_rigid(camera.world_from_camera), corners)
    depths = clip(corners, _sides(camera, width, height))[:, 2]
    if np.min(depths, initial=np.inf) <= _NEAR:
        return f"sees the table from {100 * np.min(depths):.1f} cm; expected more than {100 * NEAREST:.0f} cm"
    if np.max(depths, initial=0.0) > MAX_DEPTH:
        return f"sees the table at {np.max(depths):.2f} m; expected at most {MAX_DEPTH:.4f} m"
    return None


def near_object(
    camera: Camera,
    shapes: Sequence[Shape],
    world_from_object: Float[np.ndarray, "frame object 4 4"],
    width: int,
    height: int,
) -> tuple[int, int] | None:
    """Frame and row of the first object that a camera is inside of, or sees from `NEAREST` metres or less."""
    if camera.moves:
        for frame in range(len(world_from_object)):
            if near := near_object(camera.at(frame), shapes, world_from_object[frame : frame + 1], width, height):
                return frame, near[1]
        return None
    # Only objects whose sphere comes near can be near.
    camera_from_world = invert_rigid(camera.world_from_camera)
    radii = np.array([shape.radius for shape in shapes])
    nearest = (camera_from_world @ world_from_object)[..., 2, 3] - radii
    sides = _sides(camera, width, height)
    for frame, row in np.argwhere(nearest <= _NEAR):
        pose = world_from_object[frame, row]
        if _is_near(shapes[row], camera_from_world @ pose, sides):
            return int(frame), int(row)
    return None


def _is_near(shape: Shape, camera_from_object: Float[np.ndarray, "4 4"], sides: Float[np.ndarray, "side 3"]) -> bool:
    eye = invert_rigid(camera_from_object)[:3, 3]
    if np.sum(eye**2) < shape.radius**2 and shape.signed_distance(eye[None])[0] <= 0:
        return True
    vertices = transform(camera_from_object, shape.vertices)
    # A triangle whose corners all lie beyond one of the planes of the near part of the view is outside of it.
    beyond = np.concatenate([vertices @ sides.T > 0, vertices[:, 2:] > _NEAR], axis=1)
    faces = shape.faces[~np.any(np.all(beyond[shape.faces], axis=1), axis=1)]
    if np.any(~np.any(beyond, axis=1)[faces]):
        return True
    return any(np.min(clip(vertices[face], sides)[:, 2], initial=np.inf) <= _NEAR for face in faces)


def _sides(camera: Camera, width: int, height: int) -> Float[np.ndarray, "4 3"]:
    """Outward normals of the four planes through a camera's centre that bound its view, camera frame."""
    k = camera.k(width, height)
    right, left = (width - k[0, 2]) / k[0, 0], k[0, 2] / k[0, 0]
    below, above = (height - k[1, 2]) / k[1, 1], k[1, 2] / k[1, 1]
    return np.array([[1.0, 0.0, -right], [-1.0, 0.0, -left], [0.0, 1.0, -below], [0.0, -1.0, -above]])


def clip(polygon: Float[np.ndarray, "corner 3"], planes: Float[np.ndarray, "plane 3"]) -> Float[np.ndarray, "part 3"]:
    """Corners of the part of a convex polygon behind planes through the origin (Sutherland and Hodgman 1974)."""
    for normal in planes:
        if not len(polygon):
            break
        height = polygon @ normal
        polygon = _cut(polygon, height, height <= 0)
    return polygon


def _cut(
    polygon: Float[np.ndarray, "corner 3"], height: Float[np.ndarray, "corner"], kept: Bool[np.ndarray, "corner"]
) -> Float[np.ndarray, "part 3"]:
    """Corners that are kept, and the points between them and the others at which the height is zero."""
    corners = []
    for here in range(len(polygon)):
        after = (here + 1) % len(polygon)
        if kept[here]:
            corners.append(polygon[here])
        if kept[here] != kept[after]:
            share = height[here] / (height[here] - height[after])
            corners.append(polygon[here] + share * (polygon[after] - polygon[here]))
    return np.array(corners).reshape(-1, 3)


def visible_pixels(
    recipe: Recipe, scene: Scene, shapes: Sequence[Shape], world_from_object: Float[np.ndarray, "object 4 4"]
) -> Int[np.ndarray, "object"]:
    """Pixels that each object shows at these poses in its worst view."""
    renderer = _rasteriser()
    renderer.load(scene, shapes)
    width, height = recipe.visibility_resolution
    counts = []
    for camera in scene.cameras:
        ids = renderer.segment(world_from_object, camera, width, height)
        counts.append(np.bincount(ids.ravel(), minlength=len(shapes) + 1)[1:])
    return np.min(counts, axis=0)


@cache
def _rasteriser() -> RasterRenderer:
    return RasterRenderer()
