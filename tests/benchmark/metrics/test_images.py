import math

import numpy as np
import pytest

from benchmark.metrics.images import depth_errors, psnr, ssim

GREY = np.full((16, 16, 3), 0.5)


def test_equal_images_are_equal():
    assert psnr(GREY, GREY) == math.inf
    assert psnr(GREY, GREY, largest=60.0) == 60
    assert psnr(GREY, GREY + 1e-4, largest=60.0) == 60
    assert ssim(GREY, GREY) == pytest.approx(1)


def test_an_error_of_a_tenth_is_20_decibels():
    assert psnr(GREY, GREY + 0.1) == pytest.approx(20)
    assert psnr(GREY, GREY - 0.01) == pytest.approx(40)


def test_a_mask_says_which_pixels_count():
    mask = np.zeros((16, 16), bool)
    mask[:4] = True
    other = GREY.copy()
    other[:4] += 0.1
    assert psnr(GREY, other, mask) == pytest.approx(20)
    assert psnr(GREY, other) == pytest.approx(20 + 10 * math.log10(4))
    assert psnr(GREY, other, ~mask) == math.inf
    assert math.isnan(psnr(GREY, other, np.zeros_like(mask)))


def test_rounding_to_bytes_costs_little():
    clip = np.random.default_rng(0).random((2, 1, 64, 64, 3))
    assert psnr(np.rint(255 * clip) / 255, clip) == pytest.approx(58.9, abs=0.1)


def test_structure_is_more_than_brightness():
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 0.8, (16, 16, 3))
    shuffled = rng.permutation(image.reshape(-1, 3)).reshape(image.shape)
    assert ssim(image, image + 0.05) > 0.9 > 0.3 > ssim(image, shuffled)


def test_depth_counts_where_it_is_known():
    truth = np.array([[1.0, 0.0], [2.0, 3.0]])
    errors = depth_errors(truth + 0.5, truth)
    assert errors == pytest.approx([0.5, 0.5, 0.5])
    assert len(depth_errors(truth, truth, np.array([[True, True], [False, False]]))) == 1
