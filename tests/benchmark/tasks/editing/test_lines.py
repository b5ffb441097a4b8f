import math
from pathlib import Path

import pytest

from benchmark.tasks.editing.answers import METRICS, Answer, Match
from benchmark.tasks.editing.lines import COLUMNS, line_of, line_without_edit, load_all, load_lines, path_of, save_lines
from datagen.errors import CorruptFile
from tests.benchmark.tasks.editing import oracle


def some_lines(edits: Path):
    pair = oracle.truth_of(edits).pairs[0]
    scores = dict.fromkeys(METRICS, 0.5) | {"psnr_shadow": math.nan}
    answers = [Answer("edit", scores, Match(None, 0.25)), Answer("edit", scores, Match(3, 0.75)), Answer("x", scores)]
    return [line_of("moving", "model", scene, pair, answer) for scene, answer in enumerate(answers)]


def test_lines_survive_their_file(edits: Path, tmp_path: Path):
    lines = some_lines(edits)
    save_lines(path_of(tmp_path, "one"), lines)
    read = load_all(tmp_path)
    assert [line["found"] for line in read] == ["no", "yes", ""]
    for line, again in zip(lines, read, strict=True):
        assert tuple(line) == tuple(again) == COLUMNS
        assert math.isnan(again["psnr_shadow"])
        assert (again["scene"], again["ari"]) == (line["scene"], 0.5)


def test_a_job_that_has_not_begun_has_no_lines(tmp_path: Path):
    assert load_lines(path_of(tmp_path, "none")) == []


@pytest.mark.parametrize("text", ["\x00\n", "scene,track\n1,2\n", "a,b\n1\n"])
def test_a_damaged_file_is_one_clear_message(tmp_path: Path, text: str):
    path = tmp_path / "one.csv"
    path.write_text(text)
    with pytest.raises(CorruptFile, match="delete it and run the same command again"):
        load_lines(path)


def test_scenes_without_an_edit_leave_a_file_that_can_be_read(tmp_path: Path):
    save_lines(tmp_path / "a.csv", [])
    assert load_lines(tmp_path / "a.csv") == []


@pytest.mark.parametrize("cut", [1, 3, 40])
def test_a_file_whose_last_line_is_cut_short_is_damaged(edits: Path, tmp_path: Path, cut: int):
    path = tmp_path / "one.csv"
    save_lines(path, some_lines(edits))
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(CorruptFile, match="delete it and run the same command again"):
        load_lines(path)


def test_lines_of_too_few_or_too_many_columns_are_damage(tmp_path: Path):
    path = tmp_path / "one.csv"
    for row in ("moving,model,0,remove", ",".join("0" * (len(COLUMNS) + 1))):
        path.write_text(",".join(COLUMNS) + f"\n{row}\n")
        with pytest.raises(CorruptFile, match=r"line 2 has \d+ cells; expected 15\); delete it"):
            load_lines(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [("remove", "destroy"), (",no,", ",perhaps,"), ("0.500000", "inf"), ("0.500000", "x"), ("model,0,", "model,-1,")],
)
def test_values_that_no_job_writes_are_damage(edits: Path, tmp_path: Path, old: str, new: str):
    path = tmp_path / "one.csv"
    save_lines(path, some_lines(edits))
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(CorruptFile, match=r"one\.csv is damaged"):
        load_lines(path)


def test_a_scene_without_an_edit_has_a_line_that_tables_leave_out(tmp_path: Path):
    save_lines(path_of(tmp_path, "one"), [line_without_edit("moving", "model", 7)])
    assert [line["scene"] for line in load_lines(path_of(tmp_path, "one"))] == [7]
    assert load_all(tmp_path) == []
