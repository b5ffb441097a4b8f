import csv
import io
import math
import re
from pathlib import Path

import pytest
from rich.console import Console

from benchmark.tasks.editing import summary
from benchmark.tasks.editing.answers import METRICS
from benchmark.tasks.editing.lines import path_of, save_lines


def line(scene: int, value: float, *, edit: str = "remove", answer: str = "edit", found: str = "yes"):
    places = {"track": "moving", "model": "model", "scene": scene, "edit": edit, "answer": answer}
    return {**places, "object": 1, "iou": 1.0, "found": found, **dict.fromkeys(METRICS, value)}


def test_means_leave_out_what_is_undefined_and_count_what_was_not_found():
    lines = [line(0, 10.0), line(1, 20.0, found="no"), line(2, math.nan)]
    (entry,) = summary.summaries(lines)
    assert (entry.scenes, entry.not_found) == (3, 1)
    found = entry.metrics["psnr_inside"]
    assert found.mean == 15
    assert (found.low, found.high) == (10, 20)


def test_answers_that_need_not_find_anything_have_no_count():
    (entry,) = summary.summaries([line(0, 1.0, answer="no-edit", found="")])
    assert entry.not_found is None


def test_tables_are_in_the_order_of_the_edits(tmp_path: Path):
    save_lines(path_of(tmp_path, "one"), [line(0, 0.5, edit=kind) for kind in ("add", "remove", "move")])
    entries = summary.write(tmp_path)
    assert [entry.edit for entry in entries] == ["remove", "move", "add"]
    with (tmp_path / "editing.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["edit"] for row in rows] == ["remove", "move", "add"]
    assert float(rows[0]["ari_fg_mean"]) == pytest.approx(0.5)
    text = (tmp_path / "editing.md").read_text()
    assert text.count("| model, edit | 0.5 (0.5 to 0.5) |") == 3
    assert "## moving: remove, 1 scene" in text


def test_every_metric_has_a_heading():
    assert tuple(summary.SHOWN) == METRICS


def test_rows_of_different_numbers_of_scenes_say_how_many():
    few, more = [line(0, 0.5)], [line(scene, 0.5, answer="no-edit", found="") for scene in range(3)]
    text = summary.markdown(summary.summaries([*few, *more]))
    assert "## moving: remove\n" in text
    assert "|  | scenes | PSNR inside" in text
    assert "| model, edit | 1 | 0.5" in text
    assert "| no-edit | 3 | 0.5" in text


def test_suffixes_of_names_are_explained():
    page = summary.markdown(summary.summaries([line(0, 1.0) | {"model": "obpose-pretrained-refined"}]))
    assert "\n-pretrained in a name: " in page
    assert "\n-refined in a name: scenes were fitted to their frames before the edit." in page


def test_the_terminal_shows_numbers_of_scenes_and_names_in_brackets():
    named = [line(scene, 0.5) | {"model": "c[e]", "track": "[red]data"} for scene in range(37)]
    console = Console(width=200, file=io.StringIO())
    console.print(summary.screen_table(summary.summaries(named)))
    shown = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert re.search(r"\[red\]data +remove +c\[e\], edit +37 ", shown)
