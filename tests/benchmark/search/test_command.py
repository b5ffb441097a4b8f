"""`obpose-bench search` as a person runs it."""

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark.cli import main
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, EXIT_USAGE
from tests import foreign
from tests.fabricated import write_dataset
from tests.processes import errors_at_end, wait_until

ROOT = Path(__file__).parent.parent.parent.parent


@pytest.fixture(scope="module", autouse=True)
def plugins(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(foreign.install(tmp_path_factory.mktemp("site")))
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("search") / "data", scenes=1, frames=1)


def run_cli(*arguments: object) -> int:
    with pytest.raises(SystemExit) as exit_:
        main(["search", *map(str, arguments)])
    return int(exit_.value.code or 0)


def fits(out: Path) -> dict[str, int]:
    """How often each trial was fitted."""
    counts = {path.parent.name: len(path.read_text().splitlines()) for path in out.glob("training/*/fits")}
    return {name.split("--")[2]: count for name, count in sorted(counts.items())}


def test_the_least_validation_loss_is_chosen_and_only_what_is_missing_is_made(data: Path, tmp_path: Path, capsys):
    command = ("--model", "searched", "--data", data, "--out", tmp_path, "--minutes", 1)
    assert run_cli(*command) == EXIT_INCOMPLETE
    shown = capsys.readouterr()
    assert "This takes about" in shown.err
    assert "data, searched, trial 1: 1 step in 0.5 s, validation loss 3.0000" in shown.err
    assert "data, searched, trial 3: FAILED, TypeError" in shown.err
    assert "searched: worse=-1.0 (trial 2 of 4, by validation loss)." in shown.out
    with (tmp_path / "search.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [(line["trial"], line["validation_loss"], line["chosen"]) for line in lines] == [
        ("0", "1.000000", "no"),
        ("1", "3.000000", "no"),
        ("2", "0.000000", "yes"),
        ("3", "nan", "no"),
    ]
    assert lines[2]["changes"] == '{"worse": -1.0}'
    assert fits(tmp_path) == {"trial0": 1, "trial1": 1, "trial2": 1, "trial3": 1}

    before = (tmp_path / "search.csv").read_bytes()
    next((tmp_path / "trials").glob("*trial1*")).unlink()
    assert run_cli(*command, "--retry") == EXIT_INCOMPLETE
    assert fits(tmp_path) == {"trial0": 1, "trial1": 2, "trial2": 1, "trial3": 2}
    assert (tmp_path / "search.csv").read_bytes() == before


@pytest.mark.slow
def test_a_search_that_is_killed_goes_on(tiny_dataset: Path, tmp_path: Path):
    command = ["--model", "obpose-loc", "--data", str(tiny_dataset), "--out", str(tmp_path), "--steps", "25"]

    def start() -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "benchmark.cli", "search", *command],
            env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def done() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in (tmp_path / "trials").glob("*.json")}

    process = start()
    wait_until(lambda: len(done()) > 0, seconds=280, what="the first trial")
    process.send_signal(signal.SIGKILL)
    errors_at_end(process, seconds=60)
    kept = done()
    assert 0 < len(kept) < 4
    process = start()
    errors = errors_at_end(process, seconds=500)
    assert process.returncode == EXIT_OK, errors
    assert {path: done()[path] for path in kept} == kept
    with (tmp_path / "search.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["steps"] for line in lines] == ["25"] * 4
    assert [line["chosen"] for line in lines].count("yes") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--model", "plane-dbscan", "--data", "{data}"], "'plane-dbscan' learns nothing"),
        (["--model", "searched", "--data", "{data}", "--minutes", "0"], "--minutes is 0"),
        (["--model", "searched", "--data", "{data}", "--steps", "0"], "--steps is 0"),
        (["--model", "searched", "--data", "{data}", "--track", "moving"], "not both"),
        (["--model", "searched", "--track", "movin"], "did you mean 'moving'"),
    ],
)
def test_bad_requests_get_one_line(data: Path, tmp_path: Path, capsys, arguments: list[str], message: str):
    command = [argument.format(data=data) for argument in arguments]
    assert run_cli(*command, "--out", tmp_path / "out") == EXIT_USAGE
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1
    assert message in errors


def test_a_table_without_its_trials_is_not_overwritten(data: Path, tmp_path: Path, capsys):
    (tmp_path / "search.csv").write_text("system,trial\n")
    assert run_cli("--model", "searched", "--data", data, "--out", tmp_path, "--minutes", 1) == EXIT_USAGE
    assert "holds the table of a search without its trials" in capsys.readouterr().err
    assert (tmp_path / "search.csv").read_text() == "system,trial\n"
