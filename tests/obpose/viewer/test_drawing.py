import torch

from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Camera
from obpose.viewer.drawing import Drawer, Picture, Shape, Unfinished, Wish, bands, joined, preview_camera
from tests.obpose.scenes.small_scenes import CAMERA, some_model, some_scene


def test_bands_are_the_picture():
    renderer, scene = Renderer(some_model()), some_scene(objects=1)
    camera = CAMERA.resized(100, 90)
    parts = bands(camera)
    assert [part.height for part in parts] == [40, 40, 10]
    whole, *each = (renderer.render(scene, 0, part, antialiased=False) for part in (camera, *parts))
    pieces = joined(each)
    torch.testing.assert_close(pieces.rgb, whole.rgb, atol=1e-4, rtol=0)
    torch.testing.assert_close(pieces.depth, whole.depth, atol=1e-4, rtol=0)
    assert pieces.shares.shape == whole.shares.shape


def test_a_preview_is_the_same_view_at_64_pixels():
    assert preview_camera(CAMERA) is CAMERA
    wide = CAMERA.resized(320, 240)
    small = preview_camera(wide)
    assert (small.width, small.height) == (64, 48)
    torch.testing.assert_close(small.k[:2] * 5, wide.k[:2])


def test_the_preview_comes_first_and_the_whole_picture_last():
    scene = some_scene(objects=2, frames=1)
    pieces = list(drawer().draw(Wish(with_camera(scene, CAMERA.resized(80, 60)), 0, 0, 0.0)))
    kinds = [type(piece) for piece in pieces]
    assert kinds == [Picture, Shape, Shape, Unfinished, Unfinished, Picture]
    first, last = pieces[0], pieces[-1]
    assert isinstance(first, Picture)
    assert isinstance(last, Picture)
    assert first.is_preview
    assert not last.is_preview
    assert last.image.depth.shape == (60, 80)


def test_shapes_are_made_once_and_not_again_after_a_move():
    scene, artist = some_scene(objects=1, frames=1), drawer()
    meshes = [piece.mesh for _ in range(2) for piece in artist.draw(Wish(scene, 0, 0, 0.0)) if isinstance(piece, Shape)]
    assert len(meshes) == 2
    assert meshes[0] is not None
    assert meshes[0] is meshes[1]


def drawer() -> Drawer:
    return Drawer(Renderer(some_model()), some_scene(), None)


def with_camera(scene, camera: Camera):
    return type(scene)(**{**vars(scene), "cameras": (camera,)})
