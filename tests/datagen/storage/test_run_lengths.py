import numpy as np
import pytest

from datagen.storage.run_lengths import decode_mask, encode_mask

MASKS = [
    np.zeros((3, 5), bool),
    np.ones((3, 5), bool),
    np.eye(40, 7, dtype=bool),
    np.random.default_rng(0).random((61, 33)) < 0.3,
    np.kron(np.eye(3), np.ones((90, 110))).astype(bool),
]


@pytest.mark.parametrize("mask", MASKS)
def test_masks_survive(mask: np.ndarray):
    np.testing.assert_array_equal(decode_mask(encode_mask(mask), *mask.shape), mask)


@pytest.mark.parametrize("mask", MASKS)
def test_the_code_is_that_of_coco(mask: np.ndarray):
    coco = pytest.importorskip("pycocotools.mask")
    assert encode_mask(mask) == coco.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"]


@pytest.mark.parametrize("text", [b"", b"~", b"\x00", b"o", b"52", b"?P", b"P" * 30])
def test_other_texts_are_refused(text: bytes):
    with pytest.raises(ValueError, match="run lengths"):
        decode_mask(text, 3, 5)
