"""Scenes on disk: a folder with `scene.safetensors` and `scene.json`, nothing pickled."""

import dataclasses
import json
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.torch import load, save

from obpose.creation.light import is_light, no_light
from obpose.creation.pattern import no_pattern
from obpose.creation.pictures import PICTURE, Picture, write_png
from obpose.creation.scene import LARGEST_ID, Camera, ClipName, Scene
from obpose.errors import CorruptFile, UsageError
from obpose.files import new_folder, write_whole
from obpose.nerf.detail import no_detail

TENSORS, FACTS = "scene.safetensors", "scene.json"
VERSION = 1
"""Of the files; raised when older ones can no longer be read."""
LARGEST_SIDE = 2**13
"""Pixels along a side of a camera's image."""
_LARGEST_VALUE = 1e6
"""Metres, pixels or units of a latent, far beyond all that are meant."""
_ROUNDING = 1e-3
"""By how much R^T R may differ from 1 after many turns."""


def save_scene(folder: Path, scene: Scene, picture: Picture | None = None) -> None:
    """Write a new folder that `load_scene` reads, with a picture of the scene; all of it is there or nothing.

    Raises:
        UsageError: there is such a folder already, and something is in it; or the scene is none that could be read.
        DatagenError: it cannot be written, for example because the disk is full.
    """
    if not _is_whole(scene):
        raise UsageError("The scene has numbers that are none, or beyond all sense; nothing was written.")
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
        is_whole = _is_whole(scene)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, SafetensorError):
        raise damaged from None
    if not is_whole:
        raise damaged
    return scene


def _write(folder: Path, scene: Scene) -> None:
    tensors = {
        "what": scene.what,
        "center": scene.center,
        "rotation": scene.rotation,
        "detail": scene.detail,
        "alone": scene.alone,
        "background": scene.background,
        "light": scene.light,
        "pattern": scene.pattern,
        "k": torch.stack([camera.k for camera in scene.cameras]),
        "world_from_camera": torch.stack([camera.world_from_camera for camera in scene.cameras]),
    }
    facts = {
        "version": VERSION,
        "model": scene.model,
        "checkpoint": _wherever_from(scene.checkpoint),
        "objects": list(scene.ids),
        "images": [[camera.width, camera.height] for camera in scene.cameras],
    }
    if scene.clip is not None:
        facts["clip"] = dataclasses.asdict(scene.clip)
    write_whole(folder / TENSORS, save({name: tensor.detach().contiguous() for name, tensor in tensors.items()}))
    write_whole(folder / FACTS, (json.dumps(facts, indent=1) + "\n").encode())


def _wherever_from(checkpoint: str) -> str:
    """The path of a folder such that it is found from every current folder; names of shipped weights stay."""
    place = Path(checkpoint)
    return str(place.resolve()) if place.exists() else checkpoint


def _assemble(facts: dict, tensors: dict[str, torch.Tensor]) -> Scene:
    return Scene(
        ids=tuple(_number(name, LARGEST_ID) for name in facts["objects"]),
        what=tensors["what"],
        center=tensors["center"],
        rotation=tensors["rotation"],
        # Scenes of older versions have none.
        detail=tensors.get("detail", no_detail(len(facts["objects"]), tensors["what"])),
        alone=tensors.get("alone", torch.zeros(len(facts["objects"]))),
        background=tensors["background"],
        cameras=tuple(
            Camera(k, pose, _number(width, LARGEST_SIDE), _number(height, LARGEST_SIDE))
            for k, pose, (width, height) in zip(
                tensors["k"], tensors["world_from_camera"], facts["images"], strict=True
            )
        ),
        model=str(facts["model"]),
        checkpoint=str(facts["checkpoint"]),
        # Scenes of older versions do not say it, and have neither.
        clip=_clip(facts["clip"]) if "clip" in facts else None,
        light=tensors.get("light", no_light()),
        pattern=tensors.get("pattern", no_pattern()),
    )


def _clip(facts: dict) -> ClipName:
    return ClipName(str(facts["dataset"]), str(facts["split"]), _number(facts["index"] + 1, LARGEST_ID) - 1)


def _number(value: object, largest: int) -> int:
    if type(value) is not int or not 0 < value <= largest:
        raise ValueError(f"{value} is not in 1 to {largest}")
    return value


def _is_whole(scene: Scene) -> bool:
    """Whether the arrays fit each other and hold numbers; files may come from anywhere."""
    frames, objects = scene.frames, len(scene.ids)
    sizes = (
        scene.what.shape[:2] == (frames, objects)
        and scene.what.ndim == 3
        and scene.center.shape == (frames, objects, 3)
        and scene.rotation.shape == (frames, objects, 3, 3)
        and scene.detail.shape == no_detail(objects, scene.what).shape
        and scene.alone.shape == (objects,)
        and scene.background.ndim == 2
        and scene.light.shape == (4,)
        and scene.pattern.shape == no_pattern().shape
        and frames > 0
    )
    values = [scene.what, scene.center, scene.rotation, scene.detail, scene.alone]
    values += [scene.background, scene.light, scene.pattern]
    values += [value for camera in scene.cameras for value in (camera.k, camera.world_from_camera)]
    numbers = all(value.dtype == torch.float32 and bool((value.abs() <= _LARGEST_VALUE).all()) for value in values)
    distinct = len(set(scene.ids)) == objects
    seen = len(scene.cameras) > 0 and all(map(_is_camera, scene.cameras))
    return sizes and numbers and distinct and seen and _are_rotations(scene.rotation) and is_light(scene.light)


def _are_rotations(rotation: Float[torch.Tensor, "*batch 3 3"]) -> bool:
    """Others would stretch, flatten or mirror the objects."""
    off = (rotation.mT @ rotation - torch.eye(3)).abs()
    return bool((off <= _ROUNDING).all()) and bool((torch.linalg.det(rotation) > 0).all())


def _is_camera(camera: Camera) -> bool:
    k, pose = camera.k, camera.world_from_camera
    if k.shape != (3, 3) or pose.shape != (4, 4):
        return False
    triangular = k[2].tolist() == [0, 0, 1] and float(k[1, 0]) == 0
    return (
        triangular
        and bool((k.diagonal() > 0).all())
        and pose[3].tolist() == [0, 0, 0, 1]
        and _are_rotations(pose[:3, :3])
    )
