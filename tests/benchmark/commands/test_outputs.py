"""Terminal output after a run."""

import dataclasses
import io
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from rich.console import Console

from benchmark.commands.outputs import FILE_WIDTH, means_table, write
from benchmark.ranking.standings import standings
from benchmark.results.run_folder import RunRow, SceneTable, load_runs, save_row
from datagen.errors import CorruptFile
from tests.chosen_scores import failed_row, run_row, scene_table
from tests.worlds.runs import MODELS, write_runs

Run = tuple[RunRow, SceneTable | None]


def scored(model: str, score: float, *, track: str = "moving", seed: int = 0, **changes: object) -> Run:
    return run_row(model, track, seed, **changes), scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3})


def printed(runs: Sequence[Run]) -> list[str]:
    console = Console(width=FILE_WIDTH, file=io.StringIO())
    console.print(means_table(standings([row for row, _ in runs], [table for _, table in runs])))
    assert isinstance(console.file, io.StringIO)
    return [line.strip() for line in console.file.getvalue().splitlines() if line.strip()]


def test_models_stand_in_the_order_of_their_ranks_track_by_track():
    scores = {"bad": 0.2, "best": 0.9, "good": 0.7}
    runs = [scored(model, score, track=track) for track in ("moving", "static") for model, score in scores.items()]
    runs += [scored("a-floor", 0.1, kind="floor"), scored("an-oracle", 1.0, kind="oracle", uses_labels=True)]
    places = [tuple(line.split()[:2]) for line in printed(runs)[1:]]
    assert places[:5] == [("moving", name) for name in ("best", "good", "bad", "an-oracle", "a-floor")]
    assert places[5:8] == [("static", name) for name in ("best", "good", "bad")]


def test_marks_are_explained_beneath_where_they_occur():
    marked = [scored("a", 0.9, uses_labels=True), scored("b", 0.8, tuned=True), scored("c", 0.7, pretrained="c.pt")]
    marked += [scored("a-floor", 0.1, kind="floor")]
    assert [line[0] for line in printed(marked)[-3:]] == ["†", "‡", "§"]
    text = "\n".join(printed([scored("b", 0.8, tuned=True)]))
    assert text.count("‡") == 2
    assert "†" not in text
    assert "§" not in text


def test_suffixes_of_names_are_explained_beneath_where_they_occur():
    assert any(line.startswith("-density in a name:") for line in printed([scored("a", 0.9), scored("a-density", 0.8)]))
    assert not any(" in a name:" in line for line in printed([scored("a", 0.9)]))


def test_the_report_keeps_the_commands_that_made_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write_runs(tmp_path, scenes=1, seeds=1, models={"merger": MODELS["merger"]})

    def page(command: str, *, made_rows: bool) -> str:
        monkeypatch.setattr(sys, "argv", ["/bin/obpose-bench", *command.split()])
        write(tmp_path / "run", [], made_rows=made_rows)
        return (tmp_path / "run/report.html").read_text(encoding="utf-8")

    assert ">obpose-bench --model a<" in page("--model a", made_rows=True)
    assert ">obpose-bench --model a<" in page("report run", made_rows=False)
    assert ">obpose-bench --model a; obpose-bench --model b<" in page("--model b", made_rows=True)
    assert ">obpose-bench --model a; obpose-bench --model b<" in page("--model a", made_rows=True)
    manifest = tmp_path / "run/manifest.json"
    for damage in ("{", '{"commands": [1]}', '["commands"]'):
        manifest.write_text(damage)
        with pytest.raises(CorruptFile, match="Delete it: it is written again"):
            write(tmp_path / "run", [])
    manifest.write_text('{"commands": ["one\\n\\ud800"]}')  # no text that can be stored
    assert ">one ?<" in page("report run", made_rows=False)
    manifest.unlink()
    assert "obpose-bench --model" not in page("report run", made_rows=False)


