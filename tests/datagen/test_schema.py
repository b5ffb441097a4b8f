import numpy as np
import pytest

from datagen import schema
from datagen.errors import UsageError
from tests.worlds.generated import random_record

ALL = ("simulation", "pixels", "sensor", "moving_camera", *schema.EDITS, *schema.SIGNALS)


def test_a_record_with_every_field_is_valid():
    schema.validate(random_record(0), ALL)


@pytest.mark.parametrize("name", ["rgb", "objects/mass", "scene/description"])
def test_a_missing_field_is_named(name: str):
    record = random_record(0)
    del record[name]
    with pytest.raises(schema.SchemaError, match=name):
        schema.validate(record, ALL)


def test_fields_of_groups_that_are_not_asked_for_may_be_missing():
    record = {name: a for name, a in random_record(0).items() if schema.FIELDS[name].group == "simulation"}
    schema.validate(record, ("simulation",))
    with pytest.raises(schema.SchemaError):
        schema.validate(record, ("simulation", "pixels"))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("depth", lambda a: a.astype(np.float32), "dtype float32, expected uint16"),
        ("objects/category", lambda a: a.astype("U"), "expected fixed-length bytes"),
        ("rgb", lambda a: a[..., 0], "expected axes frame view height width channel"),
        ("rgb", lambda a: a[..., :2], "axis channel has length 2, expected 3"),
        ("depth", lambda a: a[:, :, :-1], "axis height"),
        ("poses/position", lambda a: a[:-1], "axis frame"),
        ("objects/mass", lambda a: a[:-1], "axis object"),
        ("contacts/gap", lambda a: a[:, :-1, :-1], r"axis object\+1 has length 4, expected 5"),
    ],
)
def test_a_wrong_array_is_named(name: str, change, message: str):
    record = random_record(0)
    record[name] = change(record[name])
    with pytest.raises(schema.SchemaError, match=message):
        schema.validate(record, ALL)


def test_an_unknown_field_is_named():
    with pytest.raises(schema.SchemaError, match="novelty"):
        schema.validate({**random_record(0), "novelty": np.zeros(3)}, ALL)


def test_depth_survives_within_half_a_unit():
    depth = np.linspace(0, schema.MAX_DEPTH, 100_001)
    error = np.abs(schema.decode_depth(schema.encode_depth(depth)).astype(np.float64) - depth)
    assert np.max(error) <= 0.51 * schema.DEPTH_SCALE
    assert schema.encode_depth(np.array([schema.MAX_DEPTH]))[0] == 65535


@pytest.mark.parametrize("depth", [-1e-6, schema.MAX_DEPTH + 1e-3, np.nan, np.inf])
def test_a_depth_that_does_not_fit_is_an_error(depth: float):
    with pytest.raises(UsageError, match="do not fit"):
        schema.encode_depth(np.array([1.0, depth]))


def test_effects_are_read_bit_by_bit():
    masks = np.random.default_rng(0).random((10, 2, 1, 3, 4)) < 0.5
    effects = np.packbits(np.moveaxis(masks, 0, -1), axis=-1, bitorder="little")
    assert effects.shape == (2, 1, 3, 4, 2)
    for row, mask in enumerate(masks):
        np.testing.assert_array_equal(schema.effect_mask(effects, row + 1), mask)


def test_the_hash_does_not_depend_on_the_order_of_fields_or_the_padding_of_text():
    record = random_record(0)
    shuffled = dict(reversed(record.items()))
    shuffled["objects/category"] = shuffled["objects/category"].astype("S99")
    assert schema.scene_hash(shuffled) == schema.scene_hash(record)


def test_the_hash_depends_on_every_array_its_name_type_and_shape():
    record = random_record(0)
    changed = [{**record, name: _changed(array)} for name, array in record.items()]
    changed.append({**record, "depth": record["sensor_depth"], "sensor_depth": record["depth"]})
    changed.append({name.replace("sensor_depth", "sensor_deptj"): array for name, array in record.items()})
    changed.append({**record, "depth": record["depth"].astype(np.int16)})
    changed.append({**record, "depth": record["depth"].reshape(3, 2, 7, 5)})
    assert len({schema.scene_hash(variant) for variant in [record, *changed]}) == len(changed) + 1


def _changed(array: np.ndarray) -> np.ndarray:
    array = np.array(array)
    array.flat[-1] = b"other" if array.dtype.kind == "S" else array.flat[-1] + 1
    return array
