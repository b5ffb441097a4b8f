import csv
import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from signal import SIGTERM

import pytest

from benchmark.commands.cli import main
from benchmark.execution import plan
from benchmark.execution.executor import Limits
from benchmark.execution.jobs import run_all
from benchmark.results.run_folder import RunRow, load_runs
from datagen.errors import EXIT_INCOMPLETE, EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE
from datagen.tracks import DataFolder
from tests import fake_plugins
from tests.paths import ROOT
from tests.worlds.traced import write_dataset


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("bench") / "data", scenes=2, frames=2)


@pytest.fixture(scope="module", autouse=True)
def plugins(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(fake_plugins.install(tmp_path_factory.mktemp("site")))
        yield


@pytest.fixture(scope="module")
def finished(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two models, `good` and `chance`, with one seed; not to be changed."""
    out = tmp_path_factory.mktemp("finished") / "run"
    assert run_cli("--model", "good", "chance", "--data", data, "--out", out, "--seeds", 1) == EXIT_OK
    return out


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished run, with the times of its files."""
    return Path(shutil.copytree(finished, tmp_path / "copy"))


def run_cli(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def rows_of(folder: Path) -> dict[str, RunRow]:
    return {row.key.model: row for row in load_runs(folder)}


def test_a_run_leaves_rows_tables_and_a_short_table_on_the_screen(data: Path, tmp_path: Path, capsys):
    out = tmp_path / "out"
    assert run_cli("--model", "plane-dbscan", "good", "--data", data, "--out", out, "--seeds", 2) == EXIT_OK
    shown = capsys.readouterr()
    assert "data, plane-dbscan, seed 1: fit" in shown.err
    assert shown.err.count("good, seed") == 1  # it has no randomness
    assert "plane-dbscan  ‡" in shown.out
    assert str(out) in shown.out
    with (out / "leaderboard.csv").open(newline="") as file:
        lines = {line["model"]: line for line in csv.DictReader(file)}
    assert set(lines) == {"plane-dbscan", "good"}
    assert float(lines["plane-dbscan"]["ari_fg_mean"]) > 0.99
    assert lines["good"]["n_seeds"] == "2"
    tables = [path.read_bytes() for path in (out / "scenes").glob("*--good--*")]
    assert len(tables) == 2
    assert len(set(tables)) == 1
    assert len(list((out / "labels").glob("*--good--*"))) == 1
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["models"] == {"good": 3, "plane-dbscan": 1}
    assert manifest["rows"] == {"ok": 4, "failed": 0}
    assert manifest["best_floor"] == {"data": None}
    assert set(manifest["sha256"]) == {"leaderboard.csv", "per_seed.csv", "leaderboard.md", "leaderboard.tex"}
    assert "No floor was scored on data" in shown.out


def test_a_second_run_makes_only_what_is_missing(data: Path, copy: Path, capsys):
    command = ("--data", data, "--out", copy, "--model", "chance", "good", "--seeds", 2)
    before = {path: path.stat().st_mtime_ns for path in (copy / "runs").iterdir()}
    assert run_cli(*command) == EXIT_OK
    said = capsys.readouterr().err
    assert "chance, seed 1" in said
    assert "chance, seed 0" not in said
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert [(row.key.model, row.key.seed) for row in load_runs(copy)] == [
        ("chance", 0),
        ("chance", 1),
        ("good", 0),
        ("good", 1),
    ]
    assert run_cli(*command) == EXIT_OK
    said = capsys.readouterr().err
    assert "seed" not in said
    assert "All rows are there" in said


def test_a_damaged_manifest_is_named_before_rows_are_made(data: Path, copy: Path, capsys):
    (copy / "manifest.json").write_text("{")
    before = load_runs(copy)
    assert run_cli("--model", "chance", "--data", data, "--out", copy, "--seeds", 3) == EXIT_INCOMPLETE
    assert "manifest.json is damaged" in capsys.readouterr().err
    assert load_runs(copy) == before


def test_a_failure_is_a_row_with_its_reason_and_made_again_when_asked(data: Path, copy: Path, capsys):
    command = ("--model", "raises", "good", "--data", data, "--out", copy, "--seeds", 1)
    assert run_cli(*command) == EXIT_INCOMPLETE
    rows = rows_of(copy)
    assert (rows["raises"].status, rows["raises"].reason) == ("failed", "ValueError: no idea")
    assert rows["good"].status == "ok"
    assert "data, raises, seed 0: FAILED, ValueError: no idea" in capsys.readouterr().err
    assert "Traceback" in next((copy / "logs").glob("data--raises--*.log")).read_text()
    assert run_cli(*command) == EXIT_INCOMPLETE
    assert "1 of these rows failed; --retry makes them again." in capsys.readouterr().err
    assert run_cli(*command, "--retry") == EXIT_INCOMPLETE
    shown = capsys.readouterr().err
    assert "raises, seed 0: FAILED" in shown
    assert "good" not in shown


def test_a_run_that_serves_all_seeds_is_made_again_for_all(data: Path, copy: Path):
    command = ("--model", "raises", "--data", data, "--out", copy)
    assert run_cli(*command, "--seeds", 2) == EXIT_INCOMPLETE
    assert run_cli(*command, "--seeds", 1, "--retry") == EXIT_INCOMPLETE
    assert [row.key.seed for row in load_runs(copy) if row.key.model == "raises"] == [0]


FAILURES = {
    "raises": "ValueError: no idea",
    "raises-in-fit": "OSError: no weights",
    "crashes": "crashed with SIGSEGV",
    "killed": "most likely because memory ran out",
    "leaves": "its process ended by itself with exit code 0 before it returned a result",
    "exits": "its process ended by itself with exit code 0 before it returned a result",
    "exits-with-a-code": "its process ended by itself with exit code 7 before it returned a result",
    "out-of-memory": "out of memory: cannot allocate",
    "wrong-shape": "expected integers of shape (2, 1, 48, 64)",
    "nan": "with nan",
    "too-many-slots": "slot 256; expected 0 to 255",
}


@pytest.mark.slow
def test_every_failure_is_a_row_with_its_reason_and_the_rest_goes_on(data: Path, tmp_path: Path):
    models = [*FAILURES, "good"]
    command = ("--model", *models, "--data", data, "--out", tmp_path, "--seeds", 1)
    assert run_cli(*command) == EXIT_INCOMPLETE
    rows = rows_of(tmp_path)
    assert {
        name: row.reason for name, row in rows.items() if row.status == "failed" and FAILURES[name] in row.reason
    }.keys() == FAILURES.keys()
    assert rows["good"].status == "ok"
    assert "in fit" in next((tmp_path / "logs").glob("data--exits--*.log")).read_text()


@pytest.mark.slow
def test_a_model_that_takes_too_much_memory_is_stopped(data: Path, tmp_path: Path):
    limit = ("--memory-limit", 500)
    assert run_cli("--model", "hoards", "--data", data, "--out", tmp_path, "--seeds", 1, *limit) == EXIT_INCOMPLETE
    assert rows_of(tmp_path)["hoards"].reason.startswith("out of memory: ")


@pytest.mark.slow
def test_what_a_model_says_of_itself_is_in_its_row_and_other_settings_do_not_replace_it(
    data: Path, tmp_path: Path, capsys
):
    command = ("--model", "chance", "--data", data, "--out", tmp_path, "--seeds", 2)
    assert run_cli(*command, "--steps", 5) == EXIT_OK
    row = rows_of(tmp_path)["chance"]
    assert row.config == {"slots": 5, "steps": 5}
    assert row.learning_curve == [{"step": 1.0, "loss": 0.5}]
    assert (row.parameters, row.random, row.kind, row.key.version) == (7, True, "learned", 3)
    assert run_cli(*command, "--steps", 6) == EXIT_USAGE
    assert "of other settings (different: config_hash)" in capsys.readouterr().err
    assert run_cli(*command, "--steps", 6, "--overwrite") == EXIT_OK
    assert [row.config["steps"] for row in load_runs(tmp_path)] == [6, 6]
    assert len(list((tmp_path / "labels").iterdir())) == 2


def test_scores_are_computed_again_from_label_maps(copy: Path, capsys):
    before = {path: path.read_bytes() for path in (copy / "scenes").iterdir()}
    for path in before:
        path.unlink()
    assert run_cli("report", copy) == EXIT_INCOMPLETE
    assert "obpose-bench rescore" in capsys.readouterr().err
    assert run_cli("rescore", copy) == EXIT_OK
    assert {path: path.read_bytes() for path in before} == before


def test_scores_stay_as_they_were_where_one_label_map_is_missing(copy: Path, capsys):
    for path in (copy / "scenes").iterdir():
        path.write_text("as they were")
    max((copy / "labels").iterdir()).unlink()
    assert run_cli("rescore", copy) != EXIT_OK
    assert "is missing" in capsys.readouterr().err
    assert {path.read_text() for path in (copy / "scenes").iterdir()} == {"as they were"}


def test_an_interrupt_of_pack_promises_only_what_was_packed_before(finished: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr("benchmark.ranking.pack.write_manifest", lambda *_arguments: os.kill(os.getpid(), SIGTERM))
    assert run_cli("pack", finished, "--out", tmp_path / "packed") == EXIT_INTERRUPTED
    error = capsys.readouterr().err
    assert error == "obpose-bench: Interrupted; rows packed before are kept. Run the same command again.\n"
    assert not list(tmp_path.iterdir())


def test_packed_results_are_compared_and_reported_and_never_run_into(
    data: Path, finished: Path, tmp_path: Path, capsys
):
    packed = tmp_path / "packed"
    assert run_cli("pack", finished, "--out", packed) == EXIT_OK
    assert f"2 rows added to {packed}, which has 2 now." in capsys.readouterr().out
    assert run_cli("compare", "good", "chance", "--run", packed) == EXIT_OK
    assert run_cli("report", packed) == EXIT_OK
    shown = capsys.readouterr().out
    assert "A = good, B = chance" in shown
    assert (packed / "report.html").exists()
    before = sorted(packed.rglob("*"))
    run = ("--model", "good", "chance", "--data", data, "--seeds", 1)
    for command in ((*run, "--overwrite", "--out", packed), ("rescore", packed)):
        assert run_cli(*command) == EXIT_USAGE
        assert "read-only" in capsys.readouterr().err
    assert sorted(packed.rglob("*")) == before


@pytest.mark.parametrize("name", ["leaderboard.csv", "report.html", "manifest.json"])
def test_files_of_somebody_else_are_not_overwritten(data: Path, tmp_path: Path, capsys, name: str):
    own = tmp_path / name
    own.write_text("my thesis")
    assert run_cli("--model", "good", "--data", data, "--seeds", 1, "--out", tmp_path) == EXIT_USAGE
    assert f"holds {name}, which would be overwritten" in capsys.readouterr().err
    assert own.read_text() == "my thesis"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_models_and_tracks_are_listed(capsys):
    assert run_cli("--list") == EXIT_OK
    shown = capsys.readouterr().out
    assert {"plane-dbscan", "good", "training-free:", "multishape", "80x60"} <= set(shown.split())
    assert "group paper: obpose-loc, obpose, ic-sbp, " in shown
    assert "group paper: moving, static, clevr3d, multishape" in shown


ON_DATA = "--model plane-dbscan --data {data} "
GIVEN = "--predictions {empty} --data {data} "


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "Name what to score and where"),
        ("--predictions {empty}", "Name what to score and where"),
        (ON_DATA + "--track moving", "Name what to score and where"),
        (GIVEN + "--slots 3", "--slots is for models that are run here"),
        (GIVEN + "--fit-track mixed", "--fit-track is for models"),
        (ON_DATA + "--pretrained", "--pretrained is for models that learn"),
        ("--model obpose --data {data} --pretrained", "No weights of 'obpose' trained on 'data' at 64x48"),
        ("--model plane-dbscn --data {data}", "did you mean 'plane-dbscan'"),
        ("--model plane-dbscan --track movin", "did you mean 'moving'"),
        (ON_DATA + "--fit-track mixd", "did you mean 'mixed'"),
        ("--model plane-dbscan --data {empty}", "holds no dataset"),
        (ON_DATA + "--seeds 0", "--seeds is 0"),
        (ON_DATA + "--memory-limit nan", "--memory-limit is nan"),
        (ON_DATA + "--out {data}", "is a dataset, whose manifest would be lost"),
        (ON_DATA + "--out {file}", "is a file"),
        (GIVEN + "--name x/../../evil", "cannot be a model's name"),
        (GIVEN + "--name ' '", "--name is empty"),
        (GIVEN + "--name Plane-DBSCAN", "'plane-dbscan' is the name of a model"),
        (GIVEN + "--name obpose-att", "gives itself"),
        (GIVEN + "--background-slot 256", "expected 0 to 255"),
        (ON_DATA + "--background-slot 1", "--background-slot is for --predictions"),
        (ON_DATA + "--out=", "--out is empty"),
        ("compare a b --run ''", "--run is empty"),
        ("report ''", "Argument 2 is empty"),
        ("rescore {empty} --data ''", "--data is empty"),
        ("--model plane-dbscan --data '{odd}'", "is called 'a|b', and its name becomes part of file names"),
        ("--model chance --data {data} --deterministic", "--steps"),
        ("rescore {empty}", "holds no finished runs"),
        ("report {empty}", "holds no finished runs"),
        ("compare a b --run {empty}", "holds no finished runs"),
    ],
)
def test_bad_requests_get_one_line(data: Path, tmp_path: Path, capsys, arguments: str, message: str):
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    shutil.copytree(data, tmp_path / "copied" / "a|b")
    places = {"data": data, "empty": tmp_path / "empty", "file": tmp_path / "file", "odd": tmp_path / "copied" / "a|b"}
    assert run_cli(*shlex.split(arguments.format(**places))) == EXIT_USAGE
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1
    assert message in errors


def test_a_dataset_that_is_incomplete_gets_one_line(tmp_path: Path, capsys):
    folder = write_dataset(tmp_path / "data", scenes=1)
    next(folder.glob("test-*.h5")).unlink()
    assert run_cli("--model", "good", "--data", folder, "--out", tmp_path / "out") == EXIT_INCOMPLETE
    assert "1 scene missing" in capsys.readouterr().err


def test_what_another_process_is_making_is_not_a_failure(data: Path, tmp_path: Path, capsys):
    out = tmp_path / "out"
    assert run_cli("--model", "taken", "--data", data, "--out", out) == EXIT_USAGE
    assert "Another process is writing to there; let it end." in capsys.readouterr().err
    assert not load_runs(out)


def test_torch_is_not_imported(data: Path, tmp_path: Path):
    """Nor anything else that is heavy, by no process: whoever imports it fails."""
    for name in ("torch", "numba", "pybullet", "pyrender", "trimesh"):
        (tmp_path / "poison" / name).mkdir(parents=True)
        (tmp_path / "poison" / name / "__init__.py").write_text("raise RuntimeError('it was imported')")
    arguments = ["--model", "plane-dbscan", "--seeds", "1", "--data", str(data), "--out", str(tmp_path / "out")]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path / 'poison'}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-m", "benchmark.commands.cli", *arguments]
    result = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "plane-dbscan" in (tmp_path / "out" / "leaderboard.csv").read_text()


@pytest.mark.slow
def test_one_fit_serves_all_tracks_and_one_failure_costs_one_row(tmp_path: Path):
    sizes = {"a": (64, 48), "b": (32, 24), "c": (64, 48)}
    folders = [
        DataFolder(write_dataset(tmp_path / name, scenes=1, frames=1, size=size)) for name, size in sizes.items()
    ]
    request = plan.Request(("fails-on-second-track",), tuple(folders), seeds=1, fit_source=folders[0])
    made = plan.make_plan(request, [], tmp_path / "out")
    assert len(made.jobs) == 1
    heard: list[RunRow] = []
    run_all(made.jobs, lambda job: Limits(60.0, 2000.0), 2, heard.append)
    assert [(row.key.track, row.key.fit_track, row.status) for row in heard] == [
        ("a", "a", "ok"),
        ("b", "a", "failed"),
        ("c", "a", "ok"),
    ]
    assert [row.key for row in load_runs(tmp_path / "out")] == sorted(row.key for row in heard)
