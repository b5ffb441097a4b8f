from dataclasses import replace

import pytest
import torch

from obpose.model.nerf.marching import Picture
from obpose.scenes import edit
from obpose.scenes.appearance.find_light import find_light
from obpose.scenes.appearance.light import no_light
from obpose.scenes.rendering import Renderer
from tests.obpose.analytic_fields import BallField
from tests.obpose.scenes.lit import GREY, RADIUS, VIEW, balls_over_table, moving_balls, observed, table_points

SOFT = 0.025
"""How far from the edge of a shadow it may be neither light nor dark, metres."""
LIGHT = (0.6, 0.0, 0.8, 0.4)
BALLS = ((-0.1, 0.05, 0.1), (0.12, -0.08, 0.05))


@pytest.mark.parametrize("center", [(0.1, 0.0, 0.2), (0.0, 0.05, 0.2), (0.1, -0.1, 0.1)])
def test_what_is_behind_an_object_is_darker_by_the_strength_and_nothing_else_is(center: tuple[float, float, float]):
    model, scene = balls_over_table(center, light=LIGHT)
    renderer = Renderer(model)
    image, plain = (
        renderer.render(each, antialiased=False) for each in (scene, scene.with_appearance(light=no_light()))
    )
    toward = torch.tensor(LIGHT[:3])
    to = torch.tensor(center) - table_points(VIEW)
    beside = (to - (to @ toward)[..., None] * toward).norm(dim=-1)
    is_table = image.shares[0] > 0.999
    dark, lit = (is_table & (beside < RADIUS - SOFT)), (beside > RADIUS + SOFT)
    assert dark.sum() > 20
    shade = torch.tensor(GREY * (1 - LIGHT[3]))
    torch.testing.assert_close(image.rgb[dark], shade.expand_as(image.rgb[dark]), atol=0.01, rtol=0)
    assert torch.equal(image.rgb[lit], plain.rgb[lit])
    assert (image.rgb <= plain.rgb).all()
    most = GREY * LIGHT[3] * image.shares[0, ..., None]
    assert (plain.rgb - image.rgb <= most + 1e-3).all()
    is_ball = image.shares[1] > 0.999
    assert is_ball.sum() > 20
    assert torch.equal(image.rgb[is_ball], plain.rgb[is_ball])
    assert torch.equal(image.depth, plain.depth)
    assert torch.equal(image.shares, plain.shares)


def test_a_shadow_goes_where_its_object_goes_and_goes_with_it():
    model, scene = balls_over_table((0.12, 0.0, 0.2), light=LIGHT)
    renderer, six_pixels = Renderer(model), 6 / float(VIEW.k[0, 0])
    moved = edit.move(scene, 1, torch.tensor([0.0, six_pixels, 0.0]))
    # Columns in which the shadow is seen, and the ball is not.
    before, after, gone = (renderer.render(each).rgb[:, 20:36] for each in (scene, moved, edit.remove(scene, 1)))
    assert (before < GREY - 0.2).any()
    torch.testing.assert_close(after[:-6], before[6:], atol=0.03, rtol=0)
    torch.testing.assert_close(gone, torch.full_like(gone, GREY), atol=1e-3, rtol=0)


def test_without_strength_or_objects_there_is_no_shadow():
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    empty = edit.remove(edit.remove(scene, 1), 2)
    renderer = Renderer(model)
    for dark in (scene.with_appearance(light=torch.tensor([*LIGHT[:3], 0.0])), empty):
        assert torch.equal(renderer.render(dark).rgb, renderer.render(dark.with_appearance(light=no_light())).rgb)


def test_pixels_at_outlines_are_means_of_lit_rays():
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    renderer = Renderer(model)
    finer = renderer.render(scene, camera=VIEW.resized(128, 96), antialiased=False).rgb
    means = finer.unflatten(0, (48, 2)).unflatten(2, (64, 2)).mean(dim=(1, 3))
    image, plain = (renderer.render(scene, antialiased=smooth).rgb for smooth in (True, False))
    changed = (image != plain).any(dim=-1)
    assert changed.any()
    torch.testing.assert_close(image[changed], means[changed], atol=1e-5, rtol=0)


