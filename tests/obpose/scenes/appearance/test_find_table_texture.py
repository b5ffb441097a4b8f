from dataclasses import replace

import pytest
import torch

from obpose.model.nerf.marching import Picture
from obpose.model.obpose import ObPose
from obpose.scenes import edit
from obpose.scenes.appearance.find_table_texture import find_texture
from obpose.scenes.appearance.light import no_light
from obpose.scenes.appearance.table_texture import EDGE, no_texture, on_texture, texture_at
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene
from obpose.types import Observation
from tests.obpose.scenes.lit import GREY, VIEW, balls_over_table, observed, table_points

LIGHT = (0.6, 0.0, 0.8, 0.4)
NONE = (0.0, 0.0, 0.0, 0.0)
BALLS = ((-0.1, 0.05, 0.1), (0.12, -0.08, 0.05))


def checks(cell: int = 16, size: float = 0.5) -> torch.Tensor:
    """Checkerboard with fields of `cell` points along each edge, in logits."""
    place = torch.arange(EDGE) // cell % 2
    signs = 2.0 * (place[:, None] != place[None, :]) - 1
    return size * signs[..., None] * torch.tensor([1.0, 1.0, -0.5])


def at_pixels(model: ObPose, texture: torch.Tensor) -> torch.Tensor:
    """A texture's values where the camera's pixels show the table, row by row."""
    return texture_at(model, texture, table_points(VIEW).flatten(0, 1))


def clear(model: ObPose, scene: Scene) -> torch.Tensor:
    """Pixels that are some away from objects and from the edges of checks."""
    image = Renderer(model).render(scene, antialiased=False)
    away = torch.nn.functional.max_pool2d(1 - image.shares[:1], 5, stride=1, padding=2)[0].flatten() < 0.01
    cells = (on_texture(model, table_points(VIEW).flatten(0, 1))[0] + 1) * ((EDGE - 1) / 2) / 16
    return away & ((cells - cells.round()).abs().amin(dim=-1) > 0.2)


def test_the_pattern_that_frames_were_made_with_is_found():
    model, scene = balls_over_table(*BALLS, light=NONE)
    textured = scene.with_appearance(texture=checks())
    found = find_texture(model, observed(model, textured), scene)
    there = clear(model, scene)
    assert there.sum() > 200
    error = (at_pixels(model, found) - at_pixels(model, checks()))[there]
    assert error.abs().median() < 0.02
    assert error.abs().quantile(0.95) < 0.15
    again = Renderer(model).render(scene.with_appearance(texture=found), antialiased=False).rgb.flatten(0, 1)
    truth = Renderer(model).render(textured, antialiased=False).rgb.flatten(0, 1)
    assert (again - truth)[there].abs().median() < 0.005


def test_a_pattern_is_drawn_on_the_table_alone():
    model, scene = balls_over_table(*BALLS, light=NONE)
    renderer = Renderer(model)
    plain, image = (
        renderer.render(each, antialiased=False) for each in (scene, scene.with_appearance(texture=checks()))
    )
    ball = image.shares[0] < 1e-3
    assert ball.sum() > 20
    assert torch.equal(image.rgb[ball], plain.rgb[ball])
    there = clear(model, scene)
    expected = torch.sigmoid(torch.logit(torch.tensor(GREY)) + at_pixels(model, checks())[there])
    torch.testing.assert_close(image.rgb.flatten(0, 1)[there], expected, atol=2e-3, rtol=0)
    assert torch.equal(image.depth, plain.depth)
    assert torch.equal(image.shares, plain.shares)


def test_shadows_of_a_known_light_are_not_the_table_s():
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    frames = observed(model, scene)
    lit = at_pixels(model, find_texture(model, frames, scene))
    away = edit.move(edit.move(scene, 1, torch.tensor([0.0, 0.0, 9.0])), 2, torch.tensor([9.0, 0.0, 0.0]))
    unlit = at_pixels(model, find_texture(model, frames, away.with_appearance(light=no_light())))
    assert unlit.min() < -0.5
    assert lit.abs().max() < 0.25
    assert lit.abs().mean() < 0.1 * unlit.abs().mean()


def test_shadows_around_objects_are_not_the_table_s_where_no_light_is_known():
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    frames = observed(model, scene.with_appearance(texture=checks(size=0.1)))
    found = find_texture(model, frames, scene.with_appearance(light=no_light()))
    assert at_pixels(model, found).abs().max() < 0.25
    there = clear(model, scene)
    error = (at_pixels(model, found) - at_pixels(model, checks(size=0.1)))[there]
    assert error.abs().median() < 0.02


