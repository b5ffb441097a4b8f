import dataclasses

import numpy as np
import pytest

from datagen.config import Sensor, recipe_to_dict
from datagen.errors import CorruptFile
from datagen.maker import make_scene, renderer_identity
from datagen.schema import SPLITS, encode_depth
from datagen.sensor import sense
from datagen.spec import make_spec
from tests.small import RESOLUTION, recipe

SENSOR = Sensor(enabled=True, quantisation=0.0)


def noisy_spec():
    noisy = dataclasses.replace(recipe(), sensor=SENSOR)
    renderer = renderer_identity("raster")
    return make_spec(recipe_to_dict(noisy), seed=3, splits={"val": 2}, resolution=RESOLUTION, renderer=renderer)


def test_the_sensors_noise_is_drawn_from_a_stream_of_its_own():
    record = make_scene(noisy_spec(), "val", 1)
    rng = np.random.default_rng([3, SPLITS.index("val"), 1, 1])
    for frame in range(3):
        depth, rgb = record["depth"][frame, 0] * np.float32(1e-4), record["rgb"][frame, 0]
        sensed, valid = sense(depth, rgb, record["camera/K"][0], SENSOR, rng)
        np.testing.assert_array_equal(record["sensor_valid"][frame, 0], valid)
        np.testing.assert_allclose(record["sensor_depth"][frame, 0], encode_depth(sensed), atol=1)


def test_a_recipe_of_the_wrong_kind_is_one_clear_error():
    spec = noisy_spec()
    with pytest.raises(CorruptFile, match="holds no recipe"):
        make_scene({**spec, "recipe": {**spec["recipe"], "fps": "ten"}}, "val", 0)
