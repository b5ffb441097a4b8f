"""Inference of scenes from RGB-D frames."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from obpose.data.clips import select_part
from obpose.geometry import sides_of_points, unproject
from obpose.model.attention.given import Labels
from obpose.model.obpose import ObPose
from obpose.model.resolution import fitting_model
from obpose.scenes.appearance import no_appearance
from obpose.scenes.appearance.find_light import find_light
from obpose.scenes.appearance.find_table_texture import find_texture
from obpose.scenes.model_ref import Origin
from obpose.scenes.refine import refine
from obpose.scenes.scene import Camera, Scene
from obpose.types import Inference, Observation, SceneSegmentation

APPEARANCE_FRAMES = 10
"""Number of frames, evenly spaced, from which light and texture are estimated."""


@dataclass(frozen=True, eq=False)
class Inferred:
    """A scene with its segmentation."""

    scene: Scene
    labels: Int[Tensor, "frame seen height width"]
    """Name of the object of every pixel in the views that the model used, 0 = background."""


def infer_scene(
    origin: Origin, observation: Observation, *, refinements: int = 0, labels: Labels | None = None
) -> Scene:
    """Infer the scene of a batch of one clip from the posterior means of its latents.

    The model uses all views or the first one, as in training; the scene has all cameras. With refinements, the scene is
    then fitted to these views in that many steps (`obpose.scenes.refine`), and light and texture are estimated
    (`find_light`, `find_texture`). Without refinements this is the paper's inference.

    Objects are those of `labels`, if they are given, for the views that the model uses; otherwise the model finds them.
    """
    return infer_labelled(origin, observation, refinements=refinements, labels=labels).scene


def infer_labelled(
    origin: Origin, observation: Observation, *, refinements: int = 0, labels: Labels | None = None
) -> Inferred:
    """Infer a scene like `infer_scene`, and give its segmentation too."""
    cameras = cameras_of(observation)
    observation = views_as_trained(origin.model, observation)
    model = fitting_model(origin.model, observation)
    found = model.segment(observation, labels)
    scene = scene_of(found.inference, cameras, origin)
    seen = _seen_extents(observation, found)[[name - 1 for name in scene.ids]]
    scene = scene.with_appearance(half_extent=seen)
    return Inferred(_fitted(model, observation, scene, refinements), found.labels[0])


def fit_to_frames(scene: Scene, model: ObPose, observation: Observation, *, refinements: int) -> Scene:
    """Refine a scene that `infer_scene` inferred without refinements."""
    observation = views_as_trained(model, observation)
    return _fitted(fitting_model(model, observation), observation, scene, refinements)


def _seen_extents(observation: Observation, found: SceneSegmentation) -> Float[Tensor, "slot 3"]:
    """Half edges of the boxes around what the frames show of each slot: their upper quartile over frames, 0 if none.

    In some frames the object is hidden in part, in others labels are wrong.
    """
    boxes, labels = found.inference.boxes, found.labels.masked_fill(~observation.valid, 0)
    extents = sides_of_points(unproject(observation), labels, boxes)[0] / 2
    return extents.nanquantile(0.75, dim=0).nan_to_num(nan=0.0)


def _fitted(model: ObPose, observation: Observation, scene: Scene, refinements: int) -> Scene:
    if not refinements:
        return scene
    scene = refine(model, observation, scene, steps=refinements)
    # Light and table do not change over time, so some frames are enough.
    frames = torch.linspace(0, scene.frames - 1, min(APPEARANCE_FRAMES, scene.frames)).round().long()
    values = {name: getattr(scene, name)[frames] for name in ("what", "center", "rotation", "background")}
    observation, part = select_part(observation, frames=frames), replace(scene, **values)
    light = find_light(model, observation, part)
    return scene.with_appearance(
        light=light, texture=find_texture(model, observation, part.with_appearance(light=light))
    )


def views_as_trained(model: ObPose, observation: Observation) -> Observation:
    """Select the views that the model uses: all if it was trained with all at once, otherwise the first."""
    together = model.config.train.views == "all"
    return observation if together else select_part(observation, views=slice(1))


def scene_of(inference: Inference, cameras: tuple[Camera, ...], origin: Origin) -> Scene:
    """Make a scene of the active slots of a batch of one clip; names of objects are their labels."""
    slots = [slot for slot, active in enumerate(inference.masks.active[0].tolist()) if active]
    assert inference.background is not None
    return Scene(
        ids=tuple(slot + 1 for slot in slots),
        what=inference.what.z[0, :, slots].detach(),
        center=inference.boxes.center[0, :, slots].detach(),
        rotation=inference.boxes.rotation[0, :, slots].detach(),
        appearance=no_appearance(len(slots), inference.what.z.detach()),
        background=inference.background.z[0].detach(),
        cameras=cameras,
        model=origin.hash,
        checkpoint=origin.name,
    )


def cameras_of(observation: Observation) -> tuple[Camera, ...]:
    """Give the cameras of the first clip of a batch."""
    height, width = observation.depth.shape[-2:]
    pairs = zip(observation.k[0], observation.world_from_camera[0], strict=True)
    return tuple(Camera(k, pose, width, height) for k, pose in pairs)
