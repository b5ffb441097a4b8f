import numpy as np
import pytest

from datagen.formats.importers.interface import Images
from datagen.formats.importers.resample import resampled
from tests.worlds.recordings import rays, shoot


def images(size: tuple[int, int]) -> Images:
    shot = shoot(size=size)
    return Images(
        shot.rgb[None, None],
        shot.depth[None, None].astype(np.float32),
        shot.k[None, None],
        shot.pose[None, None],
        shot.ids[None, None].astype(np.int64),
    )


@pytest.mark.parametrize("size", [(24, 18), (20, 20), (16, 36), (96, 72), (31, 17)])
def test_points_stay_on_their_surfaces(size: tuple[int, int]):
    """Depth is that of a neighbouring pixel's ray at most half a pixel away, so that the table stays flat."""
    before = images((48, 36))
    after = resampled(before, size)
    assert after.rgb.shape == (1, 1, size[1], size[0], 3)
    points = rays(after.k[0, 0], size) * after.depth[0, 0][..., None]
    world = points @ before.world_from_camera[0, 0, :3, :3].T + before.world_from_camera[0, 0, :3, 3]
    table = world[after.ids[0, 0] == 0]
    pixel = 0.5 * 0.8 * max(1.0, 24 / min(size)) / 52.5  # metres
    assert np.abs(table[:, 2]).max() < 2 * pixel
    assert abs(np.median(table[:, 2])) < 0.002


def test_equal_sizes_change_nothing():
    before = images((48, 36))
    assert resampled(before, (48, 36)) is before


def test_the_middle_is_kept_and_colours_are_averages():
    before = images((48, 36))
    after = resampled(before, (18, 18))
    assert np.array_equal(after.depth[0, 0], before.depth[0, 0, 1::2, 7:43:2])
    blocks = before.rgb[0, 0, :, 6:42].reshape(18, 2, 18, 2, 3).mean(axis=(1, 3))
    assert np.abs(after.rgb[0, 0] - blocks).max() <= 1
    assert after.k[0, 0, 0] == pytest.approx([52.5 / 2, 0, 9 - 0.25])


@pytest.mark.parametrize("size", [(24, 18), (16, 12), (12, 12)])
def test_whole_factors_lose_no_accuracy(size: tuple[int, int]):
    before = images((48, 36))
    after = resampled(before, size)
    world = rays(after.k[0, 0], size) * after.depth[0, 0][..., None] @ before.world_from_camera[0, 0, :3, :3].T
    table = (world + before.world_from_camera[0, 0, :3, 3])[after.ids[0, 0] == 0]
    assert np.abs(table[:, 2]).max() < 1e-5
