import subprocess
import sys
from typing import get_args, get_type_hints

import pytest

from datagen.commands import cli
from datagen.commands.arguments import Export
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, EXIT_USAGE, EXIT_VERIFICATION
from datagen.formats.exporters import EXPORTERS, Format
from datagen.storage.reader import Dataset
from datagen.storage.shard import pack
from tests.worlds.generated import FLAGS, ROOT, command, hashes, make
from tests.worlds.rendered import write_shard

SMALL = (*FLAGS, "--workers", "1")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "set"
    make(folder, {"train": 1, "test": 1})
    return folder


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def run(*arguments: object) -> int:
    return cli.main([str(argument) for argument in arguments])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "Give either --scenes N"),
        (("--scenes", 0), "--scenes 0: expected at least 1"),
        (("--scenes", 3, "--split", "train=1"), "Give either --scenes N"),
        (("--scenes", 3, "--seed", -1), "--seed -1: expected 0 or more"),
        (("--scenes", 3, "--workers", 0), "--workers 0"),
        (("--scenes", 3, "--resolution", 64), "--resolution 64: expected width x height"),
        (("--scenes", 3, "--shard", "3/2"), "--shard 3/2: expected i/n"),
        (("--scenes", 3, "--split", "training=3"), "Give either"),
        (("--split", "training=3"), "unknown training"),
        (("--scenes", 3, "--recipe", "moveing"), "did you mean 'moving'?"),
        (("--scenes", 3, "--recipe=mving"), "did you mean 'moving'?"),
        (("--scenes", 3, "--video", "--recipe", "static"), "--video contradicts --recipe static"),
        (("--scenes", 3, "--video", "--frames", 1), "--video contradicts --frames 1"),
        (("--scenes", 3, "--video", "--frames", 0), "frames is 0"),
        (("--scenes", 3, "--objects.minimum", 5), "objects.minimum 5 exceeds objects.maximum 4"),
        (("--scenes", 3, "--objects.minimum", 40, "--objects.maximum", 40), "40 objects"),
        (("--scenes", 3, "--simulate-only", "--resolution", "64x64"), "--simulate-only makes no images"),
        (("--scenes", 3, "--edits", "recolour"), "--edits recolour: unknown 'recolour'; expected some of remove"),
        (("--scenes", 3, "--simulate-only", "--edits", "move"), "give --edits to `render`"),
        (("--scenes", 3, "--novelty", 1), "--novelty"),
        (("--scenes", "many"), "many"),
        (("--scenes", 3, "--renderer", "blender"), "blender"),
        (("--scenes", 10**12), "--scenes 1000000000000: expected at least 1 and at most 1,000,000"),
        (("--split", f"train={10**18}"), "expected at most 1,000,000 scenes in a split"),
        (("--scenes", 3, "--frames", 10**9), "frames is 1000000000, expected 1 to 10,000"),
        (("--scenes", 3, "--views", 10**6), "views is 1000000, expected 1 to 360"),
        (("--scenes", 3, "--resolution", "99999x99999"), "from 8 to 4096 pixels"),
        (("--scenes", 3, "--seed", 10**30), "at most 9223372036854775807"),
        (("--scenes", 3, "--workers", 10**6), "--workers 1000000: expected at most"),
        (("--scenes", 3, "--shard", f"0/{10**12}"), "n is at most 100,000"),
        (("--scenes", 3, "--views", 6, "--resolution", "4096x4096"), "of memory, expected at most 4 GiB"),
        (("--scenes", 3, "--frames", 9000, "--resolution", "4096x4096"), "GiB of memory, expected at most 4 GiB"),
        (("--scenes", 3, "--rig.elevation", -20), "above the table's top, expected more than 0"),
        (("--scenes", 3, "--sensor.grazing-angle", 91), "sensor.grazing_angle is 91.0, expected 0 to 90"),
        (("--scenes", 3, "--recipe", ""), "--recipe is empty"),
        (("--scenes", 3, "--out", ""), "--out is empty"),
        (("--scenes", 3, "--out="), "--out is empty"),
        (("render", "--from", ""), "--from is empty"),
        (("render", "--from=", "--out", "x"), "--from is empty"),
        (("verify", ""), "is empty"),
        (("stats", ""), "is empty"),
        (("preview", ""), "is empty"),
        (("inspect", ""), "is empty"),
        (("regenerate", ""), "is empty"),
        (("render",), "--from"),
        (("render", "--from", "nowhere"), "nowhere holds no dataset"),
        (("verify", "nowhere"), "nowhere holds no dataset"),
        (("stats", "nowhere"), "nowhere holds no dataset"),
        (("preview", "nowhere"), "nowhere holds no dataset"),
        (("inspect", "nowhere"), "nowhere holds no dataset"),
        (("regenerate", "nowhere"), "nowhere holds no dataset"),
        (("regenerate",), "folder"),
    ],
)
def test_a_bad_request_is_one_clear_message(arguments, message: str, capsys, tmp_path):
    assert run(*arguments) == EXIT_USAGE
    output = capsys.readouterr()
    assert message.lower() in " ".join((output.err + output.out).split()).lower()
    assert "Traceback" not in output.err
    assert not list(tmp_path.rglob("*.h5"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("regenerate", "--scene", 1), "--scene 1: split train has scenes 0 to 0"),
        (("inspect", "--scene", -1), "--scene -1"),
        (("--seed", 1, *SMALL, "--scenes", 3, "--out"), "seed: 0 -> 1"),
    ],
)
def test_a_bad_request_about_a_dataset_is_one_clear_message(dataset, arguments, message: str, capsys):
    name, *rest = arguments
    ordered = (*arguments, dataset) if rest[-1] == "--out" else (name, dataset, *rest)
    before = hashes(dataset)
    assert run(*ordered) == EXIT_USAGE
    assert message in capsys.readouterr().err
    assert hashes(dataset) == before


