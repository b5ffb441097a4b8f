"""Findings of `verify` in a generated dataset, clean or with one scene changed and every stored hash made to fit."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from datagen import schema, verify
from datagen.config import Physics, load_recipe, names_without_meshes
from datagen.errors import EXIT_OK, EXIT_VERIFICATION, UsageError
from datagen.schema import SceneRecord
from datagen.storage import spec
from datagen.storage.reader import Dataset
from datagen.storage.shard import pack
from datagen.verify.dataset import find
from tests.processes import command_line, descendants, errors_at_end, wait_until_gone
from tests.worlds import rendered
from tests.worlds.rendered import change_scene

SCENE = 1
"""Index of a scene of the training split."""


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """Three staged scenes, quick to check."""
    places = [(rendered.SPHERE, (0.2 + 0.05 * i, 0.0, 0.04)) for i in range(3)]
    scenes = [rendered.record(rendered.scene([place], frames=2), resolution=(48, 48)) for place in places]
    return rendered.write_dataset(tmp_path / "plain", scenes)


def test_a_clean_dataset_is_verified(tiny_dataset: Path, capsys: pytest.CaptureFixture[str]):
    assert verify.run(tiny_dataset) == EXIT_OK
    assert "8 scenes verified" in capsys.readouterr().out


@pytest.mark.slow
def test_workers_do_not_change_the_verdict(plain: Path):
    change_scene(plain, "train", 1, lift_depth)
    assert find(plain, workers=2) == find(plain, workers=1) != []


def lift_depth(record: SceneRecord) -> None:
    record["depth"] += (10 * (record["depth"] > 0)).astype(np.uint16)


def test_geometry_alone_finds_the_scene_that_was_tampered_with(plain: Path):
    change_scene(plain, "train", SCENE, lift_depth)
    findings = find(plain)
    assert "surface" in {finding.check for finding in findings}
    assert "hash" not in {finding.check for finding in findings}
    assert {(finding.split, finding.scene) for finding in findings} == {("train", SCENE)}


def test_findings_are_listed(plain: Path, capsys: pytest.CaptureFixture[str]):
    change_scene(plain, "train", SCENE, lift_depth)
    assert verify.run(plain) == EXIT_VERIFICATION
    assert "train shard train-00000.h5 scene 1 frame 0 view 0: surface: " in capsys.readouterr().out


@pytest.mark.parametrize("name", ["rgb", "depth", "segmentation"])
def test_one_flipped_bit_is_found_by_the_hash(plain: Path, name: str):
    def flip(record: SceneRecord) -> None:
        record[name].reshape(-1).view(np.uint8)[2345] ^= 1

    change_scene(plain, "train", 1, flip, keep_hash=True)
    assert ("train", 1, "hash") in {(finding.split, finding.scene, finding.check) for finding in find(plain)}


def test_damaged_files_are_findings(plain: Path):
    path = plain / "train-00000.h5"
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for position in rng.integers(0, len(whole), 12):
        damaged = bytearray(whole)
        damaged[position] ^= 0x10
        path.write_bytes(damaged)
        assert {finding.check for finding in find(plain)}, f"the flipped bit in byte {position} was not found"
    path.write_bytes(whole[: len(whole) // 2])
    assert {(finding.check, finding.scene) for finding in find(plain) if finding.split} == {
        ("file", 0),
        ("file", 1),
        ("file", 2),
    }
    path.write_bytes(b"not HDF5")
    assert {finding.check for finding in find(plain) if finding.split} == {"file"}
    path.unlink()
    assert {finding.check for finding in find(plain) if finding.split} == {"file"}


def test_a_sample_is_drawn_from_all_splits(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    places = [(rendered.SPHERE, (0.2 + 0.02 * i, 0.0, 0.04)) for i in range(8)]
    records = [rendered.record(rendered.scene([place], frames=1), resolution=(48, 48)) for place in places]
    parts = {"train": records[:4], "val": records[4:6], "test": records[6:]}
    folder = rendered.write_dataset(tmp_path / "set", records[:4])
    facts = spec.with_splits(spec.read_spec(folder), {split: len(part) for split, part in parts.items()})
    (folder / spec.SPEC_FILE).write_text(spec.spec_text(facts))

    def write() -> None:
        for split, part in parts.items():
            rendered.write_shard(folder, facts, split, 0, [pack(record) for record in part])
        rendered.write_manifest(folder)

    write()
    assert verify.run(folder, sample=3) == EXIT_OK
    assert "3 of 8 scenes verified" in capsys.readouterr().out
    for record in records:
        lift_depth(record)
    write()
    every = {(split, scene) for split, part in parts.items() for scene in range(len(part))}
    for sample, expected in ((3, 3), (100, 8)):
        found = {(finding.split, finding.scene) for finding in find(folder, sample=sample)}
        assert len(found & every) == len(found) == expected


def test_a_scene_that_is_there_twice_is_found(plain: Path):
    other = Dataset(plain).split("train")[0]
    change_scene(plain, "train", 1, lambda record: record.update(other))
    (finding,) = find(plain)
    assert finding.check == "duplicate"
    assert finding.message == "train scene 1 is the same scene as train scene 0"


def test_a_changed_identity_is_found(plain: Path):
    facts = json.loads((plain / spec.SPEC_FILE).read_text())
    (plain / spec.SPEC_FILE).write_text(json.dumps({**facts, "seed": 5}))
    (finding,) = find(plain)
    assert "spec_hash" in finding.message


def test_a_manifest_of_other_files_is_found(plain: Path):
    facts = json.loads((plain / spec.MANIFEST_FILE).read_text())
    (plain / spec.MANIFEST_FILE).write_text(json.dumps({**facts, "content_hash": "0"}))
    assert [finding.check for finding in find(plain)] == ["file"]
    for text in ("{", "[]", "5", "null"):
        (plain / spec.MANIFEST_FILE).write_text(text)
        (finding,) = find(plain)
        assert finding.check == "file"
        assert "manifest.json" in finding.message
    (plain / spec.MANIFEST_FILE).unlink()
    assert [finding.check for finding in find(plain)] == ["file"]


def test_files_are_checked_whatever_is_wrong_with_scenes(plain: Path):
    change_scene(plain, "train", SCENE, lift_depth)
    shutil.copy(plain / "train-00000.h5", plain / "train-00001.h5")
    shutil.copy(plain / "train-00000.h5", plain / "val-00000.h5")
    found = find(plain)
    assert {finding.scene for finding in found if finding.check != "file"} == {SCENE}
    about = [(finding.split, finding.shard, finding.message) for finding in found if finding.check == "file"]
    assert about == [
        ("train", "train-00001.h5", "is there, but train has no more than 3 scenes"),
        ("val", "val-00000.h5", "is there, but val has no more than 0 scenes"),
    ]


def test_a_shard_with_more_scenes_than_the_dataset_is_found(plain: Path):
    fewer = spec.with_splits(spec.read_spec(plain), {"train": 2})
    (plain / spec.SPEC_FILE).write_text(spec.spec_text(fewer))
    rendered.write_manifest(plain)
    (finding,) = find(plain)
    assert finding.message == "holds 3 scenes, expected 2"


def test_the_recipe_says_how_deep_contacts_may_be(tmp_path: Path):
    record = rendered.record(rendered.scene([rendered.STANDING[2]], frames=2), resolution=(48, 48))
    record["contacts/gap"][1, 0, 1] = record["contacts/gap"][1, 1, 0] = -0.0025
    rendered.write_dataset(tmp_path / "deep", [record], physics=Physics(deepest_in_motion=0.003))
    assert find(tmp_path / "deep") == []
    rendered.write_dataset(tmp_path / "default", [record])
    assert [(finding.check, finding.frame) for finding in find(tmp_path / "default")] == [("overlap", 1)]


def test_another_data_version_is_refused(plain: Path):
    other = spec.read_spec(plain) | {"data_version": schema.DATA_VERSION + 1}
    (plain / spec.SPEC_FILE).write_text(spec.spec_text(spec.with_splits(other, other["splits"])))
    with pytest.raises(UsageError, match="data version"):
        find(plain)


@pytest.mark.slow
def test_workers_do_not_outlive_a_verification_that_is_killed(plain: Path):
    program = (
        "import sys, time; from datagen.verify import dataset; dataset.SCENES_PER_JOB = 1\n"
        # The first result is made without workers.
        "def wait_in_the_middle(results, *_): next(results), next(results), print('two', flush=True), time.sleep(600)\n"
        "dataset.tracked = wait_in_the_middle\n"
        "dataset.find(sys.argv[1], workers=2)"
    )
    process = subprocess.Popen([sys.executable, "-c", program, str(plain)], stdout=subprocess.PIPE)
    assert process.stdout
    assert process.stdout.readline() == b"two\n"
    # Libraries may start short-lived processes, too.
    lines = {child: command_line(child) for child in descendants(process.pid)}
    workers = {child: line for child, line in lines.items() if b"datagen.pipeline.worker" in line}
    assert len(workers) == 2
    process.kill()
    errors_at_end(process)
    wait_until_gone(workers)


def test_a_folder_without_dataset_is_the_user_s_error(tmp_path: Path):
    with pytest.raises(UsageError, match="holds no dataset"):
        verify.run(tmp_path)


def test_simulations_without_images_are_verified(tmp_path: Path):
    pytest.importorskip("pybullet", reason="simulation needs PyBullet")
    from datagen.pipeline.generate import generate

    generate(tmp_path / "simulated", load_recipe("moving"), splits={"train": 2}, renderer=None)
    assert find(tmp_path / "simulated") == []
    change_scene(tmp_path / "simulated", "train", 0, make_heavier)
    assert [(finding.check, finding.scene) for finding in find(tmp_path / "simulated")] == [("description", 0)]


def make_heavier(record: SceneRecord) -> None:
    record["objects/mass"][0] += 1


@pytest.mark.slow
@pytest.mark.parametrize("name", names_without_meshes())
def test_every_recipe_is_verified(tmp_path: Path, name: str):
    from datagen.pipeline.generate import generate

    generate(tmp_path / name, load_recipe(name), splits={"train": 10, "test": 2})
    assert find(tmp_path / name) == []


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scenes"), [("mixed", 300), ("moving", 100), ("touching", 100), ("cluttered", 100)])
def test_of_hundreds_of_scenes_none_is_suspected(tmp_path: Path, name: str, scenes: int):
    from datagen.pipeline.generate import Run, generate

    generate(tmp_path / name, load_recipe(name), splits={"train": scenes}, resolution=(64, 64), run=Run(workers=2))
    assert find(tmp_path / name, workers=2) == []
