from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.commands.cli import main
from benchmark.models.registry import MODELS
from benchmark.tasks.editing.lines import load_all
from datagen.errors import EXIT_OK, EXIT_USAGE
from datagen.pipeline.generate import generate
from datagen.schema import EDITS
from tests.worlds import generated

MODEL = ("--task", "editing", "--model", "obpose", "--pretrained", "--fit-track", "moving")


def run_cli(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def fitting(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One scene and frame with all edits."""
    folder = tmp_path_factory.mktemp("fitting") / "scenes"
    generate(folder, generated.recipe(frames=1), splits={"test": 1}, resolution=(32, 32), edits=EDITS)
    return folder


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--task", "editing", "--model", "obpose"), "add --pretrained"),
        ((*MODEL[:4], "plane-dbscan", *MODEL[4:]), "'plane-dbscan' infers no scenes"),
        ((*MODEL, "--scenes", 0), "--scenes is 0; expected 1 to 1000000"),
        (("--model", "obpose", "--pretrained", "--scenes", 3), "--scenes is for --task editing"),
        (("--model", "obpose", "--pretrained", "--refine", 3), "--refine is for --task editing"),
        ((*MODEL, "--refine", -1), "--refine is -1; expected 0 to 100000"),
        (("--task", "editing", "--model", "supervised", "--pretrained"), "No weights of 'supervised'"),
        (("--task", "editing", "--predictions", "maps", "--track", "moving"), "label maps cannot be edited"),
        (("--task", "drawing", "--model", "obpose"), "drawing"),
    ],
)
def test_a_bad_request_is_one_clear_message(arguments: tuple, message: str, tmp_path: Path, capsys):
    assert run_cli(*arguments, "--out", tmp_path / "out") == EXIT_USAGE
    said = capsys.readouterr()
    assert message in " ".join((said.err + said.out).split())
    assert not (tmp_path / "out").exists()


def test_a_dataset_without_edits_is_refused(tmp_path: Path, capsys):
    generated.make(tmp_path / "plain", {"test": 1})
    assert run_cli(*MODEL, "--data", tmp_path / "plain", "--out", tmp_path / "out") == EXIT_USAGE
    assert "holds no edits" in capsys.readouterr().err


def test_a_run_leaves_lines_and_tables_and_goes_on(
    fitting: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    out = tmp_path / "out"
    assert run_cli(*MODEL, "--data", fitting, "--out", out) == EXIT_OK
    shown = capsys.readouterr()
    assert "scenes, obpose-pretrained: 1 scene" in shown.err
    assert "no-edit" in shown.out
    before = {path.name: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert {"editing.csv", "editing.md"} < set(before)
    assert run_cli(*MODEL, "--data", fitting, "--out", out) == EXIT_OK
    assert "obpose-pretrained: 1 scene" not in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    assert not (out / "leaderboard.csv").exists()
    # Refined scenes have rows of their own; weights by name are the same ones.
    given = ("--task", "editing", "--checkpoint", "obpose--moving--64x64", "--name", "mine")
    assert run_cli(*given, "--data", fitting, "--out", out, "--refine", 3) == EXIT_OK
    assert "scenes, mine-refined: 1 scene" in capsys.readouterr().err
    lines = {line["model"]: line for line in load_all(out) if line["answer"] == "edit"}
    assert set(lines) == {"obpose-pretrained", "mine-refined"}
    assert len({line["psnr_outside"] for line in lines.values()}) == 2
    assert run_cli(*given, "--data", fitting, "--out", out, "--refine", 5) == EXIT_USAGE
    assert "or with another --refine" in " ".join(capsys.readouterr().err.split())
    # Another version of the model makes its edits again.
    monkeypatch.setitem(MODELS, "obpose", replace(MODELS["obpose"], version=MODELS["obpose"].version + 1))
    assert run_cli(*MODEL, "--data", fitting, "--out", out) == EXIT_USAGE
    assert "edits by another version of the model" in " ".join(capsys.readouterr().err.split())


def test_lines_of_another_dataset_are_not_mixed_in(fitting: Path, tmp_path: Path, capsys):
    stale = tmp_path / "editing" / "scenes--references--01234567.csv"
    stale.parent.mkdir()
    stale.write_text("")
    assert run_cli(*MODEL, "--data", fitting, "--out", tmp_path) == EXIT_USAGE
    assert "--overwrite to replace them" in capsys.readouterr().err