def test_a_folder_that_may_not_be_written_is_one_clear_message(capsys):
    assert run(*SMALL, "--scenes", 1, "--out", "/proc/data") == EXIT_INCOMPLETE
    assert capsys.readouterr().err.startswith("obpose-datagen: /proc/data: ")


def test_generating_says_where_the_data_is_and_how_to_load_it(tmp_path, capsys):
    assert run(*SMALL, "--split", "train=2,test=1") == EXIT_OK
    folder = tmp_path / "data" / "moving-32x32-seed0"
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{folder}: 2 train, 0 val, 1 test scenes; 3 made in ")
    code = [line.strip() for line in lines if line.startswith("    ")]
    assert len(code) == 5
    values: dict = {}
    exec("\n".join(code), values)
    assert values["rgb"].shape == (3, 1, 32, 32, 3)
    assert 0.5 < values["depth"].max() < 5
    assert hashes(folder)["test"]


def test_cameras_that_scenes_cannot_be_rendered_with_are_refused_before_a_folder_is_made(tmp_path, dataset, capsys):
    for flags, words in [
        (("--rig.distance", 0.1), "Move the cameras with --rig.distance"),
        (("--rig.elevation", 3, "--rig.distance", 0.35), "sees the table from 4.4 cm"),
        (("--rig.elevation", -20), "above the table's top"),
        (("--rig.distance", 9), "sees the table at"),
        (("--views", 10**6), "views is 1000000"),
    ]:
        assert run("render", "--from", dataset, "--out", "made", *flags) == EXIT_USAGE
        assert words in capsys.readouterr().err
        assert not (tmp_path / "made").exists()


def test_shares_say_that_others_are_missing(tmp_path, capsys):
    assert run(*SMALL, "--split", "train=1,val=1", "--shard", "0/2", "--out", "set") == EXIT_OK
    assert "Shards are still missing" in capsys.readouterr().out
    assert run(*SMALL, "--split", "train=1,val=1", "--shard", "1/2", "--out", "set") == EXIT_OK
    assert "Load it" in capsys.readouterr().out


def test_fewer_scenes_than_there_are_say_that_none_was_deleted(dataset, capsys):
    assert run(*SMALL, "--split", "test=1", "--out", dataset) == EXIT_OK
    assert "none was deleted" in capsys.readouterr().out


def test_every_constant_of_a_recipe_has_a_flag(tmp_path):
    flags = ("--objects.maximum", 3, "--lighting.no-shadows", "--rig.distance", 1.2, "--motion.weights.roll", 2)
    assert run(*SMALL, "--scenes", 1, "--out", tmp_path / "set", *flags) == EXIT_OK
    recipe = Dataset(tmp_path / "set").spec["recipe"]
    assert (recipe["name"], recipe["objects"]["maximum"], recipe["lighting"]["shadows"]) == ("moving", 3, False)
    assert (recipe["rig"]["distance"], recipe["motion"]["weights"]["roll"], recipe["frames"]) == (1.2, 2.0, 3)


def test_regenerate_proves_and_disproves(tmp_path, dataset, capsys):
    assert run("regenerate", dataset, "--split", "test", "--scene", 0) == EXIT_OK
    assert "every array has the stored SHA-256" in capsys.readouterr().out
    record = Dataset(dataset).split("train")[0]
    make(tmp_path / "set", {"train": 1})
    record["depth"] = record["depth"] + 1
    write_shard(tmp_path / "set", Dataset(tmp_path / "set").spec, "train", 0, [pack(record)])
    assert run("regenerate", tmp_path / "set", "--split", "train", "--scene", 0) == EXIT_VERIFICATION
    assert "differ from what is stored: depth" in capsys.readouterr().out


def test_the_other_subcommands_run(dataset, capsys):
    assert run("stats", dataset) == EXIT_OK
    assert run("inspect", dataset, "--split", "test") == EXIT_OK
    assert run("preview", dataset, "--scenes", 0) == EXIT_OK
    assert "preview.png" in capsys.readouterr().out
    assert run("verify", dataset, "--workers", 1) == EXIT_OK


def test_export_says_what_it_wrote(dataset, tmp_path, capsys):
    assert run("export", "--format", "coco", dataset, "--out", tmp_path / "coco", "--splits", "test") == EXIT_OK
    assert f"{tmp_path / 'coco'}: 1 test scenes." in capsys.readouterr().out
    assert run("export", "--format", "coco", dataset, "--out", tmp_path / "coco") == EXIT_USAGE
    assert "already exists and is not empty" in capsys.readouterr().err


def test_every_exporter_is_a_format_of_the_command_line():
    assert get_type_hints(Export)["format"] == Format
    assert list(get_args(Format)) == list(EXPORTERS)


@pytest.mark.parametrize("name", ["", *cli.COMMANDS])
def test_help_is_there_for_every_subcommand(name: str, capsys):
    assert run(*([name] if name else []), "--help") == EXIT_OK
    assert "--help" in capsys.readouterr().out


def test_help_needs_no_engine(tmp_path):
    result = command("--help", cwd=tmp_path)
    assert result.returncode == EXIT_OK
    code = "import sys, datagen.commands.cli; print({'numba', 'pybullet', 'joblib', 'scipy'} & set(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert loaded.stdout == "set()\n"
