import torch

from obpose.scenes.rendering import Image
from obpose.viewer.panes import TILE, greys, panes


def image(depth: float) -> Image:
    return Image(torch.full((6, 8, 3), 0.5), torch.full((6, 8), depth), torch.ones(1, 6, 8))


def test_input_and_scene_stand_side_by_side_in_the_same_greys():
    seen = torch.linspace(1.0, 2.0, 48).view(6, 8)
    picture = panes(image(1.5), torch.zeros(6, 8, 3), seen)
    assert picture.shape[1] == 2 * TILE + 6
    top, bottom = picture[22], picture[-1]
    assert (top[:TILE] == 0).all()
    assert (top[-TILE:] == 128).all()
    assert (bottom[-1] == round(255 * 0.55)).all()


def test_without_input_the_place_stays_free():
    without, beside = panes(image(1.0), None, None), panes(image(1.0), torch.zeros(6, 8, 3), torch.ones(6, 8))
    assert without.shape == beside.shape
    for row in (22, -1):
        assert (without[row, :TILE] == 238).all()
        assert (without[row, -TILE:] == beside[row, -TILE:]).all()


def test_near_is_bright_and_nothing_is_black():
    found = greys(torch.tensor([[0.0, 1.0, 2.0]]), (1.0, 2.0))[0, :, 0]
    torch.testing.assert_close(found, torch.tensor([0.0, 1.0, 0.1]))