def clip_of(frames: list[Observation]) -> Observation:
    """Join frames of one camera."""
    joined = {name: torch.cat([getattr(each, name) for each in frames], dim=1) for name in ("rgb", "depth", "valid")}
    return replace(frames[0], **joined)


def test_what_one_frame_of_many_shows_hardly_counts():
    model, scene = balls_over_table(*BALLS, light=NONE)
    frames = observed(model, scene)
    stained = frames.rgb.clone()
    stained[..., 4:10, 4:10, :] *= 0.5
    clip = clip_of([replace(frames, rgb=stained), *4 * [frames]])
    still = {name: getattr(scene, name).expand(5, *getattr(scene, name).shape[1:]) for name in ("what", "background")}
    moving = replace(
        scene, **still, center=scene.center.expand(5, -1, -1), rotation=scene.rotation.expand(5, -1, -1, -1)
    )
    found = at_pixels(model, find_texture(model, clip, moving)).unflatten(0, (48, 64))[5:9, 5:9]
    once = at_pixels(model, find_texture(model, replace(frames, rgb=stained), scene)).unflatten(0, (48, 64))[5:9, 5:9]
    assert once.mean() < -0.8
    assert found.mean() > -0.05


@pytest.mark.parametrize("depth", [True, False])
def test_where_nothing_is_to_be_seen_there_is_none(depth: bool):
    model, scene = balls_over_table(*BALLS, light=NONE)
    frames = observed(model, scene)
    if not depth:
        frames = replace(frames, rgb=frames.rgb / 2, valid=torch.zeros_like(frames.valid))
    found = find_texture(model, frames, scene)
    assert found.shape == no_texture().shape
    assert found.abs().max() < 0.02


def test_under_objects_the_table_is_as_bright_as_around():
    """Nobody saw it; where an object was taken away it is plain."""
    model, scene = balls_over_table((0.0, 0.0, 0.05), light=NONE)
    bright = scene.with_appearance(texture=no_texture() + 1.0)
    found = find_texture(model, observed(model, bright), scene)
    without = edit.remove(scene.with_appearance(texture=found), 1)
    middle = Renderer(model).render(without, antialiased=False).rgb[24, 32]
    expected = torch.sigmoid(torch.logit(torch.tensor(GREY)) + 1)
    torch.testing.assert_close(middle, expected.expand(3), atol=0.02, rtol=0)


def test_what_is_left_of_shadows_is_not_the_table_s():
    """The light is stronger in truth than it was found to be."""
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    frames = observed(model, scene)
    weaker = scene.with_appearance(light=torch.tensor([*LIGHT[:3], 0.25]))
    found = at_pixels(model, find_texture(model, frames, weaker))
    assert found.abs().max() < 0.1


def test_a_pattern_goes_on_in_shadows():
    model, scene = balls_over_table(*BALLS, light=LIGHT)
    frames = observed(model, scene.with_appearance(texture=checks()))
    found = at_pixels(model, find_texture(model, frames, scene))
    renderer = Renderer(model)
    dark, lit = (
        renderer.render(each, antialiased=False).rgb[..., 0]
        for each in (scene, scene.with_appearance(light=no_light()))
    )
    shaded = ((dark < 0.65 * lit).flatten()) & clear(model, scene)
    assert shaded.sum() > 10
    error = (found - at_pixels(model, checks()))[shaded]
    assert error.abs().mean() < 0.2


def test_of_a_mixed_pixel_the_background_s_part_has_the_pattern():
    """Seen at (-0.05, 0, 0) through half of something red."""
    model, scene = balls_over_table((0.1, 0.0, 0.2), light=NONE)
    renderer = Renderer(model)
    grey, red = torch.tensor([0.3, 0.3, 0.3]), torch.tensor([0.4, 0.1, 0.0])
    weights, depths = torch.tensor([[0.5], [0.5]]), torch.tensor([[0.5], [0.2]])
    picture = Picture(torch.stack([grey, red])[:, None], depths, weights, far=2.0)
    textured, direction = scene.with_appearance(texture=no_texture() + 1.0), torch.tensor([[-0.05, 0.0, -1.0]])
    seen = renderer._finished(picture, textured, renderer.components(scene, 0), direction, VIEW)
    expected = 0.5 * torch.sigmoid(torch.logit(grey / 0.5) + 1) + red
    torch.testing.assert_close(seen[0], expected, atol=1e-3, rtol=0)
