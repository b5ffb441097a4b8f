"""Small scenes and an untrained model, for tests of edits and pictures."""

import math

import torch

from obpose.model.build import build_obpose
from obpose.model.nerf.detail import no_detail
from obpose.model.obpose import ObPose
from obpose.scenes.appearance import Appearance
from obpose.scenes.appearance.table_texture import EDGE, PATCH
from obpose.scenes.priors.flow import Flow
from obpose.scenes.priors.grids import DENSITY_LIMIT
from obpose.scenes.priors.tables import Tables
from obpose.scenes.scene import Camera, Scene
from obpose.variants import make_config

CAMERA = Camera(
    torch.tensor([[24.0, 0.0, 8.0], [0.0, 24.0, 6.0], [0.0, 0.0, 1.0]]),
    torch.tensor([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]]),
    width=16,
    height=12,
)
"""A metre above the origin, looking down."""


def some_model(**changes: object) -> ObPose:
    """With fresh weights; all of its slots are in use."""
    torch.manual_seed(0)
    sizes = {"model.workspace_size": 1.0, "model.background_size": 2.5, "model.attention.inactive_points": 0}
    return build_obpose(make_config(**sizes, **changes)).eval()


def dense_flow(latent: int) -> Flow:
    """Its samples are dense wherever their grids are."""
    torch.manual_seed(0)
    flow = Flow(latent)
    flow.shapes.mean.fill_(DENSITY_LIMIT)
    flow.plain_mean[3] = math.log(0.05)
    return flow


def some_scene(*, objects: int = 3, frames: int = 2, seed: int = 0, model: str = "abc") -> Scene:
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(shape, generator=generator)  # noqa: E731
    rotation = torch.linalg.qr(draw(frames, objects, 3, 3))[0]
    above = torch.tensor([0.0, 0.0, 0.2])
    return Scene(
        ids=tuple(range(1, objects + 1)),
        what=draw(frames, objects, 32),
        center=above + 0.2 * draw(frames, objects, 3).clamp(-1, 1),
        rotation=rotation * torch.linalg.det(rotation)[..., None, None],
        background=draw(frames, 32),
        appearance=Appearance(
            detail=draw(*no_detail(objects, above).shape),
            own_scale=torch.zeros(objects),
            half_extent=torch.full((objects, 3), 0.1),
            light=torch.tensor([0.6, 0.0, 0.8, 0.3]),
            texture=0.3 * draw(EDGE, EDGE, 3),
        ),
        cameras=(CAMERA,),
        model=model,
        checkpoint="somewhere",
    )


def some_tables(count: int = 2) -> Tables:
    """With lights and textures of their own."""
    generator = torch.Generator().manual_seed(0)
    across = torch.linspace(0.0, 0.6, count)
    lights = torch.stack([across, torch.zeros(count), (1 - across**2).sqrt(), 0.3 + across / 2], dim=1)
    return Tables(lights, 0.3 * torch.randn(count, PATCH, PATCH, 3, generator=generator))


def _tensors(scene: Scene) -> list[torch.Tensor]:
    looks = scene.appearance
    return [scene.what, scene.center, scene.rotation, scene.background, *vars(looks).values()]


def equal(one: Scene, other: Scene) -> bool:
    return one.ids == other.ids and all(map(torch.equal, _tensors(one), _tensors(other)))


def alike(one: Scene, other: Scene, by: float = 1e-3) -> bool:
    """Equal to rounding, which gradients carry on."""
    close = (torch.allclose(a, b, atol=by, rtol=0) for a, b in zip(_tensors(one), _tensors(other), strict=True))
    return one.ids == other.ids and all(close)
