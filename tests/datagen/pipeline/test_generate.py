import dataclasses
import json
import subprocess
import sys
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from datagen import schema
from datagen.config import Rig
from datagen.errors import DatagenError, UsageError
from datagen.pipeline.generate import Run, generate, regenerate, render
from datagen.pipeline.make_scene import object_rows
from datagen.storage import manifest
from datagen.storage.atomic import write_atomically
from datagen.storage.manifest import read_manifest
from datagen.storage.reader import Dataset
from datagen.storage.safe_io import read_json
from datagen.storage.shard import pack
from datagen.storage.spec import SPEC_FILE, read_spec, spec_text, with_splits
from datagen.verify.dataset import find
from tests.worlds.generated import ROOT, compressions, hashes, make, recipe
from tests.worlds.rendered import write_shard

SIZES = {"train": 5, "val": 1, "test": 1}


@pytest.fixture(autouse=True, scope="module")
def small_shards():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("datagen.storage.spec._MOST_SCENES_PER_SHARD", 2)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """All scenes, made by one process in one go."""
    folder = tmp_path_factory.mktemp("whole")
    report = make(folder, SIZES)
    assert report.complete
    assert report.scenes_made == 7
    return folder


def shards(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.h5"))}


def test_a_dataset_is_whole_and_of_the_format(whole):
    dataset = Dataset(whole)
    dataset.check_complete()
    assert dataset.splits == SIZES
    for name in SIZES:
        for record in dataset.split(name):
            schema.validate(record, ("simulation", "pixels"))
            assert record["rgb"].shape == (3, 1, 32, 32, 3)
    assert list(shards(whole)) == [
        "test-00000.h5",
        "train-00000.h5",
        "train-00001.h5",
        "train-00002.h5",
        "val-00000.h5",
    ]
    assert not list(whole.glob("*.partial*"))


def test_scenes_differ_between_indices_and_splits(whole):
    assert len({scene for scenes in hashes(whole).values() for scene in scenes}) == 7


def test_two_workers_make_the_same_files(whole, tmp_path):
    make(tmp_path, SIZES, workers=2)
    assert shards(tmp_path) == shards(whole)


def test_a_scene_depends_on_the_seed(whole, tmp_path):
    make(tmp_path, {"val": 1}, seed=1)
    assert hashes(tmp_path)["val"] != hashes(whole)["val"]


def test_a_dataset_that_grew_is_the_same_as_one_made_at_once(whole, tmp_path):
    make(tmp_path, {"train": 3})
    first = (tmp_path / "train-00000.h5").stat()
    report = make(tmp_path, SIZES)
    assert report.scenes_made == 4
    assert shards(tmp_path) == shards(whole)
    assert (tmp_path / "train-00000.h5").stat().st_ino == first.st_ino
    assert (tmp_path / "dataset.json").read_bytes() == (whole / "dataset.json").read_bytes()


def test_shares_of_the_work_meet_in_one_dataset(whole, tmp_path):
    first = make(tmp_path, SIZES, share=(1, 2))
    assert not first.complete
    assert read_manifest(tmp_path) is None
    assert list(shards(tmp_path)) == ["train-00001.h5", "val-00000.h5"]
    assert make(tmp_path, SIZES, share=(0, 2)).complete
    assert shards(tmp_path) == shards(whole)
    assert read_manifest(tmp_path)["content_hash"] == read_manifest(whole)["content_hash"]


def test_the_same_run_again_makes_nothing(whole):
    before = {path: path.stat().st_ino for path in whole.glob("*.h5")}
    assert make(whole, SIZES).scenes_made == 0
    assert {path: path.stat().st_ino for path in whole.glob("*.h5")} == before


def test_missing_shards_are_made_again(whole, tmp_path):
    make(tmp_path, SIZES)
    (tmp_path / "train-00001.h5").unlink()
    assert make(tmp_path, SIZES).scenes_made == 2
    assert shards(tmp_path) == shards(whole)


def impossible():
    return dataclasses.replace(recipe(attempts=1), least_visible_pixels=10_000)


def test_an_impossible_request_does_not_stand_in_the_way_of_the_corrected_one(tmp_path):
    with pytest.raises(UsageError, match="1 attempts"):
        generate(tmp_path, impossible(), splits={"val": 1})
    assert list(tmp_path.iterdir()) == []
    assert make(tmp_path, {"val": 1}).complete


def test_jobs_that_overwrite_share_the_work(whole, tmp_path):
    make(tmp_path, {"train": 3}, seed=1)
    for share in ((1, 2), (0, 2)):
        report = make(tmp_path, SIZES, share=share, overwrite=True)
    assert report.complete
    assert shards(tmp_path) == shards(whole)


def test_a_smaller_run_that_began_meanwhile_does_not_hide_scenes(whole, tmp_path):
    @contextmanager
    def progress(_total: int):
        make(tmp_path, {"train": 1})
        write_atomically(tmp_path / SPEC_FILE, spec_text(with_splits(Dataset(whole).spec, {"train": 1})).encode())
        yield lambda: None

    assert make(tmp_path, SIZES, progress=progress).spec["splits"] == SIZES
    assert Dataset(tmp_path).splits == SIZES
    assert read_manifest(tmp_path)["splits"] == read_manifest(whole)["splits"]


def test_a_smaller_run_that_ends_later_does_not_shorten_a_shard(whole, tmp_path):
    @contextmanager
    def progress(_total: int):
        make(tmp_path, SIZES)
        yield lambda: None

    make(tmp_path, {"train": 1}, progress=progress)
    assert shards(tmp_path) == shards(whole)


def test_a_job_hashes_nothing_while_another_s_shard_is_too_short(tmp_path, monkeypatch):
    make(tmp_path, {"train": 3})
    monkeypatch.setattr(manifest, "shard_facts", lambda *_: pytest.fail("a shard was hashed"))
    assert not make(tmp_path, {"train": 4}, share=(0, 2)).complete


def test_a_job_opens_few_shards_while_another_s_shard_is_too_short(tmp_path, monkeypatch):
    make(tmp_path, {"train": 3, "test": 12}, renderer=None)
    lengths, length = [], manifest._length
    monkeypatch.setattr(manifest, "_length", lambda *place: lengths.append(place[2:]) or length(*place))
    assert not make(tmp_path, {"train": 4}, renderer=None, share=(0, 9)).complete
    assert lengths == [("train", 1)]


@pytest.mark.parametrize(
    "damage", [{"attempts": "x"}, {"scenes": "2"}, {"content_hash": 5}, {"rejections": {"a": "b"}}, {"file": "x"}]
)
def test_damaged_records_are_made_again(tmp_path, damage: dict[str, Any]):
    make(tmp_path / "expected", {"train": 4}, renderer=None)
    make(tmp_path / "set", {"train": 4}, renderer=None, share=(0, 2))
    record = tmp_path / "set" / "train-00000.json"
    record.write_text(json.dumps(read_json(record) | damage))
    assert make(tmp_path / "set", {"train": 4}, renderer=None, share=(1, 2)).complete
    splits = [read_manifest(tmp_path / name)["splits"] for name in ("set", "expected")]
    assert splits[0] == splits[1]


def test_progress_is_told_of_every_scene(tmp_path):
    told = []

    @contextmanager
    def progress(total: int):
        told.append(total)
        yield lambda: told.append(1)

    make(tmp_path, {"train": 3}, workers=2, progress=progress)
    assert told == [3, 1, 1, 1]


def test_the_manifest_follows_from_the_files(whole):
    manifest = read_manifest(whole)
    assert manifest["spec_hash"] == Dataset(whole).spec["spec_hash"]
    assert {name: facts["scenes"] for name, facts in manifest["splits"].items()} == SIZES
    for facts in manifest["splits"].values():
        assert facts["attempts"] == facts["scenes"] + sum(facts["rejections"].values())
        assert facts["bytes"] == sum((whole / shard["file"]).stat().st_size for shard in facts["shards"])


def test_simulating_and_rendering_apart_gives_the_same_files(whole, tmp_path):
    make(tmp_path / "poses", SIZES, renderer=None)
    assert Dataset(tmp_path / "poses").split("train").fields() == sorted(
        name for name, field in schema.FIELDS.items() if field.group == "simulation"
    )
    render(tmp_path / "poses", tmp_path / "images", resolution=(32, 32))
    assert shards(tmp_path / "images") == shards(whole)
    assert Dataset(tmp_path / "images").spec == Dataset(whole).spec


def test_compression_belongs_to_the_dataset_and_not_to_its_scenes(whole, tmp_path):
    pytest.importorskip("hdf5plugin")
    settings = {"resolution": (32, 32), "compression": "lz4", "run": Run(workers=2)}
    for scenes in (1, 3):
        generate(tmp_path / "lz4", recipe(), splits={"train": scenes}, **settings)
    packed = Dataset(tmp_path / "lz4")
    assert packed.spec["compression"] == "lz4"
    assert hashes(tmp_path / "lz4")["train"] == hashes(whole)["train"][:3]
    assert find(tmp_path / "lz4", workers=2) == []
    assert compressions(tmp_path / "lz4") == {"lz4"}
    with pytest.raises(UsageError, match=r'other settings \(compression: "lz4" -> "gzip"\)'):
        make(tmp_path / "lz4", {"train": 4})
    render(tmp_path / "lz4", tmp_path / "kept")
    assert shards(tmp_path / "kept") == shards(tmp_path / "lz4")
    render(tmp_path / "lz4", tmp_path / "gzip", compression="gzip")
    assert "compression" not in Dataset(tmp_path / "gzip").spec
    assert compressions(tmp_path / "gzip") == {"gzip"}
    with pytest.raises(UsageError, match="Compression lz4 is for images"):
        generate(tmp_path / "none", recipe(), splits={"train": 1}, renderer=None, compression="lz4")


def test_a_dataset_with_images_can_be_rendered_again(whole, tmp_path):
    render(whole, tmp_path, run=Run(workers=2))
    assert shards(tmp_path) == shards(whole)


def test_rendering_needs_no_physics_engine(whole, tmp_path):
    code = (
        "import sys; sys.modules['pybullet'] = None\n"
        "from pathlib import Path; from datagen.pipeline.generate import render\n"
        f"render(Path({str(whole)!r}), Path({str(tmp_path)!r}))"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")
    assert hashes(tmp_path) == hashes(whole)


def test_other_cameras_see_the_same_scenes(whole, tmp_path):
    rig = dataclasses.replace(recipe(views=2), rig=Rig(distance=1.5, elevation=30.0, jitter=0.01))
    render(whole, tmp_path, resolution=(24, 16), rig=rig)
    old, new = Dataset(whole).split("train")[3], Dataset(tmp_path).split("train")[3]
    assert new["rgb"].shape == (3, 2, 16, 24, 3)
    assert new["camera/world_from_camera"].shape == (2, 4, 4)
    for name in ("poses/position", "objects/parameters", "contacts/gap", "lights/direction"):
        np.testing.assert_array_equal(old[name], new[name])
    assert regenerate(tmp_path, "train", 3) == []


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_dataset_is_not_rendered_into_itself(tmp_path, overwrite: bool):
    make(tmp_path / "source", {"train": 1})
    (tmp_path / "link").symlink_to("source")
    before = shards(tmp_path / "source")
    for folder in ("source", "link", "link/../source"):
        with pytest.raises(UsageError, match="another folder with --out"):
            render(tmp_path / "source", tmp_path / folder, resolution=(8, 8), run=Run(overwrite=overwrite))
    assert shards(tmp_path / "source") == before


def test_a_link_that_leads_to_itself_is_no_place_for_images(whole, tmp_path):
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(UsageError, match="circle is a link that leads to itself; give another --out"):
        render(whole, tmp_path / "circle", resolution=(8, 8))


def test_a_request_for_no_scenes_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no scenes are requested"):
        generate(tmp_path / "a", recipe(), splits={"train": 0}, resolution=(16, 16))
    assert not (tmp_path / "a").exists()


def test_scenes_of_another_data_version_are_not_rendered(whole, tmp_path):
    other = read_spec(whole) | {"data_version": schema.DATA_VERSION + 1}
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / SPEC_FILE).write_text(spec_text(with_splits(other, other["splits"])))
    with pytest.raises(UsageError, match=f"data version {schema.DATA_VERSION + 1}, this program"):
        render(tmp_path / "other", tmp_path / "images")
    assert not (tmp_path / "images").exists()


def test_an_incomplete_dataset_is_not_rendered(tmp_path):
    make(tmp_path / "source", {"train": 4}, share=(0, 2))
    with pytest.raises(DatagenError, match="2 of 4 train scenes are missing"):
        render(tmp_path / "source", tmp_path / "images")


def test_sensor_noise_is_the_same_in_one_stage_or_two(tmp_path):
    noisy = dataclasses.replace(recipe(), sensor=dataclasses.replace(recipe().sensor, enabled=True))
    generate(tmp_path / "one", noisy, splits={"train": 2}, resolution=(32, 32))
    generate(tmp_path / "poses", noisy, splits={"train": 2}, renderer=None)
    render(tmp_path / "poses", tmp_path / "two", resolution=(32, 32))
    assert shards(tmp_path / "one") == shards(tmp_path / "two")
    schema.validate(Dataset(tmp_path / "one").split("train")[0], ("simulation", "pixels", "sensor"))


@pytest.fixture(scope="module")
def edited(tmp_path_factory):
    folder = tmp_path_factory.mktemp("edited") / "set"
    generate(folder, recipe(), splits=SIZES, resolution=(32, 32), edits=schema.EDITS)
    return folder


def test_edits_stand_beside_arrays_that_stay_as_they_are(whole, edited):
    for split, size in SIZES.items():
        for index in range(size):
            plain, more = Dataset(whole).split(split)[index], Dataset(edited).split(split)[index]
            assert {schema.FIELDS[name].group for name in set(more) - set(plain)} == set(schema.EDITS)
            for name, array in plain.items():
                assert schema.array_hash(name, array) == schema.array_hash(name, more[name]), name


def test_edits_are_part_of_a_dataset_s_identity_and_none_are_not(whole, edited, tmp_path):
    assert "edits" not in Dataset(whole).spec
    assert Dataset(edited).edits == schema.EDITS
    with pytest.raises(UsageError, match=r"other settings \(edits: null"):
        generate(whole, recipe(), splits=SIZES, resolution=(32, 32), edits=("move",))


def test_edits_are_the_same_in_one_stage_or_two_and_made_anew(whole, edited, tmp_path):
    render(whole, tmp_path / "all", edits=schema.EDITS)
    assert hashes(tmp_path / "all") == hashes(edited)
    assert regenerate(edited, "train", 1) == []


def test_the_simulation_does_not_depend_on_the_resolution(whole, tmp_path):
    generate(tmp_path, recipe(), splits={"train": 1}, resolution=(48, 24))
    small, large = Dataset(tmp_path).split("train")[0], Dataset(whole).split("train")[0]
    for name, field in schema.FIELDS.items():
        if field.group == "simulation":
            np.testing.assert_array_equal(small[name], large[name], err_msg=name)


def test_a_scene_made_anew_proves_the_stored_one(whole):
    assert regenerate(whole, "train", 4) == []
    assert regenerate(whole, "test", 0) == []


@pytest.mark.parametrize("name", ["rgb", "poses/position", "objects/category"])
def test_a_scene_made_anew_disproves_a_tampered_one_though_its_hash_fits(tmp_path, name: str):
    make(tmp_path, {"train": 2})
    dataset = Dataset(tmp_path)
    records = list(dataset.split("train"))
    changed = np.array(records[1][name])
    changed.flat[0] = b"other" if changed.dtype.kind == "S" else changed.flat[0] + 1
    records[1][name] = changed
    write_shard(tmp_path, dataset.spec, "train", 0, [pack(record) for record in records])
    assert regenerate(tmp_path, "train", 0) == []
    assert regenerate(tmp_path, "train", 1) == [name]


def test_the_object_axis_holds_the_largest_scene_of_any_part():
    assert object_rows(recipe()) == 4
    assert object_rows(recipe(name="mixed", parts=("moving", "cluttered"))) == 8


def test_an_impossible_scene_is_one_error_of_several_workers_too(tmp_path):
    with pytest.raises(UsageError, match="1 attempts"):
        generate(tmp_path, impossible(), splits={"train": 4}, run=Run(workers=2))
    assert shards(tmp_path) == {}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_memory_stays_flat_over_many_scenes(tmp_path):
    # Free memory goes back to the system before each reading: what the allocator keeps differs by 2 MiB between runs.
    code = (
        "import ctypes, gc; from pathlib import Path; from datagen.pipeline.make_scene import SceneMaker\n"
        "from datagen.storage.spec import make_spec; from datagen.config import load_recipe, recipe_to_dict\n"
        "recipe = {**recipe_to_dict(load_recipe('moving')), 'frames': 2}\n"
        "renderer = {'name': 'raster', 'version': 1}\n"
        "spec = make_spec(recipe, seed=0, splits={}, resolution=(16, 16), renderer=renderer)\n"
        "make = SceneMaker(spec)\n"
        "def used():\n"
        "    gc.collect()\n"
        "    ctypes.CDLL('libc.so.6').malloc_trim(0)\n"
        "    return 4096 * int(Path('/proc/self/statm').read_text().split()[1])\n"
        "for index in range(1000):\n"
        "    make('train', index)\n"
        "before = used()\n"
        "for index in range(1000, 2000):\n"
        "    make('train', index)\n"
        "print(used() - before)"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    # Keeping every scene would cost 18 MiB; without that, the two readings differ by 1 MiB at most (measured).
    assert int(result.stdout.split()[-1]) < 4 * 2**20


def test_the_spec_is_plain_json_with_the_settings(whole):
    spec = json.loads((whole / "dataset.json").read_text())
    assert spec["recipe"]["name"] == "moving"
    assert (spec["resolution"], spec["seed"], spec["scenes_per_shard"]) == ([32, 32], 0, 2)
