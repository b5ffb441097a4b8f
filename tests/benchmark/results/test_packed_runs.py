import json
import lzma
import math
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.results.packed_runs import (
    CURVES_FILE,
    ROWS_FILE,
    SCENES_FILE,
    is_packed,
    packed_rows,
    packed_scenes,
    refuse_packed,
    stored_curves,
    stored_rows,
    stored_scenes,
    unpacked,
    write_curves,
    write_rows,
    write_scenes,
)
from datagen.errors import CorruptFile, UsageError

NAME = "moving--model--0--12345678"
TABLE = {"scene": np.arange(2.0), "ari": np.array([0.25, 0.75]), "ari_n": np.array([3.0, 2.0])}


def write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(lzma.compress(text.encode()))


def write_lines(folder: Path, *rows: dict[str, Any]) -> None:
    write_text(folder / ROWS_FILE, "".join(json.dumps(row) + "\n" for row in rows))


def test_a_folder_is_packed_if_it_has_packed_rows(tmp_path: Path):
    refuse_packed(tmp_path)
    assert not is_packed(tmp_path / "nowhere")
    write_rows(tmp_path, [{"name": NAME}])
    assert is_packed(tmp_path)
    with pytest.raises(UsageError, match=r"read-only.*obpose-bench pack"):
        refuse_packed(tmp_path)


def test_scores_are_read_as_they_were_written(tmp_path: Path):
    write_scenes(tmp_path, {NAME: TABLE})
    found = stored_scenes(tmp_path)[NAME]
    assert list(found) == list(TABLE)
    assert all(np.array_equal(found[name], TABLE[name]) for name in TABLE)


def test_a_score_that_no_scene_defines_is_told_from_a_column_that_is_not_there(tmp_path: Path):
    still = {"ari": np.array([0.5]), "ari_video": np.array([np.nan]), "ari_video_n": np.zeros(1)}
    posed = {"ari": np.array([0.5]), "box_iou": np.array([0.5]), "box_iou_n": np.ones(1)}
    write_scenes(tmp_path, {"a": still, "b": posed})
    found = stored_scenes(tmp_path)
    assert set(found["a"]) == set(still)
    assert np.isnan(found["a"]["ari_video"]).all()
    assert set(found["b"]) == set(posed)


def test_curves_are_read_exactly_as_they_were_written(tmp_path: Path):
    curves = {
        "a": [{"step": 1.0, "loss": 1 / 3}, {"step": 2.0, 'of, "b"': 1e-9}],
        "with, comma": [{"step": 3.0, "loss": math.inf}],
    }
    write_curves(tmp_path, curves)
    assert stored_curves(tmp_path) == curves


def test_a_loss_that_is_nan_is_not_a_loss_that_is_missing(tmp_path: Path):
    write_curves(tmp_path, {NAME: [{"step": 1.0, "loss": math.nan}, {"step": 2.0}]})
    first, second = stored_curves(tmp_path)[NAME]
    assert math.isnan(first["loss"])
    assert second == {"step": 2.0}


def test_no_tables_no_file(tmp_path: Path):
    write_scenes(tmp_path, {})
    write_curves(tmp_path, {})
    assert list(tmp_path.iterdir()) == []
    assert stored_scenes(tmp_path) == stored_curves(tmp_path) == {}


def test_a_file_with_the_same_text_is_left_alone(tmp_path: Path):
    """Another version of the compressor may give other bytes."""
    write_lines(tmp_path, {"name": NAME})
    before = (tmp_path / ROWS_FILE).read_bytes()
    write_rows(tmp_path, [{"name": NAME}])
    assert (tmp_path / ROWS_FILE).read_bytes() == before
    write_rows(tmp_path, [{"name": NAME, "in": ".."}])
    assert stored_rows(tmp_path)[NAME] == {"name": NAME, "in": ".."}


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-5],
        lambda data: data + b"x",
        lambda data: data + data,
        lambda data: data[:20] + bytes([data[20] ^ 1]) + data[21:],
        lambda data: b"",
        lambda data: b"plain text",
        lambda data: lzma.compress(b"\xff\xfe"),
        lambda data: lzma.compress(b"text", lzma.FORMAT_ALONE),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, damage: Any):
    path = tmp_path / "text.xz"
    path.write_bytes(damage(lzma.compress(b"text" * 100)))
    with pytest.raises(CorruptFile, match=r"text\.xz is damaged"):
        unpacked(path)


def test_a_decompression_bomb_is_refused_before_it_is_unpacked(tmp_path: Path):
    path = tmp_path / "text.xz"
    compressor = lzma.LZMACompressor(preset=0)
    zeros = bytes(2**20)
    path.write_bytes(b"".join(compressor.compress(zeros) for _ in range(70)) + compressor.flush())
    tracemalloc.start()
    try:
        with pytest.raises(CorruptFile, match="more than"):
            unpacked(path, 1000)
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()
    with pytest.raises(CorruptFile, match="more than"):
        unpacked(path)


