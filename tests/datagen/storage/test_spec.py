import functools
import itertools
import json

import pytest

from datagen.config import load_recipe, recipe_to_dict
from datagen.errors import CorruptFile, UsageError
from datagen.schema import FIELDS, GENERATOR, SPLITS
from datagen.storage.spec import (
    SPEC_FILE,
    differences,
    fields_of,
    groups_of,
    make_imported_spec,
    make_spec,
    read_spec,
    recipe_of,
    rendered_recipe_of,
    settings_hash,
    shard_numbers,
    shard_ranges,
    spec_text,
    split_sizes,
    with_splits,
)

MOVING = recipe_to_dict(load_recipe("moving"))
RASTER = {"name": "raster", "version": 1}


def spec(**changes):
    values = {"seed": 0, "splits": {"train": 8}, "resolution": (128, 128), "renderer": RASTER, **changes}
    return make_spec(values.pop("recipe", MOVING), **values)


def test_the_cameras_of_the_images_may_be_others_than_those_of_the_recipe():
    rig = {"rig": {**MOVING["rig"], "distance": 2.5}, "views": 3}
    assert rendered_recipe_of(spec()) == recipe_of(spec())
    found = rendered_recipe_of(spec(rig=rig))
    assert (found.views, found.rig.distance, found.objects) == (3, 2.5, recipe_of(spec()).objects)


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


def imported_spec(**changes):
    """Spec of two imported scenes, changed in some keys and signed again."""
    facts = {**{key: MOVING[key] for key in ("name", "description", "frames", "fps", "views", "resolution", "parts")}}
    facts |= {"objects": {"maximum": 3}, "sensor": {"enabled": False}}
    origin = {"format": "rgbd", "source": "kitchen"}
    splits, fields = {"train": 1, "test": 1}, {"train": ["rgb"], "test": ["segmentation", "rgb"]}
    made = make_imported_spec(origin, facts, splits=splits, resolution=(7, 5), fields=fields)
    return with_splits({**made, **changes}, splits)


def test_an_imported_dataset_names_the_fields_of_each_split(tmp_path):
    (tmp_path / SPEC_FILE).write_text(spec_text(imported_spec()))
    made = read_spec(tmp_path)
    assert [fields_of(made, split) for split in SPLITS] == [("rgb",), (), ("rgb", "segmentation")]
    assert groups_of(made) == ()
    with pytest.raises(UsageError, match=r"was imported \(format rgbd\): it has images, but no recipe"):
        recipe_of(made)
    assert set(fields_of(spec(), "train")) == {name for name, f in FIELDS.items() if f.group in groups_of(spec())}


@pytest.mark.parametrize(
    "changes",
    [
        {"generator": GENERATOR},
        {"import": None},
        {"fields": {"train": ["rgb"], "val": [], "test": ["novelty"]}},
        {"fields": {"train": ["rgb"]}},
        {"fields": "rgb"},
        {"import": {"format": 3, "source": "kitchen"}},
    ],
)
def test_damage_of_an_imported_spec_is_found(changes, tmp_path):
    (tmp_path / SPEC_FILE).write_text(spec_text(imported_spec(**changes)))
    with pytest.raises(CorruptFile, match="is no spec"):
        read_spec(tmp_path)
