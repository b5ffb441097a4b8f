import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest

from benchmark.metrics import CLIP_METRICS, METRICS
from benchmark.metrics.poses import POSE_METRICS
from benchmark.ranking import leaderboard
from benchmark.ranking.leaderboard import latex, markdown
from benchmark.ranking.standings import ModelResult, standings
from benchmark.results.run_folder import RunRow, SceneTable
from tests.chosen_scores import HOSTILE, failed_row, run_row, save_run, scene_table

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
    costs = [row[f"measured_{name}"] for name in ("seconds_per_frame", "fit_seconds", "peak_mib")]
    assert costs == ["0.015000", "5.000000", "101.000000"], "the failed seed has none"
    floors = [float(seed["msc_fg"]) for seed in read(folder / "per_seed.csv") if seed["model"] == "floor"]
    assert float(row["best_floor"]) == pytest.approx(np.mean(floors), abs=1e-6)


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


def test_only_measured_columns_depend_on_the_clock(folder: Path):
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


MODELS = {
    "one-cluster": ("floor", 0.1),
    "kmeans": ("classical", 0.4),
    "plane": ("classical", 0.9),
    "obpose": ("learned", 0.8),
    "truth": ("oracle", 0.99),
}


def results(track: str = "moving") -> list[ModelResult]:
    rng = np.random.default_rng(0)
    rows, tables = [failed_row("obpose", track, seed=1)], [None]
    for name, (kind, score) in MODELS.items():
        values = score + 0.02 * rng.standard_normal(30)
        rows.append(run_row(name, track, n_scenes=30, kind=kind, uses_labels=kind == "oracle"))
        tables.append(scene_table({"ari_fg": values, "msc_fg": values, "ari": values}))
    return standings(rows, tables)


def test_markdown_is_the_description_of_the_columns():
    lines = [line for line in markdown(results()).splitlines() if line.startswith("|")]
    assert lines[0] == "| model | rank | seeds | ARI-FG | MSC-FG | mIoU-BG | ARI | mIoU-BG† | MSC-FG† |"
    assert lines[1] == "| --- |" + " ---: |" * 8
    assert lines[2] == "| **Learned models** |" + "  |" * 8
    cells = "0.80 <sup>b</sup> | 0.80 <sup>b</sup> | **0.90** | 0.80 | 0.90 | 0.90 |"
    assert lines[3] == f"| obpose | 2 | 1 of 2 | {cells}"
    assert lines[4].startswith("| – without the 1 failed of 2 seeds (out of memory) |  | 1 of 2 | 0.80 | 0.80 |")
    assert lines[6].startswith(
        "| plane | 1 | 1 | **0.90** <sup>a</sup> | **0.90** <sup>a</sup> | **0.90** | **0.90** |"
    )
    assert lines[-7] == "| **In the paper, on YCB Moving-Object: other data, not comparable** |" + "  |" * 8
    assert lines[-1] == r"| *ObPose loc. \& rot.* |  |  | *0.96±0.00* | *0.97±0.00* | *1.00±0.00* |  |  |  |"
    assert {line.count("|") for line in lines} == {10}
    assert "paper" not in markdown(results("textured")).partition("## ")[2]


@pytest.mark.parametrize("track", ["moving", "textured"])
def test_latex_is_well_formed(track: str):
    body = latex_body(latex(results(track)))
    assert nested_environments(body) == ["table*", "adjustbox", "tabular"]
    assert len(set(widths(body))) == 1
    assert (r"\textcolor{gray}" in body) is (track == "moving")
    assert r"mIoU-BG$\dagger$$\uparrow$ & MSC-FG$\dagger$$\uparrow$" in body
    assert r"\textsc{plane} & 1 & 1 & $\mathbf{0.90}^{a}$" in body


def test_names_cannot_break_latex():
    name = "50%_of_a&b#c${d}~e^f\\g"
    rows = [run_row(name, name, kind=kind, fit_track="x_%") for kind in ("floor", "learned", "predictions")]
    body = latex_body(latex(standings(rows, [scene_table({"ari_fg": np.ones(3)})] * len(rows))))
    assert nested_environments(body) == ["table*", "adjustbox", "tabular"]
    assert len(set(widths(body))) == 1
    assert r"50\%\_of\_a\&b\#c\$\{d\}\~{}e\^{}f\textbackslash{}g" in body
    assert r"models fitted on x\_\%" in body


def latex_body(text: str) -> str:
    """Without the lines of notes."""
    return "\n".join(line for line in text.splitlines() if not line.startswith("%"))


def nested_environments(body: str) -> list[str]:
    """Names of the environments, after a check that they, braces and dollars match, and nothing is left unescaped."""
    assert body.isascii()
    bare = re.sub(r"\\[\\%_&#${}~^]", "", body)
    assert bare.count("{") == bare.count("}")
    assert all(line.count("$") % 2 == 0 for line in bare.splitlines())
    assert not re.search(r"[%#~]", bare)
    assert not re.search(r"[_^]", re.sub(r"\$[^$]*\$", "", bare))
    names, still_open = [], []
    for command, name in re.findall(r"\\(begin|end)\{([^}]*)\}", body):
        if command == "begin":
            names.append(name)
            still_open.append(name)
        else:
            assert still_open.pop() == name
    assert still_open == []
    return names


