import csv
import io
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmark.commands.outputs import poses_table
from benchmark.metrics.poses import POSE_METRICS
from benchmark.ranking import leaderboard
from benchmark.ranking.standings import standings
from benchmark.ranking.tables import latex, markdown
from benchmark.results.run_folder import SceneTable
from tests.chosen_scores import failed_row, run_row, save_run, scene_table
from tests.worlds.runs import write_report


def posed(translation: float = 0.012) -> SceneTable:
    """Three scenes with poses."""
    chosen = {"translation_error": translation, "translation_median": translation / 2, "orientation_error": 7.25}
    extra = {name: np.full(3, chosen.get(name, 0.5)) for name in POSE_METRICS}
    return scene_table({"ari_fg": [0.9] * 3}) | extra | {f"{name}_n": np.full(3, 2.0) for name in extra}


def plain() -> SceneTable:
    return scene_table({"ari_fg": [0.9] * 3})


def test_only_models_with_poses_stand_in_the_table():
    entries = standings([run_row("with"), run_row("without")], [posed(), plain()])
    page = markdown(entries)
    table = page.partition("### Poses")[2]
    assert "| with | 1 | 0.50 | 6.0 | 12.0 |" in table
    assert "| 7.2 |" in table
    assert "without" not in table
    assert "which no image tells" in page
    assert r"\caption{Poses of moving" in latex(entries)
    assert r"($^\circ$)" in latex(entries)


def test_without_any_poses_nothing_changes():
    entries = standings([run_row("one"), failed_row("one", seed=1)], [plain(), None])
    assert "Poses" not in markdown(entries)
    assert "Poses" not in latex(entries)


def test_columns_are_the_last_ones_and_empty_where_there_are_none(tmp_path: Path):
    save_run(tmp_path, run_row("a"), plain())
    leaderboard.write(tmp_path)
    before = (tmp_path / "leaderboard.csv").read_text().splitlines()[0]
    assert "translation" not in before
    save_run(tmp_path, run_row("b"), posed())
    leaderboard.write(tmp_path)
    text = (tmp_path / "leaderboard.csv").read_text()
    assert text.startswith(f"{before},posed_mean,")
    one, other = csv.DictReader(io.StringIO(text))
    assert (one["translation_error_mean"], other["translation_error_mean"]) == ("", "0.012000")
    seeds = list(csv.DictReader(io.StringIO((tmp_path / "per_seed.csv").read_text())))
    assert [seed["box_iou"] for seed in seeds] == ["", "0.500000"]


def test_seeds_without_poses_leave_a_model_without():
    """Rows that were made before their model gave poses stay as they are."""
    (entry,) = standings([run_row("m"), run_row("m", seed=1)], [posed(), plain()])
    assert not entry.has_poses
    assert np.isnan(entry.summary("translation_error").mean)
    assert "Poses" not in markdown([entry])


def test_the_page_shows_them(tmp_path: Path):
    save_run(tmp_path, run_row("without"), plain())
    write_report(tmp_path, {})
    assert "<summary>Poses" not in (tmp_path / "report.html").read_text()
    save_run(tmp_path, run_row("with"), posed())
    write_report(tmp_path, {})
    table = (tmp_path / "report.html").read_text().partition("<summary>Poses")[2].partition("</details>")[0]
    assert table.count("<tr") == 2
    assert '<td class="n">12.0</td>' in table
    assert "translation, median (mm)" in table
    assert "Found is the share" in table


def test_the_screen_shows_them():
    assert poses_table(standings([run_row("without")], [plain()])) is None
    rows = [run_row("with"), run_row("with", seed=1), run_row("without"), run_row("x", "static")]
    entries = standings(rows, [posed(), posed(0.008), plain(), posed(0.02)])
    console = Console(width=160, file=io.StringIO())
    console.print(poses_table(entries))
    assert isinstance(console.file, io.StringIO)
    lines = [line.split() for line in console.file.getvalue().splitlines() if "0.5" in line]
    assert lines == [
        ["moving", "with", "0.50±0.00", "5.0±1.0", "0.5±0.0", "0.50±0.00"],
        ["static", "x", "0.50", "10.0", "0.5", "0.50"],
    ]
