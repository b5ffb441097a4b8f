import csv
import os
import subprocess
import sys
from pathlib import Path

import jaxtyping
import pytest
from fabricated import write_dataset

from benchmark.cli import main

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("bench") / "data", scenes=2, frames=2)


def run_cli(*arguments: object) -> int:
    with pytest.raises(SystemExit) as exit_:
        main([str(argument) for argument in arguments])
    return int(exit_.value.code or 0)


def test_scores_go_to_the_screen_and_into_the_table(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "leaderboard.csv"
    assert run_cli("--model", "plane-dbscan", "--data", data, "--out", out, "--seeds", 2) == 0
    shown = capsys.readouterr().out
    assert "plane-dbscan" in shown
    assert "msc_fg" in shown
    assert str(out) in shown
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["seed"] for row in rows] == ["0", "1"]
    assert float(rows[0]["ari_fg"]) > 0.99


def test_models_are_listed(capsys: pytest.CaptureFixture[str]):
    assert run_cli("--list") == 0
    assert "plane-dbscan" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--model", "plane-dbscn", "--data", "{data}"], "did you mean 'plane-dbscan'"),
        (["--model", "plane-dbscan"], "Name a model and a dataset"),
        (["--model", "plane-dbscan", "--data", "{empty}"], "holds no dataset"),
        (["--model", "plane-dbscan", "--data", "{data}", "--seeds", "0"], "--seeds is 0"),
        (["--model", "plane-dbscan", "--data", "{data}", "--out", "{foreign}"], "not a leaderboard"),
    ],
)
def test_bad_requests_get_one_line(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
):
    foreign = tmp_path / "foreign.csv"
    foreign.write_text("a,b\n")
    places = {"data": data, "empty": tmp_path, "foreign": foreign}
    assert run_cli(*[argument.format(**places) for argument in arguments]) == 2
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1
    assert message in errors


def test_a_damaged_shard_gets_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    # The type checker looks into sequences, and would meet the damage before the program does.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    folder = write_dataset(tmp_path / "data", scenes=1)
    shard = next(folder.glob("test-*.h5"))
    shard.write_bytes(shard.read_bytes()[:2000])
    assert run_cli("--model", "plane-dbscan", "--data", folder, "--out", tmp_path / "l.csv") == 3
    assert "truncated" in capsys.readouterr().err
    assert not (tmp_path / "l.csv").exists()


def test_a_table_that_cannot_be_written_gets_one_line(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "file").write_text("")
    assert run_cli("--model", "plane-dbscan", "--data", data, "--out", tmp_path / "file" / "l.csv") == 2
    assert "is not a folder" in capsys.readouterr().err


def test_torch_is_not_imported(data: Path, tmp_path: Path):
    arguments = ["--model", "plane-dbscan", "--data", str(data), "--out", str(tmp_path / "l.csv")]
    code = (
        "import sys; from benchmark.cli import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit as exit_: assert exit_.code == 0, exit_.code\n"
        "heavy = {'torch', 'numba', 'pybullet', 'pyrender', 'trimesh'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    result = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "l.csv").exists()


def test_generated_scenes_are_segmented(tiny_dataset: Path, tmp_path: Path):
    out = tmp_path / "leaderboard.csv"
    assert run_cli("--model", "plane-dbscan", "--data", tiny_dataset, "--out", out) == 0
    row = next(csv.DictReader(out.read_text().splitlines()))
    assert row["dataset"] == "moving"
    assert row["n_frames"] == "20"
    assert float(row["miou_bg"]) > 0.99
    assert float(row["msc_fg"]) > 0.6
