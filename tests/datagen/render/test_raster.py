"""The rasteriser against exact surfaces, against itself, and what light does to its pictures."""

import dataclasses
import hashlib
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from datagen.commands import cli
from datagen.geometry import pixel_rays, rigid
from datagen.render.kernels import FAR
from datagen.render.kernels import NEAR as NEAREST
from datagen.render.raster import RasterRenderer
from datagen.scene import Camera, Material, Table
from datagen.shapes import build
from tests.rays import surface_distance, table_depth, trace
from tests.worlds.handmade import ABOVE_LEFT, FRONT, body, poses, render, scene, six_objects

TENTH = 1e-4
"""Metres: the promised accuracy."""

LOW = Camera((-0.3, -0.4, 0.15), (0.3, 0.0, 0.05), np.radians(50))
NEAR = Camera((0.55, -0.2, 0.3), (0.3, 0.0, 0.04), np.radians(70))
VIEWS = [(FRONT, 128, 128), (FRONT, 320, 240), (LOW, 64, 64), (NEAR, 97, 61)]


def interior(mask: np.ndarray) -> np.ndarray:
    """Pixels whose eight neighbours are in the mask as well, so that anti-aliasing mixes nothing else in."""
    inner = np.zeros_like(mask)
    rows, columns = mask.shape
    neighbours = [mask[1 + i : rows - 1 + i, 1 + j : columns - 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    inner[1:-1, 1:-1] = np.all(neighbours, axis=0)
    return inner


@pytest.fixture(scope="module")
def raster() -> RasterRenderer:
    return RasterRenderer()


@pytest.mark.parametrize(("camera", "width", "height"), VIEWS)
def test_ids_alone_are_those_of_the_image(raster, camera, width, height):
    made = six_objects()
    image = render(raster, made, camera, width, height)
    assert np.array_equal(raster.segment(poses(made), camera, width, height), image.segmentation)


def test_compilation_is_announced_where_no_earlier_run_left_its_kernels(raster, tmp_path, monkeypatch, capsys):
    render(raster, six_objects(), FRONT, 8, 8)
    cli._announce_compilation()
    assert capsys.readouterr().err == ""
    nowhere = SimpleNamespace(shade=SimpleNamespace(stats=SimpleNamespace(cache_path=str(tmp_path))))
    monkeypatch.setattr("datagen.render.raster.kernels", nowhere)
    cli._announce_compilation()
    assert capsys.readouterr().err.startswith("Compiling the renderer, once on this machine")


@pytest.mark.parametrize(("camera", "width", "height"), VIEWS)
def test_depth_lies_within_a_tenth_of_a_millimetre_of_the_true_surface(raster, camera, width, height):
    made = six_objects(np.random.default_rng(width))
    image = render(raster, made, camera, width, height)
    assert np.unique(image.segmentation).tolist() == list(range(7))
    assert surface_distance(made, image, camera).max() < TENTH


@pytest.mark.parametrize(("camera", "width", "height"), VIEWS)
def test_the_tables_depth_is_exact_and_ends_where_the_table_ends(raster, camera, width, height):
    made = scene(table=Table(0.5, Material("table", (0.5, 0.5, 0.5))))
    image = render(raster, made, camera, width, height)
    rays = pixel_rays(camera.k(width, height), width, height)
    np.testing.assert_allclose(image.depth, table_depth(made, camera, rays), rtol=1e-6)
    assert (image.depth > 0).any()
    assert (image.depth == 0).any()
    assert not image.segmentation.any()


@pytest.mark.parametrize(("seed", "camera", "order"), [(0, FRONT, 1), (1, LOW, 1), (2, LOW, -1)])
def test_ids_name_the_first_surface_along_each_ray(raster, seed, camera, order):
    made = six_objects(np.random.default_rng(seed))
    made = dataclasses.replace(made, bodies=made.bodies[::order])
    ids, depth, sure = trace(made, camera, 64, 64)
    image = render(raster, made, camera)
    assert sure.mean() > 0.95
    np.testing.assert_array_equal(image.segmentation[sure], ids[sure])
    # A tenth of a millimetre along the normal is more along a grazing ray.
    assert np.quantile(np.abs(image.depth - depth)[sure & (ids > 0)], 0.98) < 5 * TENTH


def test_amodal_pixels_are_those_that_each_object_shows_alone(raster):
    made = six_objects(np.random.default_rng(5))
    image = render(raster, made, LOW)
    visible = np.bincount(image.segmentation.ravel(), minlength=7)[1:]
    alone = [
        np.count_nonzero(render(raster, dataclasses.replace(made, bodies=(one,)), LOW).segmentation)
        for one in made.bodies
    ]
    assert image.amodal_pixels.tolist() == alone
    assert np.all(image.amodal_pixels >= visible)
    assert np.any(image.amodal_pixels > visible)


def test_what_sinks_into_the_table_is_hidden_by_it(raster):
    image = render(raster, scene(body("sphere", {"radius": 0.05}, (0.28, 0.0, -0.03))))
    whole = render(raster, scene(body("sphere", {"radius": 0.05}, (0.28, 0.0, 0.08))))
    assert 0 < np.count_nonzero(image.segmentation) < 0.8 * image.amodal_pixels[0]
    assert np.count_nonzero(whole.segmentation) == whole.amodal_pixels[0]
    rays = pixel_rays(FRONT.k(64, 64), 64, 64)
    assert np.all(image.depth <= table_depth(scene(), FRONT, rays) * (1 + 1e-6))


def test_from_below_the_table_hides_what_stands_on_it(raster):
    image = render(raster, six_objects(), Camera((0.6, 0.1, -0.5), (0.28, 0.0, 0.0), np.radians(40)))
    assert not image.segmentation.any()
    assert image.amodal_pixels.min() > 0


def test_an_object_around_or_behind_the_camera_corrupts_nothing(raster):
    around = body("box", {"size": [0.3, 0.3, 0.3]}, FRONT.position)
    behind = body("sphere", {"radius": 0.05}, (2.0, 0.0, 1.6))
    beside = body("box", {"size": [1.6, 0.02, 0.02]}, (0.4, 0.12, 0.6), (0.9, 0.0, 0.43, 0.0))
    ball = body("sphere", {"radius": 0.05}, (0.28, 0.0, 0.06))
    alone, crowded = render(raster, scene(ball)), render(raster, scene(ball, around, behind, beside))
    assert crowded.amodal_pixels[0] == alone.amodal_pixels[0]
    assert crowded.amodal_pixels[2] == 0
    kept = crowded.segmentation == alone.segmentation
    np.testing.assert_array_equal(crowded.depth[kept], alone.depth[kept])
    assert surface_distance(scene(ball, around, behind, beside), crowded, FRONT).max() < TENTH
    assert set(np.unique(crowded.segmentation)) <= {0, 1, 4}


def test_what_is_too_near_is_cut_away_pixel_by_pixel(raster):
    pose = FRONT.world_from_camera
    x, y, z = pose[:3, 3] + 0.07 * pose[:3, 2]
    image = render(raster, scene(body("sphere", {"radius": 0.03}, (x, y, z))))
    assert image.depth[image.segmentation == 1].min() >= NEAREST
    assert np.count_nonzero(image.segmentation) == image.amodal_pixels[0] > 50
    assert image.segmentation[32, 32] == 0


def test_an_empty_scene_is_table_and_backdrop(raster):
    image = render(raster, scene(), LOW)
    assert image.amodal_pixels.shape == (0,)
    assert not image.segmentation.any()
    backdrop = np.rint(255 * np.array(scene().backdrop))
    assert np.abs(image.rgb[image.depth == 0][::7] - backdrop).max() <= 40
    assert np.median(np.abs(image.rgb[image.depth == 0] - backdrop)) <= 1


def test_a_shadow_lies_where_the_light_is_hidden(raster):
    made = scene(body("sphere", {"radius": 0.05}, (0.28, 0.0, 0.2)))
    light = dataclasses.replace(ABOVE_LEFT, angular_radius=0.0)
    sharp = dataclasses.replace(made, lights=(light,))
    bare = dataclasses.replace(made, lights=(dataclasses.replace(light, casts_shadow=False),))
    dark = (
        render(raster, bare, width=128, height=128).rgb.astype(int) - render(raster, sharp, width=128, height=128).rgb
    ).sum(-1)
    rays = pixel_rays(FRONT.k(128, 128), 128, 128)
    pose = FRONT.world_from_camera
    points = rays * table_depth(made, FRONT, rays)[..., None] @ pose[:3, :3].T + pose[:3, 3]
    up = np.array(light.direction) / np.sqrt(np.sum(np.square(light.direction)))
    toward = np.array([0.28, 0.0, 0.2]) - points
    miss = np.sqrt(np.sum(np.square(toward - (toward @ up)[..., None] * up), axis=-1))
    table = interior(render(raster, made, width=128, height=128).segmentation == 0)
    assert dark[table & (miss < 0.045)].min() > 30
    assert dark[table & (miss > 0.058)].max() == 0


def test_a_wider_light_casts_a_softer_shadow(raster):
    widths = []
    for radius in (0.2, 6.0):
        light = dataclasses.replace(ABOVE_LEFT, angular_radius=np.radians(radius))
        ball = body("sphere", {"radius": 0.05}, (0.28, 0.0, 0.2))
        image = render(raster, scene(ball, lights=(light,)), width=128, height=128)
        bare = render(
            raster, scene(ball, lights=(dataclasses.replace(light, casts_shadow=False),)), width=128, height=128
        )
        loss = (bare.rgb.astype(float) - image.rgb).sum(-1)
        widths.append(np.count_nonzero((loss > 0.1 * loss.max()) & (loss < 0.9 * loss.max())))
    assert widths[1] > 2 * widths[0]


@pytest.mark.parametrize("elevation", [20, 50, 85])
def test_a_convex_object_casts_no_shadow_on_its_lit_side(raster, elevation):
    x, z = np.cos(np.radians(elevation)), np.sin(np.radians(elevation))
    light = dataclasses.replace(ABOVE_LEFT, direction=(x, 0.0, z))
    for family, parameters in (("sphere", {"radius": 0.08}), ("box", {"size": [0.1, 0.1, 0.1]})):
        made = scene(body(family, parameters, (0.28, 0.0, 0.1)), lights=(light,))
        bare = dataclasses.replace(made, lights=(dataclasses.replace(light, casts_shadow=False),))
        mine = render(raster, made, width=128, height=128)
        change = render(raster, bare, width=128, height=128).rgb.astype(int) - mine.rgb
        assert np.abs(change[interior(mine.segmentation == 1)]).max() == 0


def test_brightness_on_a_lit_sphere_has_no_steps(raster):
    plain = body("sphere", {"radius": 0.12}, (0.28, 0.0, 0.15), roughness=1.0)
    image = render(raster, scene(plain), width=128, height=128)
    inside = interior(image.segmentation == 1)
    brightness = image.rgb.sum(-1).astype(int)
    bend = brightness[:, 2:] - 2 * brightness[:, 1:-1] + brightness[:, :-2]
    whole = inside[:, 2:] & inside[:, 1:-1] & inside[:, :-2]
    assert np.abs(bend[whole]).max() <= 20


def test_edges_are_blended_by_the_share_of_the_pixel_that_is_covered(raster):
    # Nothing sends light but the backdrop, so that darkness is coverage.
    bar = body("box", {"size": [0.3, 0.04, 0.04]}, (0.28, 0.0, 0.2), (0.9, 0.3, 0.2, 0.24))
    table = Table(0.3, Material("table", (0.5, 0.5, 0.5)))
    dark = scene(bar, lights=(), ambient=(0.0, 0.0, 0.0), table=table, backdrop=(0.9, 0.9, 0.9))
    image, samples = render(raster, dark), render(raster, dark, width=192, height=192)
    covered = (samples.depth > 0).reshape(64, 3, 64, 3).mean(axis=(1, 3))
    srgb = image.rgb[..., 0] / 255
    light = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(1 - light / light.max(), covered, atol=0.012)
    assert np.count_nonzero((covered > 0) & (covered < 1)) > 60


@pytest.mark.parametrize("pattern", ["two-tone", "checker", "stripes", "noise", "wood", "dots"])
def test_every_pattern_shows_both_colours_on_objects_and_table(raster, pattern):
    look = {
        "color": (0.9, 0.1, 0.1),
        "color2": (0.1, 0.1, 0.9),
        "pattern": pattern,
        "period": 0.03,
        "axis": (1.0, 0.0, 0.0),
    }
    table = Table(1.2, Material("table", **look))
    for made in (scene(body("sphere", {"radius": 0.08}, (0.28, 0.0, 0.09), **look)), scene(table=table)):
        image = render(raster, made, Camera((0.6, 0.0, 0.5), (0.2, 0.0, 0.0), np.radians(40)), 128, 128)
        shown = image.rgb[image.segmentation == len(made.bodies)].astype(int)
        assert np.count_nonzero(shown[:, 0] > shown[:, 2] + 40) > 0.1 * len(shown)
        assert np.count_nonzero(shown[:, 2] > shown[:, 0] + 40) > 0.03 * len(shown)


def test_a_highlight_is_white_on_plastic_and_coloured_on_metal(raster):
    red = {"roughness": 0.2, "color": (0.7, 0.1, 0.1)}
    tints = []
    for metalness in (0.0, 1.0):
        made = scene(body("sphere", {"radius": 0.08}, (0.28, 0.0, 0.09), metalness=metalness, **red))
        image = render(raster, made, width=128, height=128)
        shown = image.rgb[image.segmentation == 1].astype(int)
        brightest = shown[np.argmax(shown.sum(axis=1))]
        tints.append(brightest[0] - brightest[2])
    assert tints[0] < 40
    assert tints[1] > 60


@pytest.mark.parametrize("made", [six_objects(), scene(), scene(lights=())], ids=["six", "empty", "unlit"])
def test_an_image_does_not_depend_on_what_was_rendered_before(raster, made):
    fresh = render(RasterRenderer(), made, width=96, height=64)
    render(raster, six_objects(np.random.default_rng(9)), LOW, 96, 64)
    render(raster, six_objects(), NEAR, 64, 96)
    used = render(raster, made, width=96, height=64)
    for name in ("rgb", "depth", "segmentation", "amodal_pixels"):
        np.testing.assert_array_equal(getattr(used, name), getattr(fresh, name))


class SearchesEverything(RasterRenderer):
    """A renderer that searches all blocks of the light's map for shadows."""

    def _light_map(self, light_map, margin):
        super()._light_map(light_map, margin)
        light_map.tiles[:] = -FAR
        light_map.counts[:] = np.multiply.outer(*2 * [np.arange(len(light_map.counts))])


@pytest.mark.parametrize("size", [64, 402])
def test_blocks_that_are_not_searched_for_shadows_cast_none(raster, size: int):
    found, expected = (render(each, six_objects(), FRONT, size, size).rgb for each in (raster, SearchesEverything()))
    np.testing.assert_array_equal(found, expected)


def test_images_own_their_memory(raster):
    first = render(raster, six_objects())
    kept = first.rgb.copy()
    raster.render(
        poses(six_objects()) @ rigid(np.array([0.0, 0.0, 0.1]), np.array([1.0, 0.0, 0.0, 0.0])), FRONT, 64, 64
    )
    np.testing.assert_array_equal(first.rgb, kept)


def test_a_fresh_process_gives_the_same_bits(raster):
    program = "from test_raster import digest; print(digest())"
    here = Path(__file__).parent
    paths = [str(here), str(here.parents[1]), str(here.parents[2])]
    code = f"import sys; sys.path[:0] = {paths}; {program}"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == digest()


def digest() -> str:
    """Hash of everything that one image holds."""
    image = render(RasterRenderer(), six_objects(), width=96, height=72)
    arrays = (image.rgb, image.depth, image.segmentation, image.amodal_pixels)
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def test_shapes_and_poses_follow_the_rows_of_bodies(raster):
    made = six_objects()
    raster.load(made, [build(b.shape) for b in made.bodies])
    moved = poses(made)
    moved[2, :3, 3] += (0.0, 0.0, 0.05)
    before, after = raster.render(poses(made), FRONT, 64, 64), raster.render(moved, FRONT, 64, 64)
    changed = np.unique(
        np.stack([before.segmentation, after.segmentation])[:, before.segmentation != after.segmentation]
    )
    assert 3 in changed
    assert np.count_nonzero((before.segmentation == 1) != (after.segmentation == 1)) < 20


@pytest.fixture(scope="module")
def rich() -> RasterRenderer:
    return RasterRenderer(rich=True)


def test_rich_images_differ_in_nothing_but_colour(raster, rich):
    made = six_objects(np.random.default_rng(3))
    one, other = render(raster, made, NEAR), render(rich, made, NEAR)
    for name in ("depth", "segmentation", "amodal_pixels"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert np.mean(one.rgb != other.rgb) > 0.1


def test_metal_mirrors_its_neighbour_in_rich_images_alone(raster, rich):
    mirror = body("box", {"size": [0.02, 0.2, 0.1]}, (0.2, 0.0, 0.05), metalness=1.0, roughness=0.15, color=(0.9,) * 3)
    changes = []
    for renderer in (raster, rich):
        images = []
        for color in ((0.9, 0.1, 0.1), (0.1, 0.1, 0.9)):
            made = scene(mirror, body("box", {"size": [0.04, 0.04, 0.06]}, (0.26, 0.0, 0.03), color=color))
            images.append(render(renderer, made, LOW_FRONT, 96, 96))
        inside = interior(images[0].segmentation == 1)
        changes.append(np.mean(np.any(images[0].rgb != images[1].rgb, axis=-1)[inside]))
    assert changes[0] == 0
    assert changes[1] > 0.03


LOW_FRONT = Camera((0.9, 0.0, 0.25), (0.2, 0.0, 0.05), np.radians(20))


def test_the_table_is_darker_where_something_stands_on_it(raster, rich):
    lights = (dataclasses.replace(ABOVE_LEFT, casts_shadow=False),)
    box = body("box", {"size": [0.1, 0.1, 0.1]}, (0.28, 0.0, 0.05))
    made = scene(box, lights=lights)
    changes = []
    for renderer in (raster, rich):
        with_box, without = (render(renderer, world, width=192, height=192) for world in (made, scene(lights=lights)))
        change = (without.rgb.astype(int) - with_box.rgb).min(axis=-1)
        foot = np.argwhere(with_box.segmentation == 1)[:, 0].max()
        changes.append(change[foot + 1 : foot + 4].max())
        assert not change[foot + 60 :].any()
    assert changes[1] >= 1.5 * changes[0]


def test_a_rich_table_goes_on_beyond_its_edge(raster, rich):
    made = scene(table=Table(0.5, Material("table", (0.6, 0.3, 0.2))), backdrop=(0.3, 0.3, 0.3))
    plain, smooth = render(raster, made, width=128, height=128), render(rich, made, width=128, height=128)
    edge = np.diff((plain.depth > 0).astype(int), axis=0) != 0
    steps = [np.abs(np.diff(image.rgb.astype(int), axis=0)).max(axis=-1)[edge].max() for image in (plain, smooth)]
    assert steps[0] > 25
    assert steps[1] <= 4
