import functools
import itertools
import json

import pytest

from datagen.config import load_recipe, recipe_to_dict
from datagen.errors import CorruptFile
from datagen.schema import SPLITS
from datagen.storage.spec import (
    differences,
    make_spec,
    recipe_of,
    settings_hash,
    shard_numbers,
    shard_ranges,
    split_sizes,
    with_splits,
)

MOVING = recipe_to_dict(load_recipe("moving"))
RASTER = {"name": "raster", "version": 1}


def spec(**changes):
    values = {"seed": 0, "splits": {"train": 8}, "resolution": (128, 128), "renderer": RASTER, **changes}
    return make_spec(values.pop("recipe", MOVING), **values)


@pytest.mark.parametrize(
    ("scenes", "expected"),
    [
        (1, (1, 0, 0)),
        (2, (1, 0, 1)),
        (3, (1, 1, 1)),
        (5, (3, 1, 1)),
        (10, (8, 1, 1)),
        (20, (16, 2, 2)),
        (1000, (800, 100, 100)),
    ],
)
def test_scenes_are_split_80_10_10(scenes: int, expected: tuple[int, int, int]):
    assert tuple(split_sizes(scenes)[name] for name in SPLITS) == expected


def test_no_split_shrinks_when_scenes_are_added():
    sizes = [split_sizes(scenes) for scenes in range(200)]
    for scenes, (before, after) in enumerate(itertools.pairwise(sizes)):
        assert sum(before.values()) == scenes
        assert (
            sum(after[name] - before[name] for name in SPLITS)
            == max(after[name] - before[name] for name in SPLITS)
            == 1
        )


@pytest.mark.parametrize(("scenes", "per_shard"), [(0, 64), (1, 64), (64, 64), (65, 64), (1000, 7)])
def test_every_scene_is_in_one_shard(scenes: int, per_shard: int):
    ranges = shard_ranges(scenes, per_shard)
    assert [index for indices in ranges for index in indices] == list(range(scenes))
    assert all(len(indices) == per_shard for indices in ranges[:-1])


@pytest.mark.parametrize(
    ("frames", "resolution", "expected"),
    [(10, (128, 128), 64), (1, (320, 240), 64), (100, (1024, 1024), 1), (10, (1024, 1024), 11), (10, None, 64)],
)
def test_a_shard_stays_below_a_gigabyte(frames: int, resolution, expected: int):
    assert spec(recipe={**MOVING, "frames": frames}, resolution=resolution)["scenes_per_shard"] == expected


def test_the_number_of_scenes_changes_the_identity_but_not_the_settings():
    small, large = spec(), spec(splits={"train": 80, "test": 10})
    assert small["spec_hash"] != large["spec_hash"]
    assert settings_hash(small) == settings_hash(large)
    assert small["scenes_per_shard"] == large["scenes_per_shard"]
    assert with_splits(small, large["splits"]) == large
    assert differences(small, large) == []


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"seed": 1}, "seed: 0 -> 1"),
        ({"resolution": (64, 64)}, "resolution"),
        ({"renderer": None}, "renderer"),
        ({"renderer": {**RASTER, "version": 2}}, "renderer.version: 1 -> 2"),
        ({"recipe": {**MOVING, "objects": {**MOVING["objects"], "maximum": 6}}}, "recipe.objects.maximum: 4 -> 6"),
    ],
)
def test_other_settings_are_named(changes, line: str):
    assert any(found.startswith(line) for found in differences(spec(), spec(**changes)))
    assert settings_hash(spec()) != settings_hash(spec(**changes))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("attempts", 200.0),
        ("views", True),
        ("fps", "12"),
        ("resolution", (64, 64, 64)),
        ("parts", ("moving", 3)),
        ("rig.target", (0.0, 0.0, None)),
        ("rig.distance", [1.0]),
        ("appearance.style", "plain"),
        ("motion.weights", 3),
        ("sensor", None),
    ],
)
def test_constants_of_another_type_are_no_recipe(name: str, value: object):
    recipe = json.loads(json.dumps(MOVING))
    *parents, leaf = name.split(".")
    functools.reduce(dict.__getitem__, parents, recipe)[leaf] = value
    with pytest.raises(CorruptFile, match=rf"holds no recipe \(.*, expected .* @ recipe\.{name}\)"):
        recipe_of({"recipe": recipe})


def test_only_files_with_the_very_names_of_shards_are_shards(tmp_path):
    for name in (
        "train-00003.h5",
        "train-00001.h5",
        "train-123456.h5",
        "train-000002.h5",
        "train-7.h5",
        "val-00000.h5",
    ):
        (tmp_path / name).touch()
    assert shard_numbers(tmp_path, "train") == [1, 3, 123456]
    assert shard_numbers(tmp_path / "nowhere", "train") == []
