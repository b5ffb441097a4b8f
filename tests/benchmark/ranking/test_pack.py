import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmark.commands import outputs
from benchmark.ranking import leaderboard
from benchmark.ranking import pack as packing
from benchmark.ranking.pack import pack
from benchmark.results.packed_runs import CURVES_FILE, ROWS_FILE, SCENES_FILE, stored_curves, stored_rows, stored_scenes
from benchmark.results.run_folder import Measured, RunRow, SceneTable, load_runs, load_scenes
from datagen.errors import CorruptFile, UsageError
from datagen.storage.atomic import temporary_path
from tests.chosen_scores import failed_row, run_row, save_run, scene_table

CURVE = [{"step": 1.0, "seconds": 60.0, "ari_fg": 1 / 3}]


def table(score: float = 1 / 3, **columns: np.ndarray) -> SceneTable:
    return scene_table({"ari_fg": [score, 0.5, np.nan], "ari_video": [np.nan] * 3}) | columns


def run_folder(folder: Path, *runs: tuple[RunRow, SceneTable | None]) -> Path:
    for row, scores in runs:
        save_run(folder, row, scores)
    return folder


def learned(score: float = 1 / 3, seed: int = 0, model: str = "net") -> tuple[RunRow, SceneTable]:
    return run_row(model, seed=seed, learning_curve=CURVE), table(score)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def agree(one: Path, two: Path) -> None:
    """Check that two folders have the same rows, and the same scores to six decimals."""
    rows = load_runs(one)
    assert rows == load_runs(two)
    for row in rows:
        if row.status == "ok":
            a, b = load_scenes(one, row), load_scenes(two, row)
            assert set(a) == set(b)
            assert all(np.allclose(a[name], b[name], rtol=0, atol=5.001e-7, equal_nan=True) for name in a)


def test_a_packed_folder_reads_like_its_run_folder(tmp_path: Path):
    run = run_folder(tmp_path / "run", learned(), (run_row("other"), table(0.2)), (failed_row("broken"), None))
    assert pack([run], tmp_path / "out") == 3
    agree(run, tmp_path / "out")
    assert sorted(contents(tmp_path / "out")) == [
        CURVES_FILE, "leaderboard.csv", "manifest.json", "per_seed.csv", ROWS_FILE, SCENES_FILE
    ]  # fmt: skip


def test_the_tables_are_those_of_the_run_folder(tmp_path: Path):
    run = run_folder(tmp_path / "run", learned(0.25), learned(0.75, seed=1), (run_row("other"), table(0.5)))
    leaderboard.write(run)
    pack([run], tmp_path / "out")
    for name in ("leaderboard.csv", "per_seed.csv"):
        assert (tmp_path / "out" / name).read_text() == (run / name).read_text()


def test_a_report_leaves_packed_files_alone(tmp_path: Path):
    """Tables of another machine may have other last digits."""
    pack([run_folder(tmp_path / "run", learned())], tmp_path / "out")
    for name in ("leaderboard.csv", "per_seed.csv", "manifest.json"):
        (tmp_path / "out" / name).write_text("as it was published\n")
    before = contents(tmp_path / "out")
    outputs.write(tmp_path / "out", [])
    after = contents(tmp_path / "out")
    made = {"per_scene.csv", "leaderboard.md", "leaderboard.tex", "report.html"}
    assert set(after) - set(before) == made
    assert {name: after[name] for name in before} == before


def test_equal_tables_and_curves_are_stored_once(tmp_path: Path):
    same = [(run_row("fixed", seed=seed, random=False, learning_curve=CURVE), table()) for seed in range(3)]
    run = run_folder(tmp_path / "run", *same, learned(0.2))
    pack([run], tmp_path / "out")
    agree(run, tmp_path / "out")
    assert len(stored_scenes(tmp_path / "out")) == 2
    assert len(stored_curves(tmp_path / "out")) == 1


def test_equal_means_equal_to_six_decimals(tmp_path: Path):
    run = run_folder(tmp_path / "run", learned(0.5), learned(0.5 + 1e-9, seed=1), learned(0.5 + 1e-6, seed=2))
    pack([run], tmp_path / "out")
    assert len(stored_scenes(tmp_path / "out")) == 2


def test_a_row_that_another_folder_of_the_tree_has_is_a_reference(tmp_path: Path):
    pack([run_folder(tmp_path / "run", learned())], tmp_path / "out")
    run = run_folder(tmp_path / "more", learned(), learned(0.2, seed=1))
    pack([run], tmp_path / "out" / "a" / "b")  # a is no packed folder: b begins a tree of its own
    assert len(stored_scenes(tmp_path / "out" / "a" / "b")) == 2
    pack([run], tmp_path / "out" / "c")
    agree(run, tmp_path / "out" / "c")
    first, second = stored_rows(tmp_path / "out" / "c").values()
    assert first == {"name": first["name"], "in": ".."}
    assert second == {"name": second["name"], "in": "../a/b"}
    assert not (tmp_path / "out" / "c" / SCENES_FILE).exists()


def test_a_table_that_another_folder_of_the_tree_has_is_a_reference(tmp_path: Path):
    pack([run_folder(tmp_path / "run", learned())], tmp_path / "out")
    row, scores = learned()
    again = dataclasses.replace(row, measured=Measured(0.5, 0.5, 0.5))
    run = run_folder(tmp_path / "again", (again, scores))
    pack([run], tmp_path / "out" / "again")
    agree(run, tmp_path / "out" / "again")
    (line,) = stored_rows(tmp_path / "out" / "again").values()
    assert (line["scenes"], line["curve"]) == (f"../{row.key.name}", f"../{row.key.name}")
    shutil.rmtree(tmp_path / "out" / "again")
    pack([run], tmp_path / "elsewhere")
    agree(run, tmp_path / "elsewhere")