def test_a_file_may_not_ask_for_much_memory(tmp_path: Path):
    path = tmp_path / "text.xz"
    wide = [{"id": lzma.FILTER_LZMA2, "preset": 0, "dict_size": 2**28}]
    compressor = lzma.LZMACompressor(filters=wide)
    path.write_bytes(compressor.compress(b"text") + compressor.flush())
    with pytest.raises(CorruptFile, match=r"[Mm]emory"):
        unpacked(path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "line 1"),
        ("[1]", "line 1 has no name"),
        ('{"key": 1}', "line 1 has no name"),
        ('{"name": 1}', "line 1 has no name"),
        ('{"name": "a"}\n{"name": "a"}', "line 2 has no name of its own"),
        ('{"name": "a", "n": NaN}', "NaN"),
        ("[" * 100_000, "nested"),
    ],
)
def test_damaged_rows_are_named(tmp_path: Path, text: str, reason: str):
    write_text(tmp_path / ROWS_FILE, text)
    with pytest.raises(CorruptFile, match=f"{ROWS_FILE}.*{reason}"):
        stored_rows(tmp_path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "header"),
        ("name,ari\n", "header"),
        ("run,ari,ari\n", "header"),
        ("run,ari\na,0.5,1\n", "columns"),
        ("run,ari\na,0.5\na\n", "columns"),
        ("run,ari\na,half\n", "half"),
        ("run,ari\na,0.5\nb,0.5\na,0.5\n", "two places"),
        ('run,ari\na,"0.5\n', "end of data"),
    ],
)
def test_damaged_tables_are_named(tmp_path: Path, text: str, reason: str):
    for file, read in ((SCENES_FILE, stored_scenes), (CURVES_FILE, stored_curves)):
        write_text(tmp_path / file, text)
        with pytest.raises(CorruptFile, match=f"{file} is damaged"):
            read(tmp_path)
    with pytest.raises(CorruptFile, match=reason):
        stored_scenes(tmp_path)


def test_a_row_is_read_from_the_folder_that_it_refers_to(tmp_path: Path):
    write_lines(tmp_path, {"name": NAME, "value": 1, "scenes": "twin"})
    write_scenes(tmp_path, {"twin": TABLE})
    write_curves(tmp_path, {NAME: [{"step": 1.0}]})
    write_lines(tmp_path / "in", {"name": NAME, "in": ".."})
    (row,) = packed_rows(tmp_path / "in")
    assert (row["value"], row["learning_curve"]) == (1, [{"step": 1.0}])
    assert list(packed_scenes(tmp_path / "in", NAME)) == list(TABLE)


def test_a_table_of_another_folder_may_be_shared(tmp_path: Path):
    write_lines(tmp_path, {"name": "twin"})
    write_scenes(tmp_path, {"twin": TABLE})
    write_curves(tmp_path, {"twin": [{"step": 1.0}]})
    write_lines(tmp_path / "in", {"name": NAME, "scenes": "../twin", "curve": "../twin"})
    (row,) = packed_rows(tmp_path / "in")
    assert row["learning_curve"] == [{"step": 1.0}]
    assert list(packed_scenes(tmp_path / "in", NAME)) == list(TABLE)


@pytest.mark.parametrize("place", ["../elsewhere", "..", "/etc", "", "a\0b", 5, None])
def test_references_to_nothing_are_damage(tmp_path: Path, place: object):
    write_lines(tmp_path / "in", {"name": NAME, "in": place})
    with pytest.raises(CorruptFile, match=ROWS_FILE):
        list(packed_rows(tmp_path / "in"))


def test_references_to_references_are_damage(tmp_path: Path):
    write_lines(tmp_path / "a", {"name": NAME, "in": "../b"})
    write_lines(tmp_path / "b", {"name": NAME, "in": "../a"})
    with pytest.raises(CorruptFile, match="does not store the row"):
        list(packed_rows(tmp_path / "a"))


def test_tables_that_are_missing_are_damage(tmp_path: Path):
    write_lines(tmp_path, {"name": NAME})
    with pytest.raises(CorruptFile, match="no scores of"):
        packed_scenes(tmp_path, NAME)
    write_lines(tmp_path / "in", {"name": NAME, "curve": "../other"})
    with pytest.raises(CorruptFile, match="no curve of other"):
        list(packed_rows(tmp_path / "in"))


def test_a_file_that_has_changed_is_read_again(tmp_path: Path):
    for value in (0.25, 0.5):
        write_scenes(tmp_path, {NAME: {"ari": np.array([value])}})
        assert stored_scenes(tmp_path)[NAME]["ari"].tolist() == [value]
