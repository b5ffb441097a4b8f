import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from datagen.config import Objects, Rig, Sensor, recipe_to_dict
from datagen.errors import CorruptFile, UsageError
from datagen.pipeline.make_scene import SceneMaker, Source, check_memory, make_scene, renderer_identity
from datagen.schema import SPLITS, encode_depth
from datagen.sensor import sense
from datagen.storage.reader import Dataset
from datagen.storage.shard import pack
from datagen.storage.spec import make_spec, settings_hash
from tests.worlds.generated import RESOLUTION, ROOT, make, recipe
from tests.worlds.rendered import write_shard

RASTER = {"name": "raster", "version": 1}
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


def test_a_source_that_was_replaced_in_the_meantime_is_not_rendered(tmp_path):
    make(tmp_path, {"val": 1}, renderer=None)
    source = Source(tmp_path, settings_hash(Dataset(tmp_path).spec))
    spec = make_spec(recipe_to_dict(recipe()), seed=0, splits={"val": 1}, resolution=(16, 16), renderer=RASTER)
    make(tmp_path, {"val": 1}, renderer=None, seed=1, overwrite=True)
    with pytest.raises(UsageError, match="was replaced by another dataset"):
        SceneMaker(spec, source)("val", 0)


def test_a_source_with_a_damaged_description_is_one_clear_error(tmp_path):
    make(tmp_path, {"val": 1}, renderer=None)
    dataset = Dataset(tmp_path)
    whole = dataset.split("val")[0]
    record = {**whole, "scene/description": np.asarray(b'{"bodies": 3}')}
    write_shard(tmp_path, dataset.spec, "val", 0, [pack(record)])
    spec = make_spec(recipe_to_dict(recipe()), seed=0, splits={"val": 1}, resolution=(16, 16), renderer=RASTER)
    with pytest.raises(CorruptFile, match=r"val scene 0: scene/description is damaged.*Delete the shard"):
        SceneMaker(spec, Source(tmp_path, settings_hash(dataset.spec)))("val", 0)
    write_shard(tmp_path, dataset.spec, "val", 0, [pack(whole)])
    SceneMaker(spec, Source(tmp_path, settings_hash(dataset.spec)))("val", 0)


def spec_of(size: tuple[int, int], edits: tuple = (), **changes: object) -> dict:
    values = recipe_to_dict(dataclasses.replace(recipe(), **changes))
    return make_spec(values, seed=0, splits={"val": 1}, resolution=size, renderer=RASTER, edits=edits)


def test_the_memory_of_a_scene_is_bounded_before_anything_is_made():
    check_memory(spec_of((4096, 4096), frames=1, views=3))
    for spec in (
        spec_of((4096, 4096), frames=3, views=2),
        spec_of((512, 512), frames=500),
        spec_of((2048, 2048), ("remove", "move", "add"), frames=1, views=2),
        spec_of((8, 8), frames=10_000, objects=Objects(maximum=250)),
        spec_of((8, 8), frames=1000, views=360, objects=Objects(maximum=200)),
    ):
        with pytest.raises(UsageError, match=r"GiB of memory, expected at most 4 GiB. Lower --frames"):
            check_memory(spec)


@pytest.mark.slow
@pytest.mark.parametrize(("size", "edits"), [("1024", ""), ("512", "remove,move,add")])
def test_a_scene_takes_no_more_memory_than_was_estimated(size: str, edits: str):
    program = """
import re, sys
from pathlib import Path
from datagen.pipeline.make_scene import scene_memory
from tests.datagen.pipeline.test_make_scene import SceneMaker, spec_of
size, edits = int(sys.argv[1]), tuple(filter(None, sys.argv[2].split(",")))
# Not ru_maxrss: a new program inherits that of the process that started it.
peak = lambda: int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) * 1024
SceneMaker(spec_of((16, 16), edits, frames=1))("val", 0)
before, spec = peak(), spec_of((size, size), edits, frames=4)
SceneMaker(spec)("val", 0)
print((peak() - before) / scene_memory(spec))
"""
    command = [sys.executable, "-c", program, size, edits]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert 0.2 < float(ran.stdout.split()[-1]) <= 1.0


def test_cameras_of_another_rig_are_refused_where_they_come_near():
    spec = spec_of((16, 16))
    middle = make_scene(spec, "val", 0)["poses/position"][1, 0].tolist()
    rig = {**spec["recipe"]["rig"], "target": middle, "distance": 0.05}
    with pytest.raises(UsageError, match=r"Camera 0 is inside object 1.*Move the cameras with --rig.distance"):
        make_scene({**spec, "rig": {"rig": rig, "views": 1}}, "val", 0)


def test_an_image_that_shows_more_than_the_frame_is_refused_where_that_is_near():
    low = Rig(distance=0.5, elevation=0.0, target=(0.0, 0.0, 0.08))
    changes = {"rig": low, "least_visible_pixels": 0, "frames": 2}
    make_scene(spec_of((16, 16), **changes), "val", 0)
    with pytest.raises(UsageError, match=r"sees the table from .*images of 8x64 show all of the frame and more"):
        make_scene(spec_of((8, 64), **changes), "val", 0)
