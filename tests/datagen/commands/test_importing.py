"""`obpose-datagen import` as a user runs it, and what other commands make of an imported dataset."""

from pathlib import Path

import pytest

from datagen.commands import cli
from datagen.errors import EXIT_OK, EXIT_USAGE, EXIT_VERIFICATION
from datagen.storage.reader import Dataset
from datagen.storage.shard import pack
from tests.worlds.recordings import CAMERAS, shoot, write_rgbd
from tests.worlds.rendered import write_shard


@pytest.fixture(scope="module")
def imported(tmp_path_factory) -> Path:
    """Four stills, two of them without masks."""
    folder = tmp_path_factory.mktemp("import")
    for number in range(4):
        write_rgbd(folder / "source" / f"{number}", [shoot(CAMERAS[number % 3])], masks=number % 2 == 0)
    assert run("import", "--format", "rgbd", folder / "source", "--out", folder / "out") == EXIT_OK
    return folder / "out"


def run(*arguments: object) -> int:
    return cli.main([str(argument) for argument in arguments])


def test_the_summary_tells_depth_world_and_masks(tmp_path: Path, capsys):
    source = write_rgbd(tmp_path / "source", [shoot(), shoot()], masks=False)
    assert run("import", "--format", "rgbd", source, "--out", tmp_path / "out", "--resolution", "24x18") == EXIT_OK
    text = " ".join(capsys.readouterr().out.split())
    assert "1 train, 0 val, 0 test scenes of 2 x 1 images (frames x views) of 24x18 pixels" in text
    assert "Depth: median 0.7" in text
    assert "on the largest plane near the camera" in text
    assert "Masks: none; models can be trained on it but not scored." in text


def test_an_imported_dataset_can_be_looked_at(imported: Path, capsys):
    assert Dataset(imported).splits == {"train": 2, "val": 1, "test": 1}
    for split in ("train", "test"):
        assert run("preview", imported, "--split", split, "--out", imported / f"preview.{split}.png") == EXIT_OK
        assert run("inspect", imported, "--split", split) == EXIT_OK
    assert run("stats", imported) == EXIT_OK
    assert run("verify", imported) == EXIT_OK
    text = " ".join(capsys.readouterr().out.split())
    for part in ("without masks", "camera at", "val, test", "objects per scene", "4 scenes verified, no finding"):
        assert part in text
    card = (imported / "README.md").read_text()
    assert "license: other" in card
    assert "- train: rgb, depth, camera/K, camera/world_from_camera\n" in card


def test_a_damaged_imported_dataset_is_found_out(tmp_path: Path, capsys):
    run("import", "--format", "rgbd", write_rgbd(tmp_path / "a", [shoot()]), "--out", tmp_path / "out")
    dataset = Dataset(tmp_path / "out")
    record = dataset.split("train")[0]
    changes = {
        "ids": ("segmentation", record["segmentation"] * 2, "segmentation has the ids"),
        "box": ("boxes/box_2d", record["boxes/box_2d"] + 1, "box of object 1"),
        "pose": ("camera/world_from_camera", record["camera/world_from_camera"] * 2, "no rigid pose"),
        "matrix": ("camera/K", -record["camera/K"], "no camera matrix"),
    }
    for name, array, message in changes.values():
        write_shard(tmp_path / "out", dataset.spec, "train", 0, [pack({**record, name: array})])
        capsys.readouterr()
        assert run("verify", tmp_path / "out") == EXIT_VERIFICATION
        assert message in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    "command",
    [("render", "--from"), ("regenerate",), ("--scenes", 4, "--out"), ("--scenes", 4, "--overwrite", "--out")],
    ids=["render", "regenerate", "generate", "overwrite"],
)
def test_what_needs_a_recipe_says_so(command: tuple[object, ...], imported: Path, capsys):
    before = sorted(path.name for path in imported.iterdir())
    assert run(*command, imported) == EXIT_USAGE
    assert "was imported (format rgbd)" in " ".join(capsys.readouterr().err.split())
    assert sorted(path.name for path in imported.iterdir()) == before


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--depth-scale", 0), "--depth-scale 0.0: expected more than 0"),
        (("--frames", -1), "--frames -1"),
        (("--objects", 1000), "--objects 1000: expected more than 0 and at most 250"),
        (("--views", 2, "--group", "clip"), "--views is for --group views"),
        (("--frames", 2, "--group", "stills"), "--frames is for --group clip"),
        (("--resolution", "64"), "--resolution 64: expected width x height"),
        (("--out", "."), "is the current folder"),
    ],
)
def test_bad_flags_are_named(flags: tuple[object, ...], message: str, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = write_rgbd(tmp_path / "source", [shoot()])
    assert run("import", "--format", "rgbd", source, "--out", tmp_path / "out", *flags) == EXIT_USAGE
    assert message in " ".join(capsys.readouterr().err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["source"]


def test_a_folder_in_use_is_left_alone(imported: Path, tmp_path: Path, capsys):
    source = write_rgbd(tmp_path / "source", [shoot()])
    assert run("import", "--format", "rgbd", source, "--out", imported) == EXIT_USAGE
    assert "give another --out" in " ".join(capsys.readouterr().err.split())
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "a.txt").write_text("a")
    assert run("import", "--format", "rgbd", source, "--out", tmp_path / "notes") == EXIT_USAGE