def test_the_same_rows_give_the_same_bytes(tmp_path: Path):
    one, two = run_folder(tmp_path / "a", learned()), run_folder(tmp_path / "b", learned(0.2, seed=1))
    assert pack([one, two], tmp_path / "out") == 2
    pack([two, one], tmp_path / "turned")
    assert contents(tmp_path / "out") == contents(tmp_path / "turned")
    before = contents(tmp_path / "out")
    assert pack([two], tmp_path / "out") == 0
    assert contents(tmp_path / "out") == before


def test_packed_rows_can_be_packed(tmp_path: Path):
    run = run_folder(tmp_path / "run", learned(), (run_row("other"), table(0.2)))
    pack([run], tmp_path / "out")
    assert pack([tmp_path / "out"], tmp_path / "copy") == 2
    assert contents(tmp_path / "out") == contents(tmp_path / "copy")
    assert pack([tmp_path / "out"], tmp_path / "out") == 0


def test_packing_a_folder_into_itself_writes_its_tables_anew(tmp_path: Path):
    pack([run_folder(tmp_path / "run", learned())], tmp_path / "out")
    before = contents(tmp_path / "out")
    (tmp_path / "out" / "leaderboard.csv").write_text("columns of an older version\n")
    assert pack([tmp_path / "out"], tmp_path / "out") == 0
    assert contents(tmp_path / "out") == before


def test_adding_rows_moves_nothing_that_others_refer_to(tmp_path: Path):
    """The new row comes first, and shares the table of the one that is there."""
    late = run_folder(tmp_path / "late", learned(model="net"))
    pack([late], tmp_path / "out")
    pack([late], tmp_path / "out" / "copy")
    early = run_folder(tmp_path / "early", learned(model="a-net"))
    assert pack([early], tmp_path / "out") == 1
    agree(late, tmp_path / "out" / "copy")
    assert {row.key.model for row in load_runs(tmp_path / "out")} == {"net", "a-net"}
    assert len(stored_scenes(tmp_path / "out")) == 1


@pytest.mark.parametrize("change", [{"commit": "def"}, {"version": 2}, {"learning_curve": None}])
def test_another_result_in_the_place_of_one_is_refused(tmp_path: Path, change: dict[str, object]):
    row, scores = learned()
    pack([run_folder(tmp_path / "run", (row, scores))], tmp_path / "out")
    before = contents(tmp_path / "out")
    key = dataclasses.replace(row.key, version=change.pop("version", 1))
    other = dataclasses.replace(row, key=key, **change)
    run = run_folder(tmp_path / "other", (other, scores), (run_row("new"), table()))
    with pytest.raises(UsageError, match="another result in the place of moving--net--0"):
        pack([run], tmp_path / "out")
    assert contents(tmp_path / "out") == before


def test_other_scores_of_the_same_row_are_refused(tmp_path: Path):
    pack([run_folder(tmp_path / "run", learned(0.25))], tmp_path / "out")
    with pytest.raises(UsageError, match="another result"):
        pack([run_folder(tmp_path / "other", learned(0.26))], tmp_path / "out")


@pytest.mark.parametrize("name", ["runs", "leaderboard.csv", "leaderboard.md", "manifest.json"])
def test_a_folder_with_other_files_is_refused(tmp_path: Path, name: str):
    run = run_folder(tmp_path / "run", learned())
    (tmp_path / "out" / name).mkdir(parents=True)
    with pytest.raises(UsageError, match=f"holds {name}"):
        pack([run], tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == [name]


@pytest.mark.parametrize("present", [False, True])
def test_an_interrupt_leaves_nothing_or_the_old_content(tmp_path: Path, present: bool, monkeypatch: pytest.MonkeyPatch):
    def interrupt(_folder: Path) -> None:
        raise KeyboardInterrupt

    if present:
        pack([run_folder(tmp_path / "run", learned())], tmp_path / "out")
    more = run_folder(tmp_path / "more", learned(0.2, seed=1))
    before = contents(tmp_path)
    monkeypatch.setattr(packing, "load_standings", interrupt)
    with pytest.raises(KeyboardInterrupt):
        pack([more], tmp_path / "out")
    assert contents(tmp_path) == before
    assert (tmp_path / "out").exists() == present


def test_what_a_killed_process_left_is_not_referred_to(tmp_path: Path):
    pack([run_folder(tmp_path / "run", learned())], tmp_path / "out")
    run = run_folder(tmp_path / "more", learned(0.2, seed=1))
    pack([run], tmp_path / "out" / temporary_path(Path("killed")))
    pack([run], tmp_path / "out" / "new")
    shutil.rmtree(tmp_path / "out" / temporary_path(Path("killed")))
    agree(run, tmp_path / "out" / "new")


def test_damage_is_found_before_anything_is_written(tmp_path: Path):
    run = run_folder(tmp_path / "run", learned())
    (run / "scenes" / f"{learned()[0].key.name}.csv").write_text("scene\n0\n")
    with pytest.raises(CorruptFile, match="scenes"):
        pack([run], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_rows_in_both_forms_are_refused(tmp_path: Path):
    run = run_folder(tmp_path / "run", learned())
    pack([run], tmp_path / "out")
    shutil.copytree(run / "runs", tmp_path / "out" / "runs")
    with pytest.raises(UsageError, match="packed results, and rows of its own"):
        load_runs(tmp_path / "out")
