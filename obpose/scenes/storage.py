"""Storage of scenes: a folder with `scene.safetensors` and `scene.json`."""

import dataclasses
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from safetensors.torch import save

from datagen.storage.atomic import new_folder, write_atomically
from datagen.storage.safe_io import brief_reason, read_json
from obpose.errors import CorruptFile, UsageError
from obpose.model.nerf.detail import EDGE
from obpose.scenes.appearance import Appearance, no_appearance
from obpose.scenes.appearance.light import is_light, no_light
from obpose.scenes.appearance.table_texture import no_texture
from obpose.scenes.pictures import PICTURE, Picture, write_png
from obpose.scenes.scene import LARGEST_ID, Camera, ClipName, Scene
from obpose.storage.tensors import Form, Forms, State, differences_of, read_tensors

TENSORS, FACTS = "scene.safetensors", "scene.json"
VERSION = 1
"""Version of the file format; raised when older files can no longer be read."""
MOST_OBJECTS = 1000
LARGEST_SIDE = 2**13
"""Largest width and height of a camera's image, pixels."""
_LARGEST_VALUE = 1e6
"""Largest magnitude of a value, far above plausible metres, pixels or units of a latent."""
_ROUNDING = 1e-3
"""Largest difference of R^T R from the identity, as accumulated over many edits."""
_FACTS = {"version", "model", "checkpoint", "objects", "images"}
_SPLITS = "train", "val", "test"
_MOST_FACTS_BYTES, _MOST_TENSOR_BYTES = 2**20, 2**29
_AGAIN = "make the scene again, into another folder."


def save_scene(folder: Path, scene: Scene, picture: Picture | None = None) -> None:
    """Write a scene to a new folder for `load_scene`, optionally with a picture. Nothing remains if writing fails.

    Raises:
        UsageError: the folder exists and is not empty, or the scene is not valid.
        DatagenError: the folder cannot be written, for example because the disk is full.
    """
    if not _is_whole(scene):
        raise UsageError(
            f"The scene holds NaN, values above {_LARGEST_VALUE:g}, or more than {MOST_OBJECTS} objects; nothing was "
            "written. Undo the last edit."
        )
    with new_folder(folder) as unfinished:
        _write(unfinished, scene)
        if picture is not None:
            write_png(unfinished / PICTURE, picture)


def load_scene(folder: Path) -> Scene:
    """Read the scene of a folder.

    Raises:
        UsageError: there is no scene, or its version is unknown.
        CorruptFile: a file is damaged.
    """
    path = folder / FACTS
    if not path.is_file():
        raise UsageError(f"{folder} holds no scene: there is no {FACTS}. obpose-edit infer and sample make one.")
    facts = read_json(path, most_bytes=_MOST_FACTS_BYTES)
    version = facts.get("version") if isinstance(facts, dict) else None
    if type(version) is int and version != VERSION:
        raise UsageError(f"The scene in {folder} is of version {version}, expected {VERSION}; make it again.")
    try:
        parts = _parts(facts)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CorruptFile(f"{path} is damaged ({brief_reason(error)}); {_AGAIN}") from None
    if not (folder / TENSORS).is_file():
        raise CorruptFile(f"{folder / TENSORS} is missing, though there is a {FACTS}; {_AGAIN}")
    check = partial(_check_file, len(parts["ids"]), len(parts["images"]))
    tensors, _ = read_tensors(folder / TENSORS, _AGAIN, check, most_bytes=_MOST_TENSOR_BYTES)
    scene = _assemble(parts, tensors)
    if not _is_whole(scene):
        raise CorruptFile(f"{folder / TENSORS} is damaged (its values are not those of a scene); {_AGAIN}")
    return scene


