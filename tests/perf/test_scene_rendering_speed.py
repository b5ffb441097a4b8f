"""Pictures of inferred scenes against dense sampling of all slots: CPU time, and whether the pictures are equal."""

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import TypeVar

import torch

from benchmark.metrics.images import psnr
from obpose.creation.infer import infer_scene
from obpose.creation.origin import load_origin
from obpose.creation.rendering import Renderer
from obpose.creation.scene import Scene
from obpose.data import SceneDataset
from obpose.types import Observation
from tests.obpose.creation.dense import densely

MODEL = "obpose--moving--64x64"
ROUNDS = 3
GOAL_RATIO, GOAL_DB = 10, 40
T = TypeVar("T")


def test_a_picture_is_that_of_dense_sampling_and_takes_a_tenth_of_the_time(tiny_dataset: Path):
    torch.set_num_threads(1)
    origin = load_origin(MODEL)
    item = SceneDataset(tiny_dataset, "test")[0]
    names = ("rgb", "depth", "valid", "k", "world_from_camera")
    scene = infer_scene(origin, Observation(**{name: item[name][None] for name in names}))
    camera = scene.cameras[0]
    fresh = [Renderer(origin.model) for _ in range(ROUNDS)]
    first, again, smooth = (median(cpu_seconds(fresh, scene, antialiased=each)) for each in (False, False, True))
    # What it is timed against evaluates fields once a sample, where equal pictures need colours from behind as well.
    _, seconds = timed(lambda: densely(fresh[0], scene, camera))
    equal, longer = timed(lambda: densely(fresh[0], scene, camera, behind=origin.model.config.loss.jitter))
    image = fresh[0].render(scene, antialiased=False)
    equality = psnr(equal.colour[0, 0].view_as(image.rgb).numpy(), image.rgb.numpy())
    print(
        f"\n64x64, {len(scene.ids)} objects: {1000 * first:.0f} ms, after an edit {1000 * again:.0f} ms, antialiased "
        f"{1000 * smooth:.0f} ms; "
        f"densely {seconds:.1f} s, {seconds / first:.0f} times as long (goal {GOAL_RATIO}), with colours from behind "
        f"{longer:.1f} s; PSNR between the pictures {equality:.1f} dB (goal {GOAL_DB})"
    )
    assert seconds / first >= GOAL_RATIO
    assert equality >= GOAL_DB


def cpu_seconds(renderers: list[Renderer], scene: Scene, *, antialiased: bool) -> list[float]:
    """Of the picture of each renderer."""
    return [timed(lambda each=each: each.render(scene, antialiased=antialiased))[1] for each in renderers]


def timed(act: Callable[[], T]) -> tuple[T, float]:
    """What it gives, and seconds of CPU time."""
    start = time.process_time()
    result = act()
    return result, time.process_time() - start
