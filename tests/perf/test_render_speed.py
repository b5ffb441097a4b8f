"""Speed of the rasteriser against five peers that render the same meshes, in the same run on one core.

Every frame has six objects, and gives colour, depth, ids; times are the process' CPU time. Peers that are not installed
are skipped: `pip install mujoco open3d mitsuba "PyOpenGL>=3.1.7"`.
"""

import dataclasses
import time
from typing import Any

import numpy as np
import pytest

from datagen.errors import UsageError
from datagen.render import make_renderer
from datagen.scene import Scene
from datagen.shapes import build
from datagen.shapes.shape import Shape
from tests.perf import render_peers
from tests.perf.render_peers import Frame
from tests.worlds.handmade import FRONT, poses, six_objects

RASTER = "raster, anti-aliased, soft shadow"
MUJOCO = "MuJoCo EGL, shadow"
GOALS = {
    ("pyrender, scene rebuilt each frame", 128): 5.0,
    ("pyrender, scene kept, shadow", 128): 4.0,
    ("PyBullet TinyRenderer, shadow", 128): 1.3,
}
"""Least ratio of the rasteriser's speed to each peer's, by name and size. MuJoCo has the goal 1.5, missed from 512 on:
docs/performance.md."""

World = tuple[Scene, list[Shape]]

medians: dict[tuple[str, int], float] = {}
sizes = pytest.mark.parametrize("size", [128, 512, 1024])
render = pytest.mark.benchmark(group="render", timer=time.process_time)


@pytest.fixture(scope="module")
def world() -> World:
    scene = six_objects()
    return scene, [build(body.shape) for body in scene.bodies]


def measure(benchmark: Any, name: str, frame: Frame, size: int, rounds: int) -> None:
    """Fewer rounds of large images, and fewer still of slow renderers."""
    benchmark.pedantic(frame, rounds=max(3, rounds * 128 // size), warmup_rounds=1)
    medians[name, size] = benchmark.stats.stats.median


@sizes
@render
def test_raster(benchmark: Any, world: World, size: int):
    scene, shapes = world
    renderer, at = make_renderer("raster"), poses(scene)
    renderer.load(scene, shapes)
    measure(benchmark, RASTER, lambda: renderer.render(at, FRONT, size, size), size, 60)


@pytest.mark.parametrize("size", [128, 512])
def test_rich_images_take_at_most_15_percent_longer(world: World, size: int):
    """The recipe clevr3d's kind of scene: six objects, half of them metal."""
    scene, shapes = world
    shiny = [
        dataclasses.replace(b, material=dataclasses.replace(b.material, roughness=0.25, metalness=float(row % 2)))
        for row, b in enumerate(scene.bodies)
    ]
    scene, at = dataclasses.replace(scene, bodies=tuple(shiny)), poses(scene)
    renderers = [make_renderer(name) for name in ("raster", "rich")]
    seconds = np.zeros((40 if size < 200 else 15, 2))
    for renderer in renderers:
        renderer.load(scene, shapes)
        renderer.render(at, FRONT, size, size)
    for turn in seconds:  # in alternation, so that other processes disturb both
        for column, renderer in enumerate(renderers):
            start = time.process_time()
            renderer.render(at, FRONT, size, size)
            turn[column] = time.process_time() - start
    ratio = np.median(seconds[:, 1] / seconds[:, 0])
    print(f"rich {size}: {ratio:.3f} times the CPU time of raster")
    assert ratio <= 1.15


@sizes
@render
def test_pyrender_rebuilt(benchmark: Any, world: World, size: int):
    require("pyrender")
    frame = render_peers.PyrenderPeer(size).rebuilt(*world)
    measure(benchmark, "pyrender, scene rebuilt each frame", frame, size, 20)


@sizes
@render
def test_pyrender_kept_with_shadow(benchmark: Any, world: World, size: int):
    require("pyrender")
    frame = render_peers.PyrenderPeer(size).kept(*world)
    measure(benchmark, "pyrender, scene kept, shadow", frame, size, 20)


@sizes
@render
def test_tiny_renderer_with_shadow(benchmark: Any, world: World, size: int):
    pybullet = pytest.importorskip("pybullet", reason="TinyRenderer is part of PyBullet")
    frame, client = render_peers.tiny(pybullet, *world, size)
    measure(benchmark, "PyBullet TinyRenderer, shadow", frame, size, 20)
    pybullet.disconnect(client)


@sizes
@render
def test_open3d(benchmark: Any, world: World, size: int):
    measure(benchmark, "Open3D, one ray, hard shadow", render_peers.open3d(*world, size), size, 20)


@sizes
@render
def test_mujoco(benchmark: Any, world: World, size: int):
    measure(benchmark, MUJOCO, render_peers.mujoco(*world, size), size, 20)


@sizes
@render
def test_mitsuba(benchmark: Any, world: World, size: int):
    require("mitsuba")
    frame = render_peers.mitsuba(*world, size)
    measure(benchmark, f"Mitsuba, {render_peers.MITSUBA_SAMPLES} paths", frame, size, 3)


def require(name: str) -> None:
    """Skip the test if the renderer of this name cannot start."""
    try:
        make_renderer(name)
    except UsageError as error:
        pytest.skip(str(error))


def test_the_rasteriser_is_as_much_faster_as_promised():
    if not any(name == RASTER for name, _ in medians):
        pytest.skip("needs the measurements above")
    ratios = {key: median / medians[RASTER, key[1]] for key, median in medians.items()}
    for (name, size), median in sorted(medians.items(), key=lambda item: item[0][1]):
        print(f"{size:5} {name:36} {1e3 * median:7.2f} ms {1 / median:6.0f} frames/s {ratios[name, size]:6.2f}x")
    assert {key: ratio for key, ratio in ratios.items() if ratio < GOALS.get(key, 0)} == {}
