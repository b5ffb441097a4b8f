"""Textures: bilinear values, coarse levels where a texel is small, and no seams from unused parts of an atlas."""

import dataclasses

import numpy as np
import pytest

from datagen.geometry import rigid
from datagen.meshes.build import make_shape, mass_of, place
from datagen.meshes.hulls import convex_corners
from datagen.meshes.read import RawMesh
from datagen.meshes.skins import make_skin
from datagen.render import kernels, make_renderer
from datagen.render.raster import _pack_skins
from datagen.render.renderer import PathTracer
from datagen.scene import Body, Camera, Light, Material, Scene, ShapeSpec, Table
from datagen.shapes.shape import Shape
from tests.worlds.meshes import BOX, triangles


def raw_box(image: np.ndarray, uv: np.ndarray) -> RawMesh:
    """A box of 10 cm whose every triangle has the same texture coordinates."""
    return RawMesh(
        vertices=0.05 * BOX,
        faces=triangles(),
        uv=np.broadcast_to(uv, (12, 3, 2)).astype(float),
        colors=np.ones((12, 3, 3)),
        image=np.zeros(12, int),
        images=(image,),
        has_colors=True,
        parts=1,
        sha256="0" * 64,
        problems=(),
    )


def build(raw: RawMesh) -> Shape:
    placed = place(raw, 1.0, "z", "box")
    hulls = (convex_corners(placed.surface.vertices),)
    return make_shape(placed, mass_of(placed.surface, hulls), hulls)


def sample(shape: Shape, weights: tuple[float, float, float], width: float, *, rich: bool = False) -> np.ndarray:
    skins, out = _pack_skins([shape], np.array([0, len(shape.faces)])), np.zeros(3)
    kernels._skin(skins, 0, *weights, width, rich, out)
    return out


CORNERS = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75]])


def test_values_between_texels_are_interpolated():
    image = np.zeros((2, 2, 3), np.uint8)
    image[:, 1] = 255
    shape = build(raw_box(image, CORNERS))
    # The corners lie in the middles of three texels.
    values = [sample(shape, (1 - share, share, 0.0), 1e-6)[0] for share in (0.0, 0.25, 0.5, 1.0)]
    np.testing.assert_allclose(values, [0, 0.25, 0.5, 1], atol=1e-6)


def test_small_texels_are_averaged_in_linear_light():
    image = np.indices((64, 64)).sum(axis=0)[..., None] % 2 * np.full(3, 255, np.uint8)
    shape = build(raw_box(image.astype(np.uint8), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])))
    np.testing.assert_allclose(sample(shape, (0.3, 0.3, 0.4), 0.1), 0.5, atol=0.01)
    across, down = (np.arange(2) + 0.5) / 64, 0.5 / 64
    sharp = [sample(shape, (1 - share - down, share, down), 1e-6)[0] for share in across]
    np.testing.assert_allclose(sorted(sharp), [0, 1], atol=1e-3)


def test_rich_images_show_no_texels():
    image = np.random.default_rng(0).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    shape = build(raw_box(image, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])))
    bends = []
    for rich in (False, True):
        line = [sample(shape, (0.5 - x, x, 0.5), 1e-6, rich=rich) for x in np.linspace(0, 0.5, 401)]
        assert np.min(line) >= 0
        bends.append(np.abs(np.diff(line, n=2, axis=0)).max() / np.ptp(line))
    assert bends[1] < 0.15 * bends[0]


def test_unused_texels_do_not_bleed_into_coarse_levels():
    image = np.zeros((64, 64, 3), np.uint8)
    image[:20, :20] = 255
    skin = make_skin(raw_box(image, np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]])), 0.05 * BOX)
    assert all(np.min(level) > 250 for level in skin.pyramids[0])


def box_scene(shape: Shape) -> tuple[Scene, np.ndarray]:
    """The shape on a table, with its pose."""
    assert shape.skin
    material = Material("image", shape.skin.mean, pattern="image")
    pose = (0.0, 0.0, 0.05), (0.966, 0.0, 0.0, 0.259)
    body = Body("box", ShapeSpec("mesh"), material, 500.0, 0.5, 0.5, "rest", *pose)
    table, camera = Table(1.0, Material("paint", (0.5, 0.5, 0.5))), Camera((0.5, 0.1, 0.5), (0.0, 0.0, 0.0), 0.4)
    light = Light((0.0, 0.0, 1.0), (0.8, 0.8, 0.8), 0.03)
    scene = Scene((body,), table, (camera,), (light,), (0.2, 0.2, 0.2), (0.3, 0.3, 0.3), 1, 12.0)
    return scene, rigid(np.array([body.position]), np.array([body.quaternion_wxyz]))


@pytest.mark.parametrize("renderer", ["raster", pytest.param("pyrender", marks=pytest.mark.slow)])
def test_a_bright_texture_and_a_dark_one_differ_and_the_labels_do_not(renderer: str):
    images = []
    for value in (40, 220):
        shape = build(raw_box(np.full((4, 4, 3), value, np.uint8), CORNERS))
        scene, pose = box_scene(shape)
        engine = make_renderer(renderer)
        engine.load(scene, (shape,))
        images.append(engine.render(pose, scene.cameras[0], 64, 64))
    dark, bright = images
    inside = dark.segmentation == 1
    np.testing.assert_array_equal(dark.depth, bright.depth)
    assert np.median(bright.rgb[inside]) > np.median(dark.rgb[inside]) + 50


def test_the_path_tracer_puts_texels_where_the_rasteriser_puts_them():
    pytest.importorskip("mitsuba", reason="the mitsuba renderer needs the extra mitsuba")
    texels = 255 * np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 0]]], np.uint8)
    raw = raw_box(np.repeat(np.repeat(texels, 8, axis=0), 8, axis=1), np.zeros((3, 2)))
    corners = np.array([[0.05, 0.05], [0.05, 0.95], [0.95, 0.95], [0.95, 0.05]])
    shape = build(dataclasses.replace(raw, uv=np.tile(corners[[[0, 1, 2], [0, 2, 3]]], (6, 1, 1))))
    scene, pose = box_scene(shape)
    tracer = make_renderer("mitsuba", samples=16)
    assert isinstance(tracer, PathTracer)
    tracer.load(scene, (shape,))
    plain = tracer.render(pose, scene.cameras[0], 64, 64)
    traced = tracer.photograph(pose, scene.cameras[0], 64, 64)
    inside = plain.segmentation == 1
    hues = [image[inside] > 0.5 * np.max(image[inside], axis=1, keepdims=True) for image in (plain.rgb, traced)]
    assert np.mean(np.all(hues[0] == hues[1], axis=1)) > 0.9
