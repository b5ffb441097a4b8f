"""A table with balls on or over it, whose fields are formulas, under a light whose shadows are known."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from obpose.geometry import camera_rays
from obpose.model.nerf.field import Conditioning, Field, Hidden
from obpose.model.obpose import ObPose
from obpose.scenes.appearance.table_texture import no_texture
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Camera, Scene
from obpose.types import Observation
from tests.obpose.analytic_fields import SMALL, BallField
from tests.obpose.scenes.small_scenes import CAMERA, some_model, some_scene

RADIUS = 0.05
"""Radius of the balls, metres."""
GREY = 0.75
"""The table's colour."""
VIEW = CAMERA.resized(64, 48)


class TableField(Field):
    """Everything below the world's z = 0, grey."""

    def __init__(self, center: Tensor, size: float) -> None:
        super().__init__(SMALL, 32)
        self.height = -float(center[2]) * 2 / size

    def density(self, points: Tensor, codes: Conditioning) -> tuple[Tensor, Hidden]:
        logits = (2000 * (self.height - points[..., 2])).clamp(-20, 20)
        return logits, Hidden(points.new_zeros(*logits.shape, 16), None)

    def colour(self, hidden: Hidden, directions: Tensor, codes: Conditioning) -> Tensor:
        return torch.full_like(directions, GREY)


def balls_over_table(*centers: Sequence[float], light: Sequence[float]) -> tuple[ObPose, Scene]:
    """With balls there in one frame."""
    return moving_balls([centers], light=light)


def moving_balls(centers: Sequence[Sequence[Sequence[float]]], *, light: Sequence[float]) -> tuple[ObPose, Scene]:
    """With balls there, frame after frame."""
    model = some_model()
    size = model.config.model.pose.box_size
    model.object_field = BallField(2 * RADIUS / size, latent=32)
    model.background_field = TableField(model.center, model.config.model.background_size)
    frames, objects = len(centers), len(centers[0])
    scene = some_scene(objects=objects, frames=frames)
    places = {"center": torch.tensor(centers), "rotation": torch.eye(3).expand(frames, objects, 3, 3)}
    return model, replace(scene, **places, cameras=(VIEW,)).with_appearance(
        light=torch.tensor(light), texture=no_texture()
    )


def table_points(camera: Camera) -> Tensor:
    """Points of the table in the middles of pixels; height, width, 3."""
    direction, origin = camera_rays(camera.k, camera.world_from_camera, camera.height, camera.width)
    return origin - direction * (origin[2] / direction[..., 2:])


def observed(model: ObPose, scene: Scene) -> Observation:
    """Observation of the scene's camera."""
    renderer, camera = Renderer(model), scene.cameras[0]
    images = [renderer.render(scene, frame) for frame in range(scene.frames)]
    depth = torch.stack([image.depth for image in images])[None, :, None]
    rgb = torch.stack([image.rgb for image in images])[None, :, None]
    return Observation(rgb, depth, depth > 0, camera.k[None, None], camera.world_from_camera[None, None])