def _write(folder: Path, scene: Scene) -> None:
    tensors = {
        "what": scene.what,
        "center": scene.center,
        "rotation": scene.rotation,
        "background": scene.background,
        "detail": scene.appearance.detail,
        "alone": scene.appearance.alone,
        "light": scene.appearance.light,
        "pattern": scene.appearance.texture,
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
    write_atomically(folder / TENSORS, save({name: tensor.detach().contiguous() for name, tensor in tensors.items()}))
    write_atomically(folder / FACTS, (json.dumps(facts, indent=1) + "\n").encode())


def _wherever_from(checkpoint: str) -> str:
    """Make the path of a checkpoint absolute; names of shipped weights are kept."""
    place = Path(checkpoint)
    return str(place.resolve()) if place.exists() else checkpoint


def _parts(facts: Any) -> dict[str, Any]:
    """Check the contents of `scene.json` and give its parts by name.

    Raises:
        ValueError, KeyError, TypeError, AttributeError: it is not what `_write` writes.
    """
    names = facts.keys() - {"clip"}
    if names != _FACTS or type(facts["version"]) is not int:
        raise ValueError(f"expected {', '.join(sorted(_FACTS))}")
    if not all(isinstance(facts[name], str) and facts[name].strip() for name in ("model", "checkpoint")):
        raise ValueError("model and checkpoint are no names")
    ids = [_number(name, LARGEST_ID) for name in facts["objects"]]
    if not isinstance(facts["objects"], list) or len(set(ids)) < len(ids) or len(ids) > MOST_OBJECTS:
        raise ValueError(f"objects are not a list of at most {MOST_OBJECTS} different numbers")
    images = [(_number(width, LARGEST_SIDE), _number(height, LARGEST_SIDE)) for width, height in facts["images"]]
    if not isinstance(facts["images"], list) or not images:
        raise ValueError("images are not a list of widths and heights")
    # Scenes of older versions do not name their clip.
    clip = _clip(facts["clip"]) if "clip" in facts else None
    return {"ids": ids, "images": images, "clip": clip, "model": facts["model"], "checkpoint": facts["checkpoint"]}


def _check_file(objects: int, cameras: int, found: Forms) -> None:
    """Check names, types and shapes of a scene's tensors; older versions wrote fewer of them.

    Raises:
        ValueError: a tensor is missing, unknown, or of another type or shape.
    """
    frames, what, background = 0, 0, 0
    if "what" in found and len(found["what"].shape) == 3:
        frames, _, what = found["what"].shape
    if "background" in found and len(found["background"].shape) == 2:
        background = found["background"].shape[1]
    shapes = {
        "what": (frames, objects, what),
        "center": (frames, objects, 3),
        "rotation": (frames, objects, 3, 3),
        "background": (frames, background),
        "k": (cameras, 3, 3),
        "world_from_camera": (cameras, 4, 4),
    }
    later = {
        "detail": (objects, EDGE, EDGE, EDGE, 4),
        "alone": (objects,),
        "light": tuple(no_light().shape),
        "pattern": tuple(no_texture().shape),
    }
    shapes |= {name: shape for name, shape in later.items() if name in found}
    expected = {name: Form(torch.float32, shape) for name, shape in shapes.items()}
    if wrong := differences_of(found, expected):
        raise ValueError(wrong)
    if not frames:
        raise ValueError("it has no frames")


def _assemble(parts: Mapping[str, Any], tensors: State) -> Scene:
    ids, what = parts["ids"], tensors["what"]
    # Scenes of older versions have no appearance, or parts of it.
    nothing = no_appearance(len(ids), what)
    return Scene(
        ids=tuple(ids),
        what=what,
        center=tensors["center"],
        rotation=tensors["rotation"],
        appearance=Appearance(
            tensors.get("detail", nothing.detail),
            tensors.get("alone", nothing.alone),
            tensors.get("light", nothing.light),
            tensors.get("pattern", nothing.texture),
        ),
        background=tensors["background"],
        cameras=tuple(
            Camera(k, pose, width, height)
            for k, pose, (width, height) in zip(
                tensors["k"], tensors["world_from_camera"], parts["images"], strict=True
            )
        ),
        model=parts["model"],
        checkpoint=parts["checkpoint"],
        clip=parts["clip"],
    )


def _clip(facts: dict[str, Any]) -> ClipName:
    if facts.keys() != {"dataset", "split", "index"} or not isinstance(facts["dataset"], str):
        raise ValueError("clip is no clip of a dataset")
    if facts["split"] not in _SPLITS:
        raise ValueError(f"clip is of no split of a dataset, expected one of {', '.join(_SPLITS)}")
    return ClipName(facts["dataset"], facts["split"], _number(facts["index"], LARGEST_ID, least=0))


def _number(value: object, largest: int, *, least: int = 1) -> int:
    if type(value) is not int or not least <= value <= largest:
        raise ValueError(f"{value!r:.40} is not in {least} to {largest}")
    return value


def _is_whole(scene: Scene) -> bool:
    """Whether the arrays fit each other and hold numbers; files may come from anywhere."""
    frames, objects, appearance = scene.frames, len(scene.ids), scene.appearance
    nothing = no_appearance(objects, scene.what)
    looks = [(getattr(appearance, name), getattr(nothing, name)) for name in ("detail", "alone", "light", "texture")]
    sizes = (
        scene.what.shape[:2] == (frames, objects)
        and scene.what.ndim == 3
        and scene.center.shape == (frames, objects, 3)
        and scene.rotation.shape == (frames, objects, 3, 3)
        and scene.background.ndim == 2
        and all(value.shape == none.shape for value, none in looks)
        and frames > 0
        and objects <= MOST_OBJECTS
    )
    values = [scene.what, scene.center, scene.rotation, scene.background, *(value for value, _ in looks)]
    values += [value for camera in scene.cameras for value in (camera.k, camera.world_from_camera)]
    numbers = all(value.dtype == torch.float32 and bool((value.abs() <= _LARGEST_VALUE).all()) for value in values)
    distinct = len(set(scene.ids)) == objects
    seen = len(scene.cameras) > 0 and all(map(_is_camera, scene.cameras))
    return sizes and numbers and distinct and seen and _are_rotations(scene.rotation) and is_light(appearance.light)


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
