import numpy as np

from datagen.formats.images import depth_units


def test_depths_that_do_not_fit_have_no_return():
    assert depth_units(np.array([0.0, 0.0004, 1.2345, 6.5535, 6.6]), 1e-4).tolist() == [0, 4, 12345, 65535, 0]
