from dataclasses import replace

import torch

from obpose.scenes.rendering import Renderer
from obpose.viewer.rendering import (
    Picture,
    Progress,
    ProgressiveRenderer,
    RenderRequest,
    Shape,
    bands,
    joined,
    with_longer_side,
)
from tests.obpose.scenes.small_scenes import CAMERA, some_model, some_scene


def test_joined_bands_are_the_whole_picture():
    renderer, scene = Renderer(some_model()), some_scene(objects=1)
    camera = CAMERA.resized(100, 90)
    parts = bands(camera)
    assert [part.height for part in parts] == [40, 40, 10]
    whole, *each = (renderer.render(scene, 0, part, antialiased=False) for part in (camera, *parts))
    pieces = joined(each)
    torch.testing.assert_close(pieces.rgb, whole.rgb, atol=1e-4, rtol=0)
    torch.testing.assert_close(pieces.depth, whole.depth, atol=1e-4, rtol=0)
    torch.testing.assert_close(pieces.shares, whole.shares, atol=1e-4, rtol=0)


def test_a_resized_camera_keeps_its_view():
    wide = CAMERA.resized(320, 240)
    small = with_longer_side(wide, 64)
    assert (small.width, small.height) == (64, 48)
    torch.testing.assert_close(small.k[:2] * 5, wide.k[:2])


def test_a_small_picture_comes_first_and_a_large_one_last():
    scene = some_scene(objects=2, frames=1)
    renderer = ProgressiveRenderer(Renderer(some_model()), scene, None, preview=8, final=100)
    wide = replace(scene, cameras=(CAMERA.resized(80, 60),))
    first, *shapes, one, two, last = renderer.render(RenderRequest(wide, 0, 0, 0.0))
    assert isinstance(first, Picture)
    assert isinstance(last, Picture)
    assert (first.is_preview, last.is_preview) == (True, False)
    assert (first.image.depth.shape, last.image.depth.shape) == ((6, 8), (75, 100))
    assert [type(shape) for shape in shapes] == [Shape, Shape]
    assert (one, two) == (Progress(0.5), Progress(1.0))


def test_shapes_depend_on_details_and_are_cached_across_moves():
    scene = some_scene(objects=1, frames=1)
    detailed = scene.with_appearance(detail=torch.ones_like(scene.appearance.detail))
    moved = replace(scene, center=scene.center + 0.1)
    renderer = ProgressiveRenderer(Renderer(some_model()), scene, None, preview=4, final=4)
    chunks = [list(renderer.render(RenderRequest(each, 0, 0, 0.0))) for each in (scene, moved, detailed)]
    first, same, other = (next(each.mesh for each in found if isinstance(each, Shape)) for found in chunks)
    assert first is not None
    assert same is first
    assert other != first
