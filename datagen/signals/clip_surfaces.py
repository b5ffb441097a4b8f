"""Surface point behind every pixel of a clip, in the frame of the object that it belongs to."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from datagen.edits.edit_context import Stage
from datagen.render.hits import ANY, Projection, pack_meshes

TABLE, NOTHING = -1, -2
"""Rows of points on the table and of the backdrop, which is infinitely far away."""

SLACK = 1e-4
"""Metres of depth by which another surface must lie in front of a point to hide it."""

_KEPT = 3
"""Number of images whose geometry is kept in memory."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points that move with objects."""

    row: Int[np.ndarray, "point"]
    """Row of the object, `TABLE` or `NOTHING`."""
    local: Float[np.ndarray, "point 3"]
    """Position in the object frame; in the world for the table, and a direction in the world for the backdrop."""
    normal: Float[np.ndarray, "point 3"]
    """Unit normal in the same frame; zeros for the backdrop."""


class ClipSurfaces:
    """Geometry of a clip; images are indexed by frame and view."""

    def __init__(
        self,
        stage: Stage,
        segmentation: UInt8[np.ndarray, "frame view height width"],
        depth: UInt16[np.ndarray, "frame view height width"],
    ):
        self.stage, self.segmentation, self.depth = stage, segmentation, depth
        self.shape = segmentation.shape
        self._meshes = pack_meshes(stage.shapes)
        self.surface = lru_cache(_KEPT)(self._surface)
        self.projection = lru_cache(_KEPT)(self._project)

    @property
    def count(self) -> int:
        """Number of objects."""
        return len(self.stage.shapes)

    @cached_property
    def centers(self) -> Float[np.ndarray, "pixel 2"]:
        """Centres of all pixels of an image, row by row."""
        y, x = np.indices(self.shape[2:]).reshape(2, -1) + 0.5
        return np.stack([x, y], axis=-1)

    def labels(self, frame: int, view: int) -> UInt8[np.ndarray, "height width"]:
        """Ids of an image."""
        return self.segmentation[frame, view]

    def rows(self, frame: int, view: int) -> Int[np.ndarray, "pixel"]:
        """Row of each pixel of an image; see `Points.row`."""
        row = self.segmentation[frame, view].astype(int).ravel() - 1
        return np.where((row < 0) & (self.depth[frame, view].ravel() == 0), NOTHING, row)

    def row_at(self, frame: int, view: int, pixels: Float[np.ndarray, "point 2"]) -> Int[np.ndarray, "point"]:
        """Row of the first surface behind points of an image."""
        hits = self.projection(frame, view).hit(pixels, np.full(len(pixels), ANY))
        with np.errstate(divide="ignore"):
            nearest = 1 / hits.inverse_depth
        table = self._table_depth(pixels, frame, view)
        row = np.where(hits.face >= 0, self._meshes.owners[hits.face] if len(self._meshes.owners) else TABLE, TABLE)
        return np.where(nearest <= table, np.where(np.isfinite(nearest), row, NOTHING), TABLE)

    def points_at(
        self, frame: int, view: int, pixels: Float[np.ndarray, "point 2"], row: Int[np.ndarray, "point"]
    ) -> Points:
        """Points of certain rows behind points of an image."""
        local, normal = np.zeros((len(pixels), 3)), np.zeros((len(pixels), 3))
        objects = row >= 0
        if np.any(objects):
            hits = self.projection(frame, view).hit(pixels[objects], row[objects])
            corners = self._meshes.vertices[self._meshes.faces[hits.face]]
            local[objects] = np.einsum("pc,pcx->px", hits.weights, corners)
            normal[objects] = _unit(np.einsum("pc,pcx->px", hits.weights, self._meshes.normals[hits.face]))
        rest = ~objects
        camera, k = self.stage.scene.cameras[view].at(frame), self._k(view)
        pose = camera.world_from_camera
        rays = _rays(pixels[rest], k) @ pose[:3, :3].T
        table = row[rest] == TABLE
        # The table is the plane z = 0; the backdrop keeps the ray's direction.
        with np.errstate(divide="ignore", invalid="ignore"):
            meets = pose[:3, 3] - (pose[2, 3] / rays[:, 2])[:, None] * rays
        local[rest] = np.where(table[:, None], meets, rays)
        normal[rest] = np.where(table[:, None], [0.0, 0.0, 1.0], 0.0)
        return Points(row, local, normal)

    def move(self, points: Points, frame: int) -> Float[np.ndarray, "point 3"]:
        """World positions of points in a frame; directions for the backdrop."""
        poses = self._poses(frame)[points.row]
        return np.einsum("pij,pj->pi", poses[:, :3, :3], points.local) + poses[:, :3, 3]

    def turn(self, points: Points, frame: int) -> Float[np.ndarray, "point 3"]:
        """World normals of points in a frame."""
        return np.einsum("pij,pj->pi", self._poses(frame)[points.row][:, :3, :3], points.normal)

    def project(
        self, points: Points, world: Float[np.ndarray, "point 3"], frame: int, view: int
    ) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, "point"]]:
        """Image position (pixels) and planar depth of points at their world positions in a frame; inf for the backdrop.

        Points behind the camera get a depth of 0 and no position.
        """
        pose, k = self.stage.scene.cameras[view].at(frame).world_from_camera, self._k(view)
        far = points.row == NOTHING
        local = np.where(far[:, None], world, world - pose[:3, 3]) @ pose[:3, :3]
        z = local[:, 2]
        before = z > 1e-9
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = local[:, :2] / z[:, None] * k[[0, 1], [0, 1]] + k[:2, 2]
        pixels = np.where(before[:, None], pixels, np.nan)
        return pixels, np.where(before, np.where(far, np.inf, z), 0.0)

    def inside(self, pixels: Float[np.ndarray, "point 2"]) -> Bool[np.ndarray, "point"]:
        """Whether image positions lie in the image."""
        height, width = self.shape[2:]
        return np.all((pixels >= 0) & (pixels < [width, height]), axis=-1)

    def hidden(
        self, pixels: Float[np.ndarray, "point 2"], depth: Float[np.ndarray, "point"], frame: int, view: int
    ) -> Bool[np.ndarray, "point"]:
        """Whether points that project into the image lie behind another surface; depth is inf for the backdrop."""
        hits = self.projection(frame, view).hit(pixels, np.full(len(pixels), ANY))
        with np.errstate(divide="ignore"):
            nearest = 1 / hits.inverse_depth
        return np.minimum(nearest, self._table_depth(pixels, frame, view)) < depth - SLACK

    def _table_depth(self, pixels: Float[np.ndarray, "point 2"], frame: int, view: int) -> Float[np.ndarray, "point"]:
        """Depth at which rays through image positions meet the table, inf if they do not."""
        pose, k = self.stage.scene.cameras[view].at(frame).world_from_camera, self._k(view)
        rays = _rays(pixels, k) @ pose[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(rays[:, 2] < 0, -pose[2, 3] / rays[:, 2], np.inf)
            meets = pose[:2, 3] + depth[:, None] * rays[:, :2]
        on_table = np.all(np.abs(meets) <= 0.5 * self.stage.scene.table.size, axis=1)
        return np.where(on_table, depth, np.inf)

    def _k(self, view: int) -> Float[np.ndarray, "3 3"]:
        height, width = self.shape[2:]
        return self.stage.scene.cameras[view].k(width, height)

    def _poses(self, frame: int) -> Float[np.ndarray, "row 4 4"]:
        """Poses by row; the last two are those of the backdrop and the table."""
        return np.concatenate([self.stage.world_from_object[frame], np.tile(np.eye(4), (2, 1, 1))])

    def _surface(self, frame: int, view: int) -> Points:
        return self.points_at(frame, view, self.centers, self.rows(frame, view))

    def _project(self, frame: int, view: int) -> Projection:
        height, width = self.shape[2:]
        camera = self.stage.scene.cameras[view].at(frame)
        return Projection(self._meshes, self.stage.world_from_object[frame], camera, width, height)


def _rays(pixels: Float[np.ndarray, "point 2"], k: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "point 3"]:
    """Directions through points of an image in the camera frame, scaled to z = 1."""
    return np.concatenate([(pixels - k[:2, 2]) / k[[0, 1], [0, 1]], np.ones((len(pixels), 1))], axis=1)


def _unit(vectors: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
    length = np.sqrt(np.sum(vectors * vectors, axis=1, keepdims=True))
    return vectors / np.where(length > 0, length, 1)