def widths(body: str) -> list[int]:
    """Columns of the table as declared, and of each of its rows."""
    declared = re.search(r"\\begin\{tabular\}\{([lrc ]+)\}", body)
    assert declared
    found = [len(declared[1].split())]
    for row in (line for line in body.splitlines() if line.endswith(r"\\")):
        spans = [int(span) for span in re.findall(r"\\multicolumn\{(\d+)\}", row)]
        found.append(len(re.findall(r"(?<!\\)&", row)) + 1 + sum(spans) - len(spans))
    return found


def hostile_results() -> list[ModelResult]:
    scores = scene_table({"ari_fg": np.full(3, 0.5), "msc_fg": np.full(3, 0.5)})
    facts = {"track_spec": HOSTILE[:8] * 9, **dict.fromkeys(("views", "pretrained", "device", "commit"), HOSTILE)}
    rows = [
        run_row(HOSTILE, HOSTILE, kind="classical", priors=(HOSTILE,), **facts),
        failed_row("net", HOSTILE, reason=HOSTILE, track_spec=facts["track_spec"]),
        *(run_row("once", HOSTILE, seed, random=False, **facts) for seed in range(2)),
    ]
    return standings(rows, [scores, None, scores, scores])


def test_hostile_names_break_no_table():
    page = markdown(hostile_results())
    rows = [line for line in page.splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in rows}) == 1
    assert not re.search(r"(?<!\\)<(?!/?sup>)", page)
    assert not re.search(r"(?<!\\)\[", page)
    assert len([line for line in page.splitlines() if line.startswith("#")]) == 2
    text = latex(hostile_results())
    assert "alert(1)" in text
    assert not re.search(r"\\\\\s*\n\s*\[", text)
    assert all("alert" not in line or line.startswith(("%", "    ")) for line in text.splitlines())
    assert page.encode() + text.encode()
    assert "\u202e" not in page + text


def test_cells_of_csv_files_are_no_formulas(tmp_path: Path):
    row = run_row(priors=("=1+1", "@x"), device="=cmd()")
    save_run(tmp_path, row, scene_table({"ari_fg": [0.5] * 3}))
    save_run(tmp_path, failed_row("net", reason="=HYPERLINK(1)"))
    leaderboard.write(tmp_path)
    lines = read(tmp_path / "leaderboard.csv")
    assert {line["device"] for line in lines} == {"'=cmd()", "cpu"}
    assert all(not cell.startswith(("=", "+", "@")) for line in lines for cell in line.values())


def posed(translation: float = 0.012) -> SceneTable:
    """Three scenes with poses."""
    chosen = {"translation_error": translation, "translation_median": translation / 2, "orientation_error": 7.25}
    extra = {name: np.full(3, chosen.get(name, 0.5)) for name in POSE_METRICS}
    return scene_table({"ari_fg": [0.9] * 3}) | extra | {f"{name}_n": np.full(3, 2.0) for name in extra}


PLAIN = scene_table({"ari_fg": [0.9] * 3})


def test_models_with_poses_have_a_table_of_them():
    found = standings([run_row("with"), run_row("without")], [posed(), PLAIN])
    table = markdown(found).partition("### Poses")[2]
    assert "| with | 1 | 0.50 | 6.0 | 12.0 |" in table
    assert "without" not in table
    assert "not observable" in markdown(found)
    assert r"\caption{Poses of moving" in latex(found)
    assert r"($^\circ$)" in latex(found)
    assert "Poses" not in markdown(standings([run_row(), failed_row(seed=1)], [PLAIN, None]))


def test_columns_of_poses_are_the_last_ones_and_empty_where_there_are_none(tmp_path: Path):
    save_run(tmp_path, run_row("a"), PLAIN)
    leaderboard.write(tmp_path)
    before = (tmp_path / "leaderboard.csv").read_text().splitlines()[0]
    assert "translation" not in before
    save_run(tmp_path, run_row("b"), posed())
    leaderboard.write(tmp_path)
    assert (tmp_path / "leaderboard.csv").read_text().startswith(f"{before},posed_mean,")
    one, other = read(tmp_path / "leaderboard.csv")
    assert (one["translation_error_mean"], other["translation_error_mean"]) == ("", "0.012000")
    assert [seed["box_iou"] for seed in read(tmp_path / "per_seed.csv")] == ["", "0.500000"]


def test_seeds_without_poses_leave_a_model_without():
    """Rows that were made before their model gave poses stay as they are."""
    (result,) = standings([run_row("m"), run_row("m", seed=1)], [posed(), PLAIN])
    assert not result.has_poses
    assert np.isnan(result.summary("translation_error").mean)
    assert "Poses" not in markdown([result])
