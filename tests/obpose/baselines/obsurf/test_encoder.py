import math

import pytest
import torch

from obpose.baselines.obsurf.config import ImageEncoderConfig
from obpose.baselines.obsurf.encoder import ImageEncoder, code_size, fourier_code, nearest_cells, project
from obpose.geometry import unproject
from obpose.types import Observation


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


HEIGHT, WIDTH = 6, 9


def arbitrary_cameras(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Cameras that look anywhere, with pixels that are not square and a middle that is not that of the image."""
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.rand(shape, generator=generator)  # noqa: E731
    k = torch.zeros(count, 3, 3)
    k[:, 0, 0], k[:, 1, 1] = 5 + 10 * draw(count), 5 + 10 * draw(count)
    k[:, 0, 2], k[:, 1, 2], k[:, 2, 2] = WIDTH * draw(count), HEIGHT * draw(count), 1
    rotation = torch.linalg.qr(torch.randn(count, 3, 3, generator=generator)).Q
    rotation = rotation * torch.linalg.det(rotation)[:, None, None]
    pose = torch.eye(4).repeat(count, 1, 1)
    pose[:, :3, :3], pose[:, :3, 3] = rotation, 3 * draw(count, 3) - 1.5
    return k, pose


def test_surface_points_of_any_camera_land_on_their_pixels():
    k, pose = arbitrary_cameras(20)
    size = (20, 1, 1, HEIGHT, WIDTH)
    depth = 0.5 + torch.rand(size, generator=torch.Generator().manual_seed(1))
    seen = Observation(torch.zeros(*size, 3), depth, depth > 0, k[:, None], pose[:, None])
    pixels, before = project(unproject(seen).flatten(1, 4), k, pose)
    v, u = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
    torch.testing.assert_close(pixels, torch.stack([u, v], -1).flatten(0, 1).expand_as(pixels), rtol=0, atol=1e-3)
    assert before.all()


def test_what_is_behind_the_camera_is_known_and_finite():
    k, pose = arbitrary_cameras(4)
    ahead = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.1, 0.2, 0.0]])
    points = ahead @ pose[:, :3, :3].mT + pose[:, None, :3, 3]
    pixels, before = project(points, k, pose)
    assert before.tolist() == [[True, False, False]] * 4
    assert pixels.isfinite().all()


def test_pixels_fall_into_the_cells_that_cover_them_and_beyond_the_border_into_the_nearest():
    pixels = torch.tensor([[[0.5, 0.5], [3.9, 0.5], [4.1, 0.5], [4.1, 7.9], [-9.0, 99.0], [99.0, 3.0]]])
    cells = nearest_cells(pixels, size=(8, 8), grid=(2, 2))
    assert cells.tolist() == [[0, 0, 1, 3, 2, 1]]


def test_cells_are_numbered_row_by_row_where_a_grid_is_wider_than_high():
    v, u = torch.meshgrid(torch.arange(60) + 0.5, torch.arange(80) + 0.5, indexing="ij")
    cells = nearest_cells(torch.stack([u, v], -1).view(1, -1, 2), size=(60, 80), grid=(30, 40)).view(60, 80)
    numbers = torch.arange(30 * 40).view(30, 40)
    for row, column in ((0, 0), (1, 0), (0, 1), (1, 1)):
        assert torch.equal(cells[row::2, column::2], numbers)


def test_the_fourier_code_is_the_published_one():
    point = torch.tensor([0.3, -1.0, 2.0])
    code = fourier_code(point, last=10)
    assert code.shape == (99,) == (code_size(last=10),)
    assert code[:3].tolist() == point.tolist()
    angle = math.pi * 0.3 * 2**-5
    assert code[3].item() == pytest.approx(math.sin(angle), abs=1e-6)
    assert code[3 + 48].item() == pytest.approx(math.cos(angle), abs=1e-6)
