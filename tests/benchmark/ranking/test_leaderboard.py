import csv
import io
from pathlib import Path

import numpy as np
import pytest

from benchmark.metrics import CLIP_METRICS, METRICS
from benchmark.ranking import leaderboard
from benchmark.results.run_folder import RunRow, SceneTable
from tests.chosen_scores import failed_row, run_row, save_run, scene_table

N = 20


def runs() -> list[tuple[RunRow, SceneTable | None]]:
    rng = np.random.default_rng(0)
    found: list[tuple[RunRow, SceneTable | None]] = []
    for model, kind, score in (("floor", "floor", 0.1), ("geometry", "classical", 0.7), ("net", "learned", 0.8)):
        for seed in range(2):
            values = score + 0.05 * rng.standard_normal(N)
            table = scene_table({"ari_fg": values, "msc_fg": values - 0.01})
            found.append((run_row(model, seed=seed, kind=kind, n_scenes=N), table))
    found.append((failed_row("net", seed=2), None))
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for row, table in runs():
        save_run(tmp_path, row, table)
    return tmp_path


def read(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text())))


def test_every_column_that_is_promised(folder: Path):
    leaderboard.write(folder)
    columns = set(read(folder / "leaderboard.csv")[0])
    for metric in (*METRICS, *CLIP_METRICS, "identity_switches"):
        assert {f"{metric}_{name}" for name in ("mean", "std", "sample_std", "ci_low", "ci_high")} <= columns
    assert {"track", "fit_track", "model", "n_seeds", "n_failed", "n_scenes", "n_skipped", "priors"} <= columns
    assert {"parameters", "device", "marks", "measured_seconds_per_frame", "measured_fit_seconds"} <= columns


def test_means_are_over_seeds_and_failures_are_told(folder: Path):
    leaderboard.write(folder)
    row = {row["model"]: row for row in read(folder / "leaderboard.csv")}["net"]
    seeds = [float(seed["msc_fg"]) for seed in read(folder / "per_seed.csv") if seed["model"] == "net"][:2]
    assert float(row["msc_fg_mean"]) == pytest.approx(np.mean(seeds), abs=1e-6)
    assert float(row["msc_fg_std"]) == pytest.approx(np.std(seeds), abs=1e-6)
    assert float(row["msc_fg_sample_std"]) == pytest.approx(np.std(seeds, ddof=1), abs=2e-6)
    assert float(row["msc_fg_ci_low"]) < float(row["msc_fg_mean"]) < float(row["msc_fg_ci_high"])
    counts = [row[name] for name in ("n_seeds", "n_scored", "n_failed", "failures")]
    assert counts == ["3", "2", "1", "2: out of memory"]
    assert (row["n_scenes"], row["n_frames"], row["identity_switches_mean"]) == (str(N), str(2 * N), "1.000000")
    floors = [float(seed["msc_fg"]) for seed in read(folder / "per_seed.csv") if seed["model"] == "floor"]
    assert float(row["best_floor"]) == pytest.approx(np.mean(floors), abs=1e-6)


def test_runs_are_counted_apart_from_seeds(tmp_path: Path):
    """Where seeds make no difference, one run stands for all."""
    for name in ("chance", "fixed"):
        for seed in range(3):
            save_run(tmp_path, run_row(name, seed=seed, random=name == "chance"), scene_table({"ari_fg": [0.5] * 3}))
    leaderboard.write(tmp_path)
    found = {row["model"]: (row["n_seeds"], row["n_runs"]) for row in read(tmp_path / "leaderboard.csv")}
    assert found == {"chance": ("3", "3"), "fixed": ("3", "1")}


def test_equal_models_share_a_rank(tmp_path: Path):
    for name, score in (("a", 0.5), ("b", 0.5), ("c", 0.4)):
        save_run(tmp_path, run_row(name), scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}))
    leaderboard.write(tmp_path)
    assert [row["rank"] for row in read(tmp_path / "leaderboard.csv")] == ["1.5", "1.5", "3"]


def test_no_figure_is_minus_zero():
    assert leaderboard.to_csv([{"x": -1e-9}, {"x": -1e-6}]) == "x\n0.000000\n-0.000001\n"


def test_seeds_and_scenes_have_lines_of_their_own(folder: Path):
    leaderboard.write(folder)
    seeds, scenes = read(folder / "per_seed.csv"), read(folder / "per_scene.csv")
    assert [(row["model"], row["seed"], row["status"]) for row in seeds][-2:] == [
        ("net", "1", "ok"),
        ("net", "2", "failed"),
    ]
    assert len(seeds) == 7
    assert len(scenes) == 6 * N
    means = [float(row["ari_fg"]) for row in scenes if (row["model"], row["seed"]) == ("net", "1")]
    assert np.mean(means) == pytest.approx(float(seeds[-2]["ari_fg"]), abs=1e-5)


def test_the_same_rows_give_the_same_bytes(folder: Path, tmp_path_factory: pytest.TempPathFactory):
    """Whatever the order in which they were finished, and what an earlier run wrote."""
    other = tmp_path_factory.mktemp("other")
    for row, table in runs()[:3]:
        save_run(other, row, table)
    leaderboard.write(other)
    for row, table in runs()[::-1]:
        save_run(other, row, table)
    leaderboard.write(folder)
    leaderboard.write(other)
    for name in leaderboard.FILES:
        assert (folder / name).read_bytes() == (other / name).read_bytes()


def test_an_empty_folder_gives_empty_tables(tmp_path: Path):
    assert leaderboard.write(tmp_path) == []
    assert (tmp_path / "per_scene.csv").read_text() == "\n"


def test_only_measured_columns_depend_on_the_clock(folder: Path, tmp_path: Path):
    """Rows that differ in their costs differ in no other column."""
    leaderboard.write(folder)
    before = {name: read(folder / name) for name in leaderboard.FILES if name.endswith(".csv")}
    for row, table in runs():
        costs = type(row.measured)(7.0, 8.0, 9.0)
        save_run(folder, type(row)(**{**vars(row), "measured": costs}), table)
    leaderboard.write(folder)
    for name, rows in before.items():
        for one, two in zip(rows, read(folder / name), strict=True):
            changed = {column for column in one if one[column] != two[column]}
            assert all(column.startswith("measured_") for column in changed)
