"""Storage of scenes: a folder with `scene.safetensors` and `scene.json`."""

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from safetensors.torch import save

from datagen.storage.atomic import new_folder, write_atomically
from datagen.storage.safe_io import brief_reason, read_json
from datagen.storage.structure import strict_converter, structure
from obpose.errors import CorruptFile, UsageError
from obpose.model.nerf.detail import EDGE
from obpose.scenes.appearance import Appearance, no_appearance
from obpose.scenes.appearance.light import is_light, no_light
from obpose.scenes.appearance.table_texture import no_texture
from obpose.scenes.pictures import PICTURE, Picture, write_png
from obpose.scenes.scene import LARGEST_ID, Camera, ClipName, Scene
from obpose.storage.tensors import Form, Forms, State, differences_of, forms_of, read_tensors

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
_MOST_FACTS_BYTES, _MOST_TENSOR_BYTES = 2**20, 2**29
_AGAIN = "make the scene again, into another folder."


@dataclass(frozen=True)
class _Facts:
    """Contents of `scene.json`."""

    version: int
    model: str
    checkpoint: str
    objects: tuple[int, ...]
    images: tuple[tuple[int, int], ...]
    """Width and height of each camera's image."""
    clip: ClipName | None = None
    """Scenes of older versions do not name their clip."""


def save_scene(folder: Path, scene: Scene, picture: Picture | None = None) -> None:
    """Write a scene to a new folder for `load_scene`, optionally with a picture. Nothing remains if writing fails.

    Raises:
        UsageError: the folder exists and is not empty, or the scene is not valid.
        DatagenError: the folder cannot be written, for example because the disk is full.
    """
    tensors = {
        "what": scene.what,
        "center": scene.center,
        "rotation": scene.rotation,
        "background": scene.background,
        "detail": scene.appearance.detail,
        "alone": scene.appearance.own_scale,
        "half_extent": scene.appearance.half_extent,
        "light": scene.appearance.light,
        "pattern": scene.appearance.texture,
        "k": torch.stack([camera.k for camera in scene.cameras]),
        "world_from_camera": torch.stack([camera.world_from_camera for camera in scene.cameras]),
    }
    if not _is_whole(scene.ids, tensors):
        raise UsageError(
            f"The scene holds NaN, values above {_LARGEST_VALUE:g}, more than {MOST_OBJECTS} objects, or arrays that "
            "do not fit together; nothing was written. In the viewer, undo the last edit."
        )
    # Paths of checkpoints become absolute; names of shipped weights are kept.
    checkpoint = str(Path(scene.checkpoint).resolve()) if Path(scene.checkpoint).exists() else scene.checkpoint
    images = tuple((camera.width, camera.height) for camera in scene.cameras)
    facts = dataclasses.asdict(_Facts(VERSION, scene.model, checkpoint, scene.ids, images, scene.clip))
    if scene.clip is None:
        del facts["clip"]
    with new_folder(folder) as unfinished:
        contents = {name: tensor.detach().contiguous() for name, tensor in tensors.items()}
        write_atomically(unfinished / TENSORS, save(contents))
        write_atomically(unfinished / FACTS, (json.dumps(facts, indent=1) + "\n").encode())
        if picture is not None:
            write_png(unfinished / PICTURE, picture)


