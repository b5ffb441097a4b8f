import numpy as np
import pytest

from benchmark.models.classical.plane_components import components


def flat(height: int = 6, width: int = 8) -> tuple[np.ndarray, np.ndarray]:
    return np.ones((height, width), np.float32), np.ones((height, width), bool)


def test_a_step_parts_and_a_slope_does_not():
    depth, mask = flat()
    stepped, slope = depth.copy(), depth + np.float32(0.015) * np.arange(8, dtype=np.float32)
    stepped[:, 4:] += np.float32(0.03)
    assert len(np.unique(components(stepped, mask, 0.02))) == 2
    assert len(np.unique(components(stepped, mask, 0.04))) == 1
    assert len(np.unique(components(slope, mask, 0.02))) == 1


def test_pixels_touch_over_corners():
    depth, _ = flat(4, 4)
    for diagonal in (np.eye(4, dtype=bool), np.eye(4, dtype=bool)[::-1]):
        labels = components(depth, np.ascontiguousarray(diagonal), 0.02)
        assert np.array_equal(labels > 0, diagonal)
        assert len(np.unique(labels[diagonal])) == 1


def test_what_is_not_masked_is_background_and_parts():
    depth, mask = flat()
    mask[:, 3] = False
    labels = components(depth, mask, 0.02)
    assert not np.any(labels[:, 3])
    assert len(np.unique(labels)) == 3


def test_specks_are_background():
    depth, mask = flat()
    mask[:] = False
    mask[0, 0:2] = mask[3, 2:5] = True
    labels = components(depth, mask, 0.02)
    assert not np.any(labels[0])
    assert np.all(labels[3, 2:5] > 0)


@pytest.mark.parametrize("seed", range(3))
def test_surfaces_hold_together_under_20_percent_of_holes(seed: int):
    depth, _ = flat(40, 40)
    mask = np.random.default_rng(seed).random(depth.shape) > 0.2
    sizes = np.bincount(components(depth, mask, 0.02)[mask])
    assert sizes.max() > 0.99 * mask.sum()


def test_flipping_the_image_flips_the_components():
    rng = np.random.default_rng(0)
    depth, mask = rng.uniform(1, 1.05, (12, 9)).astype(np.float32), rng.random((12, 9)) > 0.3
    labels = components(depth, mask, 0.02)
    for flip in (np.s_[::-1], np.s_[:, ::-1]):
        flipped = components(np.ascontiguousarray(depth[flip]), np.ascontiguousarray(mask[flip]), 0.02)[flip]
        pairs = set(zip(labels.ravel().tolist(), flipped.ravel().tolist(), strict=True))
        assert len(pairs) == len(np.unique(labels)) == len(np.unique(flipped))
