import pytest
import torch

from obpose.baselines.obsurf.config import ImageEncoderConfig
from obpose.baselines.obsurf.encoder import ImageEncoder


def encoder(**options: object) -> ImageEncoder:
    torch.manual_seed(0)
    return ImageEncoder(ImageEncoderConfig(width=8, **options), camera_code=5)


def inputs(height: int = 12, width: int = 20) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    sizes = {
        "rgb": (3, height, width, 3),
        "rays": (3, height, width, 3),
        "points": (3, height, width, 4),
        "camera": (3, 5),
    }
    return {name: torch.randn(size, generator=generator) for name, size in sizes.items()}


@pytest.mark.parametrize("blocks", [(0, 1), (2, 3)])
def test_cells_are_two_by_two_or_four_by_four_pixels(blocks: tuple[int, int]):
    assert encoder(blocks=blocks, cell=2)(**inputs(12, 20)).shape == (3, 6, 10, 8)
    assert encoder(blocks=blocks, cell=4)(**inputs(12, 20)).shape == (3, 3, 5, 8)
    assert encoder(blocks=blocks, cell=4)(**inputs(15, 10)).shape == (3, 4, 3, 8)


@pytest.mark.parametrize("name", ["rgb", "rays", "points", "camera"])
def test_it_sees_what_it_is_given_and_points_only_if_it_is_told_to(name: str):
    for told in (True, False):
        module = encoder(points=told)
        spoiled = {**inputs(), name: inputs()[name] + torch.randn_like(inputs()[name])}
        seen = not torch.equal(module(**inputs()), module(**spoiled))
        assert seen is (told or name != "points")