def load_scene(folder: Path) -> Scene:
    """Read the scene of a folder.

    Raises:
        UsageError: there is no scene, or its version is unknown.
        CorruptFile: a file is damaged.
    """
    # Facts, as a dataclass with strict types.
    path = folder / FACTS
    if not path.is_file():
        raise UsageError(f"{folder} holds no scene: there is no {FACTS}. obpose-edit infer and sample make one.")
    plain = read_json(path, most_bytes=_MOST_FACTS_BYTES)
    version = plain.get("version") if isinstance(plain, dict) else None
    if type(version) is int and version != VERSION:
        raise UsageError(f"The scene in {folder} is of version {version}, expected {VERSION}; make it again.")
    try:
        facts = structure(plain, _Facts, strict_converter())
        _check_facts(facts, plain)
    except ValueError as error:
        raise CorruptFile(f"{path} is damaged ({brief_reason(error)}); {_AGAIN}") from None
    # Tensors, whose shapes follow from the facts.
    if not (folder / TENSORS).is_file():
        raise CorruptFile(f"{folder / TENSORS} is missing, though there is a {FACTS}; {_AGAIN}")
    expect = partial(_expected_file, len(facts.objects), len(facts.images))
    tensors, _ = read_tensors(folder / TENSORS, _AGAIN, expect, most_bytes=_MOST_TENSOR_BYTES)
    if not _is_whole(facts.objects, tensors):
        raise CorruptFile(f"{folder / TENSORS} is damaged (its values are not those of a scene); {_AGAIN}")
    # Scenes of older versions have no appearance, or parts of it.
    nothing = no_appearance(len(facts.objects), tensors["what"])
    cameras = zip(tensors["k"], tensors["world_from_camera"], facts.images, strict=True)
    return Scene(
        ids=facts.objects,
        what=tensors["what"],
        center=tensors["center"],
        rotation=tensors["rotation"],
        appearance=Appearance(
            tensors.get("detail", nothing.detail),
            tensors.get("alone", nothing.own_scale),
            tensors.get("half_extent", nothing.half_extent),
            tensors.get("light", nothing.light),
            tensors.get("pattern", nothing.texture),
        ),
        background=tensors["background"],
        cameras=tuple(Camera(k, pose, *size) for k, pose, size in cameras),
        model=facts.model,
        checkpoint=facts.checkpoint,
        clip=facts.clip,
    )


def _check_facts(facts: _Facts, plain: dict[str, Any]) -> None:
    """Check names, numbers and sizes.

    Raises:
        ValueError: they are not those of a scene.
    """
    if not facts.model.strip() or not facts.checkpoint.strip():
        raise ValueError("model and checkpoint are no names")
    ids, sides = facts.objects, [side for size in facts.images for side in size]
    if len(set(ids)) < len(ids) or len(ids) > MOST_OBJECTS or not all(0 < name <= LARGEST_ID for name in ids):
        raise ValueError(f"objects are not a list of at most {MOST_OBJECTS} different numbers in 1 to {LARGEST_ID}")
    if not sides or not all(0 < side <= LARGEST_SIDE for side in sides):
        raise ValueError(f"images are not a list of widths and heights in 1 to {LARGEST_SIDE}")
    if "clip" in plain and (facts.clip is None or not 0 <= facts.clip.index <= LARGEST_ID):
        raise ValueError("clip is no clip of a dataset")


def _expected_file(objects: int, cameras: int, found: Forms) -> Forms:
    """Give names, types and shapes of a scene's tensors; older versions wrote fewer of them."""
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
    # Tensors that older versions did not write.
    later = {
        "detail": (objects, EDGE, EDGE, EDGE, 4),
        "alone": (objects,),
        "half_extent": (objects, 3),
        "light": tuple(no_light().shape),
        "pattern": tuple(no_texture().shape),
    }
    shapes |= {name: shape for name, shape in later.items() if name in found}
    return {name: Form(torch.float32, shape) for name, shape in shapes.items()}


def _is_whole(ids: Sequence[int], tensors: State) -> bool:
    """Whether arrays fit each other and hold numbers of a scene; files may come from anywhere."""
    found = forms_of(tensors)
    if differences_of(found, _expected_file(len(ids), len(tensors["k"]), found)) or not len(tensors["what"]):
        return False
    k, pose, light = tensors["k"], tensors["world_from_camera"], tensors.get("light", no_light())
    half_extent = tensors.get("half_extent", torch.zeros(()))
    return (
        len(set(ids)) == len(ids) <= MOST_OBJECTS
        and all(bool((value.abs() <= _LARGEST_VALUE).all()) for value in tensors.values())
        and _are_rotations(tensors["rotation"])
        and _are_rotations(pose[:, :3, :3])
        and bool((pose[:, 3] == torch.tensor([0.0, 0.0, 0.0, 1.0])).all())
        and bool((k[:, 2] == torch.tensor([0.0, 0.0, 1.0])).all() and (k[:, 1, 0] == 0).all())
        and bool((k.diagonal(dim1=1, dim2=2) > 0).all())
        and is_light(light)
        and bool((half_extent >= 0).all())
    )


def _are_rotations(rotation: Float[torch.Tensor, "*batch 3 3"]) -> bool:
    """Others would stretch, flatten or mirror the objects."""
    off = (rotation.mT @ rotation - torch.eye(3)).abs()
    return bool((off <= _ROUNDING).all()) and bool((torch.linalg.det(rotation) > 0).all())
