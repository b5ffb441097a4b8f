"""First hits of rays on triangle meshes with Embree; the only module that imports embreex."""

import functools
import weakref
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from datagen.errors import UsageError
from datagen.meshes.distance import MeshSolid


def first_hits(
    solid: MeshSolid, origins: Float[np.ndarray, "ray 3"], directions: Float[np.ndarray, "ray 3"]
) -> tuple[Float[np.ndarray, "ray"], Int[np.ndarray, "ray"]]:
    """Find where rays first meet a mesh, from either side.

    Embree finds the triangle in single precision; the position on its plane is computed in double precision.

    Returns:
        Position of the hit in units of the ray's direction, inf if there is none.
        Row of the triangle, -1 if there is none.

    Raises:
        UsageError: embreex is not installed.
    """
    if not len(origins):
        return np.zeros(0), np.zeros(0, int)
    # Single precision is finest near zero: rays start close to the mesh.
    center, radius = 0.5 * (solid.low + solid.high), 0.51 * float(np.sqrt(np.sum((solid.high - solid.low) ** 2)))
    length = np.sqrt(np.sum(directions**2, axis=1))
    begin = np.sum((center - origins) * directions, axis=1) / length**2 - radius / length
    begin = np.maximum(begin, 0.0)
    near = (origins + begin[:, None] * directions - center).astype(np.float32)
    faces = _scene(solid).run(near, directions.astype(np.float32))
    faces = np.asarray(faces, np.int64)
    hit = faces >= 0
    t = np.full(len(origins), np.inf)
    a, b, c = (solid.triangles[faces[hit], i] for i in range(3))
    normal = np.cross(b - a, c - a)
    along = np.sum(normal * directions[hit], axis=1)
    height = np.sum(normal * (a - origins[hit]), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t[hit] = np.where(along != 0, height / along, np.inf)
    return t, np.where(hit, faces, -1)


_SCENES: "weakref.WeakKeyDictionary[MeshSolid, Any]" = weakref.WeakKeyDictionary()


def _scene(solid: MeshSolid) -> Any:
    if solid not in _SCENES:
        scenes, meshes = _embree()
        center = 0.5 * (solid.low + solid.high)
        scene = scenes.EmbreeScene(robust=True)
        meshes.TriangleMesh(scene, np.ascontiguousarray((solid.triangles - center).astype(np.float32)))
        _SCENES[solid] = scene
    return _SCENES[solid]


@functools.cache
def _embree() -> tuple[Any, Any]:
    try:
        from embreex import mesh_construction, rtcore_scene
    except ImportError:
        raise UsageError(
            "Verifying meshes needs Embree, which is not installed. Install it with `pip install 'obpose[meshes]'`."
        ) from None
    return rtcore_scene, mesh_construction
