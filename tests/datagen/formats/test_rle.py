import numpy as np
import pytest

from datagen.formats.rle import encode_rle


@pytest.mark.filterwarnings("ignore:__array__ implementation")  # of pycocotools
@pytest.mark.parametrize("fill", [0.0, 0.3, 1.0])
def test_pycocotools_decodes_the_mask(fill: float):
    mask_library = pytest.importorskip("pycocotools.mask")
    mask = np.random.default_rng(0).random((7, 5)) < fill
    encoded = encode_rle(mask)
    decoded = mask_library.decode(mask_library.frPyObjects(encoded, *encoded["size"]))
    np.testing.assert_array_equal(decoded, mask)
