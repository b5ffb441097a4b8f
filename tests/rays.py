"""An independent picture of a scene: rays marched through the shapes' exact signed distances."""

import numpy as np
from jaxtyping import Bool, Float, Int

from datagen.geometry import invert_rigid, pixel_rays, transform, unproject
from datagen.render import Image
from datagen.scene import Camera, Scene
from datagen.shapes import build
from tests.worlds.handmade import poses

GRAZE = 3e-4
"""Metres within which a ray that passes a surface may or may not hit its mesh."""


def trace(
    scene: Scene, camera: Camera, width: int, height: int
) -> tuple[Int[np.ndarray, "height width"], Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
    """Id and planar depth of the nearest surface at each pixel's centre, and whether no silhouette is too close."""
    rays = pixel_rays(camera.k(width, height), width, height)
    depth = table_depth(scene, camera, rays)
    ids, sure = np.zeros((height, width), int), np.ones((height, width), bool)
    for row, body in enumerate(scene.bodies):
        object_from_camera = invert_rigid(poses(scene)[row]) @ camera.world_from_camera
        z, least = _march(build(body.shape).signed_distance, object_from_camera, rays)
        nearer = (z > 0) & ((z < depth) | (depth == 0))
        ids[nearer], depth[nearer] = row + 1, z[nearer]
        sure &= (z > 0) | (least > GRAZE)
    return ids, depth, sure


def _march(distance, object_from_camera, rays):
    """Sphere tracing (Hart 1996): depth of the first hit, 0 where there is none, and the closest approach."""
    origin = object_from_camera[:3, 3]
    directions = (rays @ object_from_camera[:3, :3].T).reshape(-1, 3)
    length = np.sqrt(np.sum(directions**2, axis=1))
    z, least = np.full(len(length), 0.05), np.full(len(length), np.inf)
    going = np.ones(len(length), bool)
    for _ in range(400):
        gap = distance(origin + directions[going] * z[going, None])
        least[going] = np.minimum(least[going], gap)
        z[going] += np.maximum(gap, 1e-6) / length[going]
        going[going] = (gap > 1e-6) & (z[going] < 4)
        if not going.any():
            break
    z[least > 1e-6] = 0
    return z.reshape(rays.shape[:2]), least.reshape(rays.shape[:2])


def table_depth(
    scene: Scene, camera: Camera, rays: Float[np.ndarray, "height width 3"]
) -> Float[np.ndarray, "height width"]:
    """Planar depth of the empty table, 0 beyond it."""
    pose = camera.world_from_camera
    with np.errstate(divide="ignore"):
        z = -pose[2, 3] / (rays @ pose[2, :3])
    points = transform(pose, rays * z[..., None])
    return np.where((z > 0) & (np.abs(points[..., :2]).max(axis=-1) <= 0.5 * scene.table.size), z, 0.0)


def surface_distance(scene: Scene, image: Image, camera: Camera) -> Float[np.ndarray, "pixel"]:
    """Metres between each object pixel's unprojected depth and the surface of the object that it is labelled with."""
    height, width = image.depth.shape
    points = unproject(image.depth, camera.k(width, height), camera.world_from_camera)
    distances = []
    for row, body in enumerate(scene.bodies):
        mine = points[image.segmentation == row + 1]
        distances.append(np.abs(build(body.shape).signed_distance(transform(invert_rigid(poses(scene)[row]), mine))))
    return np.concatenate(distances)
