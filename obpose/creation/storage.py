"""Scenes on disk: a folder with `scene.safetensors` and `scene.json`, nothing pickled."""

import json
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save

from obpose.creation.pictures import PICTURE, Picture, write_png
from obpose.creation.scene import Camera, Scene
from obpose.errors import CorruptFile, UsageError
from obpose.files import new_folder, write_whole

TENSORS, FACTS = "scene.safetensors", "scene.json"
VERSION = 1
"""Of the files; raised when older ones can no longer be read."""


def save_scene(folder: Path, scene: Scene, picture: Picture | None = None) -> None:
    """Write a new folder that `load_scene` reads, with a picture of the scene; all of it is there or nothing.

    Raises:
        UsageError: there is such a folder already, and something is in it.
        DatagenError: it cannot be written, for example because the disk is full.
    """
    with new_folder(folder) as partial:
        _write(partial, scene)
        if picture is not None:
            write_png(partial / PICTURE, picture)


def load_scene(folder: Path) -> Scene:
    """The scene of a folder.

    Raises:
        UsageError: there is none, or it is of another version.
        CorruptFile: a file is damaged.
    """
    if not (folder / FACTS).is_file():
        raise UsageError(f"{folder} holds no scene: there is no {FACTS}. obpose-edit infer and sample make one.")
    damaged = CorruptFile(f"The scene in {folder} is damaged; make it again, into another folder.")
    try:
        facts = json.loads((folder / FACTS).read_text())
        version = facts["version"]
        if version != VERSION:
            raise UsageError(f"The scene in {folder} is of version {version}, expected {VERSION}; make it again.")
        scene = _assemble(facts, load((folder / TENSORS).read_bytes()))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, SafetensorError):
        raise damaged from None
    if not _is_whole(scene):
        raise damaged
    return scene


def _write(folder: Path, scene: Scene) -> None:
    tensors = {
        "what": scene.what,
        "center": scene.center,
        "rotation": scene.rotation,
        "background": scene.background,
        "k": torch.stack([camera.k for camera in scene.cameras]),
        "world_from_camera": torch.stack([camera.world_from_camera for camera in scene.cameras]),
    }
    facts = {
        "version": VERSION,
        "model": scene.model,
        "checkpoint": scene.checkpoint,
        "objects": list(scene.ids),
        "images": [[camera.width, camera.height] for camera in scene.cameras],
    }
    write_whole(folder / TENSORS, save({name: tensor.detach().contiguous() for name, tensor in tensors.items()}))
    write_whole(folder / FACTS, (json.dumps(facts, indent=1) + "\n").encode())


def _assemble(facts: dict, tensors: dict[str, torch.Tensor]) -> Scene:
    images, ids = facts["images"], tuple(int(name) for name in facts["objects"])
    return Scene(
        ids=ids,
        what=tensors["what"],
        center=tensors["center"],
        rotation=tensors["rotation"],
        background=tensors["background"],
        cameras=tuple(
            Camera(k, pose, int(width), int(height))
            for k, pose, (width, height) in zip(tensors["k"], tensors["world_from_camera"], images, strict=True)
        ),
        model=str(facts["model"]),
        checkpoint=str(facts["checkpoint"]),
    )


def _is_whole(scene: Scene) -> bool:
    """Whether the arrays fit each other and hold numbers; files may come from anywhere."""
    frames, objects = scene.frames, len(scene.ids)
    sizes = (
        scene.what.shape[:2] == (frames, objects)
        and scene.center.shape == (frames, objects, 3)
        and scene.rotation.shape == (frames, objects, 3, 3)
        and frames > 0
    )
    distinct = len(set(scene.ids)) == objects and min(scene.ids, default=1) > 0
    cameras = all(
        camera.k.shape == (3, 3) and camera.world_from_camera.shape == (4, 4) and min(camera.width, camera.height) > 0
        for camera in scene.cameras
    )
    values = (scene.what, scene.center, scene.rotation, scene.background)
    return sizes and distinct and cameras and len(scene.cameras) > 0 and all(bool(v.isfinite().all()) for v in values)
