"""Two balls on a table, photographed exactly, and written in the layouts of other projects."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from datagen.geometry import invert_rigid, look_at

SIZE = (48, 36)
"""Width and height."""
FOCAL = 35 / 32 * SIZE[0]
BALLS = (((0.05, -0.03, 0.08), 0.08), ((-0.12, 0.1, 0.05), 0.05))
"""Centre and radius, metres; ids 1 and 2."""
COLOURS = np.array([(120, 110, 100), (200, 30, 30), (30, 30, 200)], np.uint8)
CAMERAS = ((0.6, 0.1, 0.5), (-0.3, 0.6, 0.55), (0.1, -0.7, 0.4))
"""Positions of cameras that look at the origin, metres."""


@dataclass(frozen=True, eq=False)
class Shot:
    """An image in the project's conventions."""

    rgb: np.ndarray
    depth: np.ndarray
    """Planar, metres."""
    ids: np.ndarray
    k: np.ndarray
    pose: np.ndarray
    """world_from_camera."""

    @property
    def distance(self) -> np.ndarray:
        """Euclidean depth, metres."""
        return self.depth * np.linalg.norm(rays(self.k), axis=-1)


def rays(k: np.ndarray, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Points at depth 1 of all pixels, camera frame."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    return np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(k).T


def shoot(position: Sequence[float] = CAMERAS[0], size: tuple[int, int] = SIZE) -> Shot:
    """Photograph the balls from a place."""
    k = np.array([[FOCAL, 0, size[0] / 2], [0, FOCAL, size[1] / 2], [0, 0, 1]])
    pose = look_at(np.array(position), np.zeros(3))
    direction, origin = rays(k, size) @ pose[:3, :3].T, pose[:3, 3]
    depth = np.where(direction[..., 2] < 0, -origin[2] / direction[..., 2], 5.0)
    ids = np.zeros(depth.shape, np.uint8)
    for row, (center, radius) in enumerate(BALLS):
        away = origin - np.array(center)
        a, b, c = (direction**2).sum(-1), direction @ away, away @ away - radius**2
        root = np.sqrt(np.maximum(b**2 - a * c, 0))
        hit = (b**2 > a * c) & ((-b - root) / a < depth)
        depth = np.where(hit, (-b - root) / a, depth)
        ids[hit] = row + 1
    return Shot(COLOURS[ids], depth, ids, k, pose)


def errors(record: dict[str, np.ndarray]) -> dict[int, float]:
    """Largest distance of any pixel's point from the surface of its id, metres, after an import with masks."""
    found: dict[int, float] = {}
    for frame, view in np.ndindex(*record["depth"].shape[:2]):
        size = record["depth"].shape[3], record["depth"].shape[2]
        points = rays(record["camera/K"][view], size) * (record["depth"][frame, view] * 1e-4)[..., None]
        pose = record["camera/world_from_camera"][view]
        points = points @ pose[:3, :3].T + pose[:3, 3]
        ids = record["segmentation"][frame, view]
        off = {0: np.abs(points[..., 2])}
        off |= {
            row + 1: np.abs(np.linalg.norm(points - np.array(center), axis=-1) - radius)
            for row, (center, radius) in enumerate(BALLS)
        }
        for name, distances in off.items():
            found[name] = max(found.get(name, 0.0), float(np.max(distances[ids == name], initial=0)))
    return found


def save(path: Path, array: np.ndarray) -> Path:
    """Write an image file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(array).save(path)
    return path


def units(depth: np.ndarray, scale: float) -> np.ndarray:
    """Depth as whole units of `scale` metres."""
    return np.rint(depth / scale).astype(np.uint16)


def camera_json(shot: Shot, **more: Any) -> dict[str, Any]:
    """Content of camera.json, in OpenCV's convention."""
    (fx, _, cx), (_, fy, cy), _ = shot.k.tolist()
    return {"fx": fx, "fy": fy, "cx": cx - 0.5, "cy": cy - 0.5, "depth_scale": 1e-4, **more}


def write_json(path: Path, values: Any) -> Path:
    """Write a JSON file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values))
    return path


def write_rgbd(folder: Path, shots: Sequence[Shot], *, masks: bool = True, **more: Any) -> Path:
    """A recording in the layout of `rgbd`, without poses unless `more` has them."""
    for number, shot in enumerate(shots):
        save(folder / "rgb" / f"{number}.png", shot.rgb)
        save(folder / "depth" / f"{number}.png", units(shot.depth, 1e-4))
        if masks:
            save(folder / "masks" / f"{number}.png", shot.ids)
    write_json(folder / "camera.json", camera_json(shots[0], **more))
    return folder


def write_obsurf(folder: Path, *, multishapenet: bool = False, scenes: Sequence[int] = (0, 1)) -> Path:
    """Scenes of CLEVR-3D, Euclidean depth, or MultiShapeNet, planar; one scene unit is 0.1 m."""
    count = max(scenes) + 1
    shape = np.zeros((count, 10), np.int64)
    shape[:, :2] = 1
    more = {"shape_file": np.array([["a", "b"]] * count)} if multishapenet else {}
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "metadata.npz", shape=shape, camera_pos=np.array([CAMERAS] * count) * 10, **more)
    for scene in scenes:
        for view, position in enumerate(CAMERAS):
            shot = shoot(position)
            alpha = np.full((*shot.ids.shape, 1), 40 * view, np.uint8)
            save(folder / f"images/img_{scene}_{view}.png", np.concatenate([shot.rgb, alpha], axis=2))
            depth = shot.depth if multishapenet else shot.distance
            save(folder / f"depths/depths_{scene}_{view}.png", units(depth, 0.1 / 1638.4))
            save(folder / f"masks/masks_{scene}_{view}.png", shot.ids)
    return folder


def write_bop(folder: Path) -> Path:
    """One scene of BOP."""
    cameras, truth = {}, {}
    for number, position in enumerate(CAMERAS):
        shot = shoot(position)
        save(folder / "rgb" / f"{number:06d}.png", shot.rgb)
        save(folder / "depth" / f"{number:06d}.png", units(shot.depth, 1e-4))
        for row in range(2):
            save(folder / "mask_visib" / f"{number:06d}_{row:06d}.png", 255 * (shot.ids == row + 1).astype(np.uint8))
        k = shot.k - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        camera_from_world = invert_rigid(shot.pose)
        cameras[str(number)] = {
            "cam_K": k.ravel().tolist(),
            "cam_R_w2c": camera_from_world[:3, :3].ravel().tolist(),
            "cam_t_w2c": (1000 * camera_from_world[:3, 3]).tolist(),
            "depth_scale": 0.1,
        }
        truth[str(number)] = [{"obj_id": 2}, {"obj_id": 7}]
    write_json(folder / "scene_camera.json", cameras)
    write_json(folder / "scene_gt.json", truth)
    return folder


def write_octscenes(folder: Path) -> Path:
    """Scene 0 without masks and scene 4900 with masks, three images each."""
    for scene in (0, 4900):
        for number, position in enumerate(CAMERAS):
            shot, name = shoot(position), f"{scene:04d}_{number:02d}"
            save(folder / "image_48x36" / f"{name}.png", shot.rgb)
            save(folder / "depth_48x36" / f"{name}.png", units(shot.depth, 1e-3))
            if scene:
                save(folder / "segment_48x36" / f"{name}.png", shot.ids)
            (folder / "pose").mkdir(exist_ok=True)
            np.savetxt(folder / "pose" / f"{name}.txt", shot.pose)
    np.savetxt(folder / "intrinsic_48x36.txt", shoot().k - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
    return folder


def authors_frame(shot: Shot) -> dict[str, Any]:
    """A frame as the paper's authors store it."""
    return {
        "rgb": shot.rgb / 255,
        "depth": shot.depth,
        "mask_bin": shot.ids[..., None] == np.arange(3),
        "obj_list": [{"name": "mug"}, {"name": "bowl"}],
        "pcd": (rays(shot.k) * shot.depth[..., None]) @ shot.pose[:3, :3].T + shot.pose[:3, 3],
    }


def authors_camera(shot: Shot) -> dict[str, np.ndarray]:
    """A camera as the paper's authors store it: x points left, y up, and pixel centres are whole numbers."""
    k = np.array([[-FOCAL, 0, shot.k[0, 2] - 0.5], [0, -FOCAL, shot.k[1, 2] - 0.5], [0, 0, 1]])
    return {"camera_intrinsics": k, "camera_extrinsics": shot.pose @ np.diag([-1.0, -1, 1, 1])}


def write_authors(folder: Path) -> Path:
    """Two training clips and a test clip of three frames, as the paper's authors store them."""
    shot = shoot()
    for place in ("train/0", "train/1", "test/0"):
        path = folder / f"{place}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, np.array([authors_frame(shot) for _ in range(3)], object), allow_pickle=True)
    np.save(folder / "camera_info.npy", np.array(authors_camera(shot), object), allow_pickle=True)
    return folder
