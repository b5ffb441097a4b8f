"""`obpose-bench` with models that really learn, for a few steps on the smallest real dataset."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from safetensors import safe_open

from assets import CHECKPOINTS
from benchmark.commands.cli import main
from benchmark.results.run_folder import load_runs
from datagen.errors import EXIT_INTERRUPTED, EXIT_OK
from obpose.storage.checkpoint import read_config
from tests.paths import ROOT
from tests.processes import errors_at_end, wait_until

STEPS = 16
SHIPPED = "obpose--moving--64x64"

pytestmark = pytest.mark.slow


def run_cli(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def start(data: Path, out: Path, *, steps: int = STEPS) -> subprocess.Popen[str]:
    command = ["--model", "obpose", "--seeds", 1, "--data", data, "--out", out, "--deterministic", "--steps", steps]
    return subprocess.Popen(
        [sys.executable, "-m", "benchmark.commands.cli", *map(str, command)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def saved_step(out: Path) -> int:
    """Step of the training's state on disk; -1 before there is one."""
    for path in out.glob("training/*/training.safetensors"):
        with safe_open(path, framework="pt") as file:
            return json.loads(file.metadata()["info"])["step"]
    return -1


def steps_in(out: Path) -> list[str]:
    """Steps in the training's own log; the last line may still be on its way."""
    logs = list(out.glob("training/*/training.csv"))
    return [line.partition(",")[0] for line in logs[0].read_text().splitlines()[1:]] if logs else []


def labels_in(out: Path) -> dict[str, np.ndarray]:
    found = {}
    for path in (out / "labels").iterdir():
        with h5py.File(path) as file:
            found[path.name.split("--")[1]] = file["labels"][:]
    return found


@pytest.fixture(scope="module")
def whole(tiny_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    process = start(tiny_dataset, out)
    errors = errors_at_end(process, seconds=280)
    assert process.returncode == EXIT_OK, errors
    return out


def test_one_training_makes_two_rows_a_curve_and_a_checkpoint(whole: Path):
    rows = {row.key.model: row for row in load_runs(whole)}
    assert set(rows) == {"obpose", "obpose-att"}
    row = rows["obpose"]
    assert (row.status, row.n_scenes, row.kind) == ("ok", 2, "learned")
    assert row.config["model"]["pose"]["conditioning"] == "full"
    assert row.config["steps"] == STEPS
    assert (row.tuned, row.trials) == (True, 70)
    assert row.learning_curve
    assert row.learning_curve[-1]["step"] == STEPS
    assert [path.stem for path in (whole / "curves").iterdir()] == [row.key.name]
    (folder,) = (whole / "training").iterdir()
    assert {"config.json", "model.safetensors"} <= {path.name for path in folder.iterdir()}
    assert steps_in(whole) == [str(step) for step in range(1, STEPS + 1)]
    page = (whole / "report.html").read_text()
    assert "None of these models keeps a learning curve" not in page
    with (whole / "leaderboard.csv").open(newline="") as file:
        assert {line["model"]: line["pretrained"] for line in csv.DictReader(file)} == {"obpose": "", "obpose-att": ""}


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_was_ended_goes_on_and_gives_the_same_labels(
    tiny_dataset: Path, whole: Path, tmp_path: Path, ending: signal.Signals
):
    process = start(tiny_dataset, tmp_path)
    wait_until(lambda: len(steps_in(tmp_path)) > 5, seconds=200, what="the first steps")
    process.send_signal(ending)
    errors = errors_at_end(process, seconds=60)
    assert process.returncode == (EXIT_INTERRUPTED if ending == signal.SIGINT else -ending), errors
    assert load_runs(tmp_path) == []
    before = len(steps_in(tmp_path))
    assert before < STEPS
    # Even if the command was killed: its worker sees that, and saves.
    wait_until(lambda: saved_step(tmp_path) >= before, seconds=20, what="the last step to be saved")
    errors_at_end(start(tiny_dataset, tmp_path), seconds=280)
    assert steps_in(tmp_path) == [str(step) for step in range(1, STEPS + 1)]
    for model, labels in labels_in(whole).items():
        np.testing.assert_array_equal(labels_in(tmp_path)[model], labels)


def test_a_budget_in_seconds_is_kept_and_the_time_is_told_beforehand(tiny_dataset: Path, tmp_path: Path, capsys):
    command = ("--model", "obpose-loc", "--seeds", 1, "--data", tiny_dataset, "--out", tmp_path, "--budget", 3)
    assert run_cli(*command) == EXIT_OK
    assert re.search(r"This takes about \d minutes?, less", capsys.readouterr().err)
    for row in load_runs(tmp_path):
        assert 3 <= row.measured.fit_seconds < 6


def test_weights_that_ship_need_no_training(tiny_dataset: Path, tmp_path: Path):
    out = tmp_path / "out"
    assert run_cli("--model", "obpose", "plane-dbscan", "--data", tiny_dataset, "--pretrained", "--out", out) == EXIT_OK
    rows = {row.key.model: row for row in load_runs(out) if row.kind == "learned"}
    assert set(rows) == {"obpose-pretrained", "obpose-pretrained-att"}
    assert {row.pretrained for row in rows.values()} == {SHIPPED}
    assert rows["obpose-pretrained"].config["train"]["steps"] == read_config(CHECKPOINTS / SHIPPED).train.steps
    assert not (out / "training").exists()
    with (out / "leaderboard.csv").open(newline="") as file:
        lines = {line["model"]: line for line in csv.DictReader(file)}
    assert (lines["obpose-pretrained"]["n_seeds"], lines["obpose-pretrained"]["marks"]) == ("1", "‡70§")
    assert lines["plane-dbscan"]["n_seeds"] == "3"
    assert "§ behind a name: pretrained" in (out / "leaderboard.md").read_text()
    assert_labels_of_checkpoint(SHIPPED, tiny_dataset, tmp_path / "given", labels_in(out), "obpose-pretrained")


def test_weights_of_a_training_give_its_labels(tiny_dataset: Path, whole: Path, tmp_path: Path):
    (trained,) = (whole / "training").iterdir()
    assert_labels_of_checkpoint(trained, tiny_dataset, tmp_path, labels_in(whole), "obpose")


def assert_labels_of_checkpoint(
    checkpoint: Path | str, data: Path, out: Path, expected: dict[str, np.ndarray], name: str
) -> None:
    """A checkpoint gives the labels that a run has under this name."""
    assert run_cli("--checkpoint", checkpoint, "--name", "mine", "--data", data, "--out", out) == EXIT_OK
    found = labels_in(out)
    assert set(found) == {"mine", "mine-att"}
    for model, labels in found.items():
        np.testing.assert_array_equal(labels, expected[model.replace("mine", name)])
