"""Edits of scenes: each takes scenes and gives a new one; nothing is changed in place.

An edit is of all frames: an object that moves is displaced along its whole way.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.errors import UsageError
from obpose.scenes.scene import Scene


def remove(scene: Scene, name: int) -> Scene:
    """Without this object.

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
        detail=scene.detail[rest],
        alone=scene.alone[rest],
    )


def move(scene: Scene, name: int, by: Float[Tensor, "3"]) -> Scene:
    """With the object displaced, world frame, metres."""
    center = scene.center.clone()
    center[:, scene.place(name)] += by
    return replace(scene, center=center)


def move_to(scene: Scene, name: int, to: Float[Tensor, "3"]) -> Scene:
    """With the middle of the object's box there in the first frame, and its way beyond shifted by as much."""
    return move(scene, name, to - scene.center[0, scene.place(name)])


def rotate(scene: Scene, name: int, by: Float[Tensor, "3 3"]) -> Scene:
    """With the object turned about the middle of its box by a rotation of the world."""
    rotation, place = scene.rotation.clone(), scene.place(name)
    rotation[:, place] = by @ rotation[:, place]
    return replace(scene, rotation=rotation)


def carry(scene: Scene, name: int, by: Float[Tensor, "4 4"]) -> Scene:
    """With the object carried along by a rigid transform of the world, metres."""
    center, rotation, place = scene.center.clone(), scene.rotation.clone(), scene.place(name)
    center[:, place] = center[:, place] @ by[:3, :3].T + by[:3, 3]
    rotation[:, place] = by[:3, :3] @ rotation[:, place]
    return replace(scene, center=center, rotation=rotation)


def swap(scene: Scene, one: int, other: int) -> Scene:
    """With two objects in each other's places; what they are, how they are turned and how high they are goes along.

    Places are those seen from above: of another size an object would stand in the table, or float.

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
    """With a copy of the object beside it, displaced; its name is `scene.new_id()`."""
    return transfer(scene, name, scene, by)


def transfer(source: Scene, name: int, target: Scene, by: Float[Tensor, "3"] | None = None) -> Scene:
    """The target with a copy of the source's object, where it is in the source or displaced from there.

    Where the source has fewer frames its last one stays; its name is `target.new_id()`.

    Raises:
        UsageError: no such object, or the scenes are of different models, whose latents mean different things.
    """
    if source.model != target.model or source.what.shape[-1] != target.what.shape[-1]:
        raise UsageError(
            "The scenes are of different models; an object of one means nothing to the other. Infer both with one."
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
        detail=torch.cat([target.detail, source.detail[place, None]]),
        alone=torch.cat([target.alone, source.alone[place, None]]),
    )


def _with(values: Tensor, one: Tensor) -> Tensor:
    return torch.cat([values, one[:, None]], dim=1)
