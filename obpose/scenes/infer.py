"""From RGB-D frames to a scene."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Int
from torch import Tensor

from obpose.data.clips import select_part
from obpose.data.resolution import fitting_model
from obpose.model.nerf.detail import no_detail
from obpose.model.obpose import ObPose
from obpose.scenes.appearance.find_light import find_light
from obpose.scenes.appearance.find_table_texture import find_pattern
from obpose.scenes.model_ref import Origin
from obpose.scenes.refine import refine
from obpose.scenes.scene import Camera, Scene
from obpose.types import Inference, Observation

LOOKED_AT = 10
"""Frames of a longer clip in which light and pattern are looked for, evenly spaced."""


@dataclass(frozen=True, eq=False)
class Inferred:
    """A scene, and where its objects are seen."""

    scene: Scene
    labels: Int[Tensor, "frame seen height width"]
    """Name of the object of every pixel in the views that the model got, 0 = background."""


def infer_scene(origin: Origin, observation: Observation, *, refinements: int = 0) -> Scene:
    """The scene of a batch of one clip, with the posterior means of its latents, as it is segmented.

    Of several views the model gets what it was trained with, all or the first; the scene has the cameras of all.
    It is then fitted to these views in so many steps (`obpose.scenes.refine`), and light and pattern are looked for
    (`find_light`, `find_pattern`); without steps, which is the paper's inference, it has neither.
    """
    return infer_labelled(origin, observation, refinements=refinements).scene


def infer_labelled(origin: Origin, observation: Observation, *, refinements: int = 0) -> Inferred:
    """The same with its segmentation."""
    cameras = cameras_of(observation)
    observation = views_as_trained(origin.model, observation)
    model = fitting_model(origin.model, observation)
    found = model.segment(observation)
    scene = _fitted(model, observation, scene_of(found.inference, cameras, origin), refinements)
    return Inferred(scene, found.labels[0])


def fit_to_frames(scene: Scene, model: ObPose, observation: Observation, *, refinements: int) -> Scene:
    """What `infer_scene` comes to with refinements, from what it comes to without."""
    observation = views_as_trained(model, observation)
    return _fitted(fitting_model(model, observation), observation, scene, refinements)


def _fitted(model: ObPose, observation: Observation, scene: Scene, refinements: int) -> Scene:
    if not refinements:
        return scene
    scene = refine(model, observation, scene, steps=refinements)
    # Light and table are the same in all frames, of which some are enough.
    frames = torch.linspace(0, scene.frames - 1, min(LOOKED_AT, scene.frames)).round().long()
    observation, part = select_part(observation, frames=frames), _part(scene, frames)
    light = find_light(model, observation, part)
    return replace(scene, light=light, pattern=find_pattern(model, observation, replace(part, light=light)))


def _part(scene: Scene, frames: Int[Tensor, " some"]) -> Scene:
    """Some frames, as if there were no others."""
    values = {name: getattr(scene, name)[frames] for name in ("what", "center", "rotation", "background")}
    return replace(scene, **values)


def views_as_trained(model: ObPose, observation: Observation) -> Observation:
    """All views where the model was trained with all at once, or else the first."""
    together = model.config.train.views == "all"
    return observation if together else select_part(observation, views=slice(1))


def scene_of(inference: Inference, cameras: tuple[Camera, ...], origin: Origin) -> Scene:
    """The objects in use of a batch of one clip; they have the names that they have as labels."""
    slots = [slot for slot, active in enumerate(inference.masks.active[0].tolist()) if active]
    assert inference.background is not None
    return Scene(
        ids=tuple(slot + 1 for slot in slots),
        what=inference.what.z[0, :, slots].detach(),
        center=inference.boxes.center[0, :, slots].detach(),
        rotation=inference.boxes.rotation[0, :, slots].detach(),
        detail=no_detail(len(slots), inference.what.z.detach()),
        alone=inference.what.z.new_zeros(len(slots)),
        background=inference.background.z[0].detach(),
        cameras=cameras,
        model=origin.hash,
        checkpoint=origin.name,
    )


def cameras_of(observation: Observation) -> tuple[Camera, ...]:
    """Of the first clip."""
    height, width = observation.depth.shape[-2:]
    pairs = zip(observation.k[0], observation.world_from_camera[0], strict=True)
    return tuple(Camera(k, pose, width, height) for k, pose in pairs)
