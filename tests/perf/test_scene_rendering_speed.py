"""Pictures of inferred scenes against dense sampling of all slots: CPU time, and whether the pictures are equal."""

import math
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import torch

from obpose.creation.infer import infer_scene
from obpose.creation.origin import load_origin
from obpose.creation.rendering import Renderer
from obpose.creation.scene import Scene
from obpose.data import SceneDataset
from obpose.geometry import camera_rays
from obpose.nerf.compose import OUTSIDE
from obpose.nerf.marching import in_box
from obpose.nerf.render import Rendering, render
from obpose.types import Decoded, Observation

MODEL = "obpose--moving--64x64"
ROUNDS, RAYS = 3, 512
AXES = {"colour": 2, "depth": 2, "weights": 3}
GOAL_RATIO, GOAL_DB = 10, 40


def test_a_picture_is_that_of_dense_sampling_and_takes_a_tenth_of_the_time(tiny_dataset: Path):
    torch.set_num_threads(1)
    origin = load_origin(MODEL)
    item = SceneDataset(tiny_dataset, "test")[0]
    names = ("rgb", "depth", "valid", "k", "world_from_camera")
    scene = infer_scene(origin, Observation(**{name: item[name][None] for name in names}))
    fresh = [Renderer(origin.model) for _ in range(ROUNDS)]
    first = [seconds_of(renderer.render, scene) for renderer in fresh]
    again = [seconds_of(renderer.render, scene) for renderer in fresh]
    start = time.process_time()
    dense = densely(fresh[0], scene).colour[0, 0]
    seconds = time.process_time() - start
    image = fresh[0].render(scene)
    equality = -10 * math.log10(float((dense.view_as(image.rgb) - image.rgb).square().mean().clamp(min=1e-12)))
    print(
        f"\n64x64, {len(scene.ids)} objects: {1000 * median(first):.0f} ms, after an edit "
        f"{1000 * median(again):.0f} ms; "
        f"densely {seconds:.1f} s, {seconds / median(first):.0f} times as long (goal {GOAL_RATIO}); PSNR between them "
        f"{equality:.0f} dB (goal {GOAL_DB})"
    )
    assert seconds / median(first) >= GOAL_RATIO
    assert equality >= GOAL_DB


def seconds_of(render: Callable[[Scene], object], scene: Scene) -> float:
    start = time.process_time()
    render(scene)
    return time.process_time() - start


@torch.no_grad()
def densely(renderer: Renderer, scene: Scene) -> Rendering:
    """The first frame from its camera, the fields of all slots at all samples."""
    camera, floor = scene.cameras[0], renderer.model.config.model.table
    components = renderer.components(scene, 0)
    assert floor is not None

    def everywhere(points: torch.Tensor, directions: torch.Tensor) -> Decoded:
        logits, colours = [], []
        for component in components:
            at = in_box(component, points[0, 0])
            logit, hidden = component.field.density(at, component.codes)
            outside = (at.abs() > 1).any(dim=-1) | (points[0, 0, :, 2] <= floor)
            logits.append(logit.masked_fill(outside, OUTSIDE) if component.bounded else logit)
            unit = torch.nn.functional.normalize(directions[0, 0], dim=-1) @ component.rotation
            colours.append(component.field.colour(hidden, unit, component.codes))
        return Decoded(torch.stack(logits)[None, None], torch.stack(colours)[None, None])

    direction, origin = camera_rays(camera.k, camera.world_from_camera, camera.height, camera.width)
    parts = [
        render(everywhere, origin.expand_as(some)[None, None], some[None, None], **renderer.quadrature(camera))
        for some in direction.flatten(0, 1).split(RAYS)
    ]
    return Rendering(*(torch.cat([getattr(part, name) for part in parts], dim=axis) for name, axis in AXES.items()))
