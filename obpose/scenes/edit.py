"""Edits of scenes. Each gives a new scene and changes nothing in place.

Edits apply to all frames: the whole trajectory of a moving object is displaced.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.errors import UsageError
from obpose.scenes.scene import Scene


def remove(scene: Scene, name: int) -> Scene:
    """Remove an object.

    Raises:
        UsageError: there is no such object, as in all edits.
    """
    place = scene.place(name)
    rest = [other for other in range(len(scene.ids)) if other != place]
    return replace(
        scene,
        ids=tuple(scene.ids[other] for other in rest),
        what=scene.what[:, rest],
        center=scene.center[:, rest],
        rotation=scene.rotation[:, rest],
        appearance=scene.appearance.only(rest),
    )


def move(scene: Scene, name: int, by: Float[Tensor, "3"]) -> Scene:
    """Displace an object, world frame, metres."""
    center = scene.center.clone()
    center[:, scene.place(name)] += by
    return replace(scene, center=center)


def move_to(scene: Scene, name: int, to: Float[Tensor, "3"]) -> Scene:
    """Move the centre of an object's box to a point in the first frame; later frames are shifted equally."""
    return move(scene, name, to - scene.center[0, scene.place(name)])


def rotate(scene: Scene, name: int, by: Float[Tensor, "3 3"]) -> Scene:
    """Turn an object about the centre of its box by a rotation in the world frame."""
    rotation, place = scene.rotation.clone(), scene.place(name)
    rotation[:, place] = by @ rotation[:, place]
    return replace(scene, rotation=rotation)


def carry(scene: Scene, name: int, by: Float[Tensor, "4 4"]) -> Scene:
    """Apply a rigid transform of the world to an object, metres."""
    center, rotation, place = scene.center.clone(), scene.rotation.clone(), scene.place(name)
    center[:, place] = center[:, place] @ by[:3, :3].T + by[:3, 3]
    rotation[:, place] = by[:3, :3] @ rotation[:, place]
    return replace(scene, center=center, rotation=rotation)


def swap(scene: Scene, one: int, other: int) -> Scene:
    """Exchange the horizontal positions of two objects.

    Orientation and height stay with each object, so that neither sinks into the table nor floats.

    Raises:
        UsageError: no such object, or both are the same.
    """
    if one == other:
        raise UsageError(f"Object {one} cannot change places with itself; name two objects.")
    a, b = scene.place(one), scene.place(other)
    center = scene.center.clone()
    center[:, [a, b], :2] = scene.center[:, [b, a], :2]
    return replace(scene, center=center)


def duplicate(scene: Scene, name: int, by: Float[Tensor, "3"]) -> Scene:
    """Add a displaced copy of an object; its name is `scene.new_id()`."""
    return transfer(scene, name, scene, by)


def transfer(source: Scene, name: int, target: Scene, by: Float[Tensor, "3"] | None = None) -> Scene:
    """Add a copy of the source's object to the target, at its pose in the source or displaced from it.

    If the source has fewer frames, its last one is repeated. The name of the copy is `target.new_id()`.

    Raises:
        UsageError: no such object, or the scenes belong to different models, whose latents are not comparable.
    """
    if source.model != target.model or source.what.shape[-1] != target.what.shape[-1]:
        raise UsageError(
            "The scenes belong to different models, whose codes are not comparable. Infer both with the same one."
        )
    place = source.place(name)
    frames = torch.arange(target.frames).clamp(max=source.frames - 1)
    center = source.center[frames, place] + (0.0 if by is None else by)
    return replace(
        target,
        ids=(*target.ids, target.new_id()),
        what=_with(target.what, source.what[frames, place]),
        center=_with(target.center, center),
        rotation=_with(target.rotation, source.rotation[frames, place]),
        appearance=target.appearance.with_object(source.appearance, place),
    )


def _with(values: Tensor, one: Tensor) -> Tensor:
    return torch.cat([values, one[:, None]], dim=1)