@pytest.mark.parametrize(("azimuth", "elevation", "strength"), [(0, 50, 0.3), (130, 60, 0.5), (250, 40, 0.25)])
def test_the_light_that_frames_were_made_with_is_found(azimuth: float, elevation: float, strength: float):
    turn, rise = torch.deg2rad(torch.tensor([float(azimuth), float(elevation)]))
    toward = torch.stack([rise.cos() * turn.cos(), rise.cos() * turn.sin(), rise.sin()])
    model, scene = balls_over_table(*BALLS, light=(*toward.tolist(), strength))
    found = find_light(model, observed(model, scene), scene)
    assert float(torch.rad2deg((found[:3] @ toward).clamp(max=1).acos())) < 6
    assert float(found[3]) == pytest.approx(strength, abs=0.05)


def test_each_frame_has_the_shadows_of_where_objects_are_in_it():
    far = [(5.0, 5.0, 0.1), (5.0, -5.0, 0.1)]
    model, scene = moving_balls([far, BALLS, [(x - 0.1, y + 0.1, z) for x, y, z in BALLS]], light=LIGHT)
    found = find_light(model, observed(model, scene), scene)
    assert float(torch.rad2deg((found[:3] @ torch.tensor(LIGHT[:3])).clamp(max=1).acos())) < 6
    assert float(found[3]) == pytest.approx(LIGHT[3], abs=0.05)


def test_what_is_nearer_than_pixels_lie_apart_keeps_no_light_away():
    model, scene = balls_over_table((0.0, 0.0, 0.2), light=LIGHT)
    renderer, spacing = Renderer(model), model.config.model.spacing
    model.object_field = BallField(2 * 0.9 * spacing / model.config.model.pose.box_size, latent=32)
    objects, middle, up = renderer.objects(scene, 0), scene.center[0], torch.tensor([0.0, 0.0, 1.0])
    assert float(renderer.occlusion(objects, middle, up)) == 0
    assert float(renderer.occlusion(objects, middle - 1.5 * spacing * up, up)) > 0.5


def test_it_is_found_in_the_frames_and_not_in_the_scene_and_again():
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    frames = observed(model, scene)
    found = find_light(model, frames, scene.with_appearance(light=no_light()))
    assert found.any()
    assert torch.equal(found, find_light(model, frames, scene))


@pytest.mark.parametrize("light", [no_light().tolist(), (*LIGHT[:3], 0.05)])
def test_where_hardly_a_shadow_is_seen_there_is_no_light(light: tuple[float, ...]):
    model, scene = balls_over_table(*BALLS, light=light)
    assert not find_light(model, observed(model, scene), scene).any()


def test_where_no_object_is_known_there_is_no_light():
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    frames = observed(model, scene)
    assert not find_light(model, frames, edit.remove(edit.remove(scene, 1), 2)).any()


def test_where_no_depth_is_seen_there_is_no_light():
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    frames = observed(model, scene)
    blind = replace(frames, depth=torch.zeros_like(frames.depth), valid=torch.zeros_like(frames.valid))
    assert not find_light(model, blind, scene).any()


def test_dimness_all_around_the_foot_is_no_shadow():
    model, scene = balls_over_table((0.0, 0.0, 0.05), light=no_light().tolist())
    frames = observed(model, scene)
    near = (0.12 - table_points(VIEW)[..., :2].norm(dim=-1)).clamp(min=0) / 0.12
    dim = replace(frames, rgb=frames.rgb * (1 - 0.5 * near[..., None]))
    assert not find_light(model, dim, scene).any()


@pytest.mark.parametrize("square", [0.04, 0.1])
def test_the_pattern_of_a_table_is_no_shadow(square: float):
    model, scene = balls_over_table(*BALLS, light=no_light().tolist())
    frames = observed(model, scene)
    is_dark = (table_points(VIEW)[..., :2] / square).floor().sum(dim=-1).remainder(2)
    assert not find_light(model, replace(frames, rgb=frames.rgb * (1 - 0.4 * is_dark[..., None])), scene).any()


def test_of_a_mixed_pixel_the_part_of_the_background_is_darker():
    """Seen at (-0.05, 0, 0), in the middle of the ball's shadow, through half of something."""
    model, scene = balls_over_table((0.1, 0.0, 0.2), light=LIGHT)
    renderer = Renderer(model)
    grey, red = torch.tensor([0.3, 0.3, 0.3]), torch.tensor([0.4, 0.1, 0.0])
    weights, depths = torch.tensor([[0.5], [0.5]]), torch.tensor([[0.5], [0.2]])
    picture = Picture(torch.stack([grey, red])[:, None], depths, weights, far=2.0)
    direction = torch.tensor([[-0.05, 0.0, -1.0]])
    lit = renderer._finished(picture, scene, renderer.components(scene, 0), direction, VIEW)
    torch.testing.assert_close(lit[0], grey * (1 - LIGHT[3]) + red, atol=1e-3, rtol=0)
