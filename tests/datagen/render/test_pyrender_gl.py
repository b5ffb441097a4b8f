"""pyrender against exact surfaces and against the rasteriser."""

import dataclasses

import numpy as np
import pytest

from datagen.errors import UsageError
from datagen.render import Renderer, make_renderer
from datagen.render.raster import RasterRenderer
from datagen.scene import Camera, Material, Table
from tests.worlds.handmade import ABOVE_LEFT, body, render, scene, six_objects

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning")]

LOW = Camera((-0.3, -0.4, 0.15), (0.3, 0.0, 0.05), np.radians(50))


@pytest.fixture(scope="module")
def pyrender() -> Renderer:
    try:
        return make_renderer("pyrender")
    except UsageError as error:
        pytest.skip(str(error))


def test_both_renderers_agree_in_ids_and_depth(pyrender):
    raster, agreeing = RasterRenderer(), []
    for seed in range(6):
        made = six_objects(np.random.default_rng(seed))
        one, other = render(raster, made, width=128, height=128), render(pyrender, made, width=128, height=128)
        near = np.abs(one.depth - other.depth) <= 2e-4
        agreeing.append(np.mean(near & (one.segmentation == other.segmentation)))
        assert np.abs(one.amodal_pixels - other.amodal_pixels).max() <= 2
    assert np.mean(agreeing) >= 0.999


def test_both_renderers_show_the_same_colours(pyrender):
    raster = RasterRenderer()
    one, other = render(raster, six_objects()), render(pyrender, six_objects())
    for row in range(7):
        mine = one.segmentation == row
        difference = one.rgb[mine].mean(0) - other.rgb[mine].mean(0)
        assert np.abs(difference).max() < 30


def test_shadows_can_be_switched_off(pyrender):
    made = six_objects()
    bare = dataclasses.replace(made, lights=(dataclasses.replace(ABOVE_LEFT, casts_shadow=False), *made.lights[1:]))
    change = render(pyrender, bare).rgb.astype(int) - render(pyrender, made).rgb
    assert np.count_nonzero(change.min(-1) > 20) > 30
    assert np.quantile(change, 0.001) >= -3


def test_patterns_are_painted_on_objects_and_table(pyrender):
    look = {"color": (0.9, 0.1, 0.1), "color2": (0.1, 0.1, 0.9), "pattern": "checker", "period": 0.06}
    made = scene(
        body("box", {"size": [0.1, 0.1, 0.1]}, (0.28, 0.0, 0.06), **look), table=Table(0.4, Material("table", **look))
    )
    raster, gl = render(RasterRenderer(), made, width=128, height=128), render(pyrender, made, width=128, height=128)
    for row in (0, 1):
        mine = (raster.segmentation == row) & (raster.depth > 0)
        red, seen = (image.rgb[mine].astype(float) @ (1, 0, -1) > 0 for image in (raster, gl))
        assert np.mean(red == seen) > 0.9
        assert 0.2 < red.mean() < 0.8


def test_two_renderers_live_side_by_side_and_repeat_themselves(pyrender):
    first = render(pyrender, six_objects())
    other = make_renderer("pyrender")
    second = render(other, six_objects())
    del other
    third = render(pyrender, six_objects())
    for name in ("rgb", "depth", "segmentation", "amodal_pixels"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name))
        np.testing.assert_array_equal(getattr(third, name), getattr(first, name))


def test_an_empty_scene_is_table_and_backdrop(pyrender):
    image = render(pyrender, scene(), LOW)
    assert image.amodal_pixels.shape == (0,)
    assert not image.segmentation.any()
    beyond = image.rgb[image.depth == 0].astype(int) - np.rint(255 * np.array(scene().backdrop)).astype(int)
    assert np.median(np.abs(beyond)) <= 1