def test_seeds_are_those_that_were_run():
    """If seeds make no difference, one run stands for all of them, and its failure too."""
    runs = [scored("chance", 0.5, seed=seed) for seed in range(3)]
    runs += [scored("fixed", 0.4, seed=seed, random=False) for seed in range(3)]
    runs += [(failed_row("broken", seed=seed, random=False), None) for seed in range(3)]
    runs += [scored("shaky", 0.3), (failed_row("shaky", seed=1), None)]
    swapped = scene_table({"msc_fg": [0.7] * 3, "miou_bg": [0.1] * 3})
    runs += [scored("swapped", 0.7), (run_row("swapped", seed=1), swapped)]
    lines = printed(runs)
    found = {line.split()[1]: line.partition("0.")[0].partition("–")[0].split()[2:] for line in lines[1:6]}
    assert found == {
        "swapped": ["1", "2,", "1", "failed"],
        "chance": ["2", "3"],
        "fixed": ["3", "1"],
        "shaky": ["4", "1", "of", "2"],
        "broken": ["0", "of", "1"],
    }
    assert any("do not depend on the seed: broken, fixed." in line for line in lines)
    assert any("A seed failed if" in line for line in lines)


def test_shared_ranks_and_failed_seeds_are_explained_only_where_they_occur():
    tied = "".join(printed([scored("a", 0.5), scored("b", 0.5)]))
    assert "A rank of 2.5" in tied
    assert "A seed failed if" not in tied
    assert "A rank of 2.5" not in "".join(printed([scored("a", 0.5), scored("b", 0.4)]))


def test_weights_that_were_given_were_trained_and_not_fitted():
    lines = printed([scored("a", 0.5, fit_track="mixed"), scored("b", 0.4, fit_track="mixed", pretrained="weights")])
    assert any("moving (fitted on mixed)" in line and " a " in line for line in lines)
    assert any("moving (trained on mixed)" in line and " b " in line for line in lines)


def test_scores_that_are_not_there_are_dashes():
    (line,) = (line for line in printed([(failed_row("m"), None), scored("n", 0.5)]) if " m " in line)
    assert line.split()[-4:] == ["–"] * 4


def test_a_collapse_that_cannot_be_seen_is_said():
    assert any("No floor was scored on moving" in line for line in printed([scored("m", 0.5)]))
    both = [scored("m", 0.5), scored("floor", 0.1, kind="floor")]
    assert not any("No floor" in line for line in printed(both))


def test_no_figure_is_minus_zero():
    lines = printed([scored("m", -1e-5)])
    assert "0.000" in lines[1]
    assert "-0.000" not in lines[1]
    assert "-0.001" in printed([scored("m", -0.001)])[1]


def test_the_report_finds_the_datasets_of_rows_by_the_label_maps_that_are_there(tmp_path: Path):
    write_runs(tmp_path, scenes=2, seeds=1, crash="switching-oracle")
    assert load_runs(tmp_path / "run")[-1].status == "failed"
    write(tmp_path / "run", [])
    assert "The dataset is not on this machine." not in (tmp_path / "run/report.html").read_text(encoding="utf-8")


def test_each_of_two_datasets_of_one_name_is_found(tmp_path: Path):
    data = write_runs(tmp_path, scenes=2, seeds=1, models={"merger": MODELS["merger"]})
    for row in load_runs(tmp_path / "run"):
        (tmp_path / f"run/scenes/{row.key.name}.csv").rename(tmp_path / f"run/scenes/{_renamed(row).key.name}.csv")
        (tmp_path / f"run/labels/{row.key.name}.h5").rename(tmp_path / f"run/labels/{_renamed(row).key.name}.h5")
        (tmp_path / f"run/runs/{row.key.name}.json").unlink()
        save_row(tmp_path / "run", _renamed(row))
    write(tmp_path / "run", list(data.values()))
    page = (tmp_path / "run/report.html").read_text(encoding="utf-8")
    assert "There are no slices, errors or pictures" not in page


def _renamed(row: RunRow) -> RunRow:
    """Results on a track with the name of all others."""
    return dataclasses.replace(row, key=dataclasses.replace(row.key, track="mine", fit_track="mine"))
