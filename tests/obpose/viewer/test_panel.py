import torch

from obpose.scenes.rendering import Image
from obpose.viewer.panel import TILE, TITLE, compose, greys


def image(depth: float) -> Image:
    return Image(torch.full((6, 8, 3), 0.5), torch.full((6, 8), depth), torch.ones(1, 6, 8))


def test_input_and_scene_are_side_by_side_in_equal_greys():
    observed = torch.zeros(6, 8, 3), torch.linspace(1.0, 2.0, 48).view(6, 8)
    colours = compose(image(1.5), observed, with_depth=False)
    assert colours.shape == (TITLE + TILE * 6 // 8, 2 * TILE + 6, 3)
    assert (colours[-1, :TILE] == 0).all()
    assert (colours[-1, -TILE:] == 128).all()
    both = compose(image(1.5), observed, with_depth=True)
    assert (both[: len(colours)] == colours).all()
    assert both[-1, TILE - 1, 0] == round(255 * 0.1)
    assert (both[-1, -TILE:] == round(255 * 0.55)).all()


def test_without_input_the_scene_is_beside_its_depth():
    picture = compose(image(1.0), None, with_depth=True)
    assert (picture[-1, :TILE] == 128).all()
    assert (picture[-1, -TILE:] == round(255 * 0.1)).all()


def test_near_is_bright_and_missing_depth_is_black():
    found = greys(torch.tensor([[0.0, 1.0, 2.0]]), (1.0, 2.0))[0, :, 0]
    torch.testing.assert_close(found, torch.tensor([0.0, 1.0, 0.1]))
