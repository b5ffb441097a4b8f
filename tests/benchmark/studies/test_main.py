from importlib import import_module
from pathlib import Path

import pytest

import benchmark.studies
from benchmark.studies.__main__ import STUDIES, main
from datagen.errors import EXIT_OK, EXIT_USAGE

HELPERS = {"__init__", "__main__", "inputs"}


def test_help_lists_every_study_in_one_line(capsys: pytest.CaptureFixture[str]):
    modules = {path.stem for path in Path(benchmark.studies.__path__[0]).glob("*.py")}
    assert {*STUDIES} == modules - HELPERS
    assert main(["--help"]) == EXIT_OK
    lines = capsys.readouterr().out.splitlines()
    for name, about in STUDIES.items():
        assert sum(name in line.split() and about in line for line in lines) == 1
        assert import_module(f"benchmark.studies.{name}").__doc__


@pytest.mark.parametrize("study", ["views", "samples", "fitted_scenes --picture a.png", "mesh_extents"])
def test_a_split_without_scenes_is_refused(
    study: str, stills: Path, checkpoint: Path, capsys: pytest.CaptureFixture[str]
):
    assert main([*study.split(), "--data", str(stills), "--checkpoint", str(checkpoint)]) == EXIT_USAGE
    assert f"{stills} has no scenes in split test; expected at least one" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("view", "Unknown study 'view'; did you mean 'views'?"),
        ("views --scenes 0", "--scenes 0: expected 1 or more."),
        ("views --frames 0", "--frames 0: expected 1 or more."),
        ("views --csv a.txt", "--csv a.txt: expected a name that ends with .csv."),
        ("views --track nowhere", "Unknown track"),
        ("samples --seed -3", "--seed -3: expected 0 or more."),
        ("samples --picture a.jpg", "--picture a.jpg: expected a name that ends with .png."),
        ("samples --split val", "--split val: scenes of val are a reference"),
        ("fitted_scenes --picture a.jpg", "--picture a.jpg: expected a name that ends with .png."),
    ],
)
def test_wrong_options_are_reported_before_anything_is_made(
    arguments: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    assert main(arguments.split()) == EXIT_USAGE
    printed = capsys.readouterr()
    assert said in printed.err
    assert not printed.out
    assert not list(tmp_path.iterdir())
