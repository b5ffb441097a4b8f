"""Meshes, cameras and datasets of other projects that users bring."""

import json
import shutil
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import ColorVisuals, TextureVisuals

from datagen.geometry import look_at
from tests.fuzz.worlds.group import Group, Target, run

RECIPE = "--recipe moving --frames 2 --workers 1"
VIDEO = f"{RECIPE} --resolution 16x16"
STILLS = "--recipe clevr3d --resolution 320x240 --rig.field-of-view 49.13434 --rig.target 0 0 0 --workers 1"


def build_sources(world: Path) -> None:
    """One mesh of each format, a file of cameras, and one dataset of each format that can be imported."""
    _build_meshes(world / "meshes")
    pose = look_at(np.array([0.8, 0.0, 0.8]), np.zeros(3))
    view = {"width": 16, "height": 16, "fx": 22, "fy": 22, "cx": 8, "cy": 8, "world_from_camera": pose.tolist()}
    (world / "cameras.json").write_text(json.dumps({"convention": "opencv", "views": [view]}))
    run(f"obpose-datagen {VIDEO} --split train=1,test=1 --out {world}/video")
    for name in ("rgbd", "bop", "obpose"):
        run(f"obpose-datagen export --format {name} {world}/video --out {world}/{name}")
    run(f"obpose-datagen {STILLS} --split val=1 --out {world}/stills")
    run(f"obpose-datagen export --format obsurf {world}/stills --out {world}/obsurf")
    for name in ("video", "stills"):
        shutil.rmtree(world / name)


def _build_meshes(folder: Path) -> None:
    """Boxes, so that convex hulls take no time."""
    folder.mkdir(parents=True)
    for name in ("a.ply", "b.stl", "c.glb", "d.obj"):
        mesh = trimesh.creation.box((0.05, 0.06, 0.07))
        if name == "a.ply":
            mesh.visual = ColorVisuals(mesh, vertex_colors=[200, 100, 50, 255])
        if name == "d.obj":
            image = Image.new("RGB", (4, 4), (30, 120, 200))
            mesh.visual = TextureVisuals(uv=np.zeros((len(mesh.vertices), 2)), image=image)
        mesh.export(folder / name, **({"encoding": "ascii"} if name == "a.ply" else {}))


MESHES = [
    "obpose-datagen assets check {w}/meshes --unit m --hull-seconds 2 --out {o}.png",
    f"obpose-datagen {VIDEO} --split train=1 --assets {{w}}/meshes --unit m --hull-seconds 2 --out {{o}}",
]
CAMERAS = [f"obpose-datagen {RECIPE} --split train=1 --cameras {{w}}/cameras.json --out {{o}}"]


def _import(name: str) -> list[str]:
    return [f"obpose-datagen import --format {name} {{w}}/{name} --out {{o}}"]


SOURCES = Group(
    build_sources,
    [
        Target("meshes/a.ply", MESHES, 8),
        Target("meshes/b.stl", MESHES, 6),
        Target("meshes/c.glb", MESHES, 10),
        Target("meshes/d.obj", MESHES, 8),
        Target("meshes/material.mtl", MESHES, 4),
        Target("meshes/material_0.png", MESHES, 4),
        Target("cameras.json", CAMERAS, 12),
        Target("rgbd/train/000000/camera.json", _import("rgbd"), 6),
        Target("rgbd/train/000000/objects.json", _import("rgbd"), 3),
        Target("rgbd/train/000000/world_from_camera.txt", _import("rgbd"), 2),
        Target("rgbd/train/000000/masks/000001.png", _import("rgbd"), 3),
        Target("rgbd/train/000000/depth/000000.png", _import("rgbd"), 3),
        Target("bop/train/000000/scene_camera.json", _import("bop"), 6),
        Target("bop/train/000000/scene_gt.json", _import("bop"), 6),
        Target("bop/train/000000/mask_visib/000000_000000.png", _import("bop"), 2),
        Target("obpose/train/0.npy", _import("obpose"), 10),
        Target("obsurf/metadata.npz", _import("obsurf"), 8),
    ],
)
