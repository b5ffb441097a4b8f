import math
from pathlib import Path

import pytest

from benchmark.csv_files import load_curve, read_csv, save_curve, to_csv
from datagen.errors import CorruptFile, UsageError


def test_cells_are_read_as_text(tmp_path: Path):
    (tmp_path / "a.csv").write_text('x,"y,z"\n1,\n2,"a\nb"\n')
    assert read_csv(tmp_path / "a.csv") == (["x", "y,z"], [["1", ""], ["2", "a\nb"]])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "cut short"),
        ("x\n1", "cut short"),
        ("x,x\n1,2\n", "two of its columns"),
        ("x,y\n1\n", "line 2 has 1 cells; expected 2"),
        ("x\n1,2\n", "line 2 has 2 cells"),
        ('x\n"1\n', "unexpected end of data"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, text: str, reason: str):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=reason):
        read_csv(tmp_path / "a.csv")


def test_other_files_are_refused(tmp_path: Path):
    (tmp_path / "a.csv").write_bytes(b"x\n\xff\n")
    with pytest.raises(CorruptFile, match="not UTF-8"):
        read_csv(tmp_path / "a.csv")
    with pytest.raises(UsageError, match="is a folder"):
        read_csv(tmp_path)
    with pytest.raises(FileNotFoundError):
        read_csv(tmp_path / "b.csv")


def test_floats_have_six_decimals_and_cells_that_a_line_lacks_are_empty():
    lines = [{"x": -1e-9, "n": 2}, {"x": -1e-6, "text": "a"}]
    assert to_csv(lines) == "x,n,text\n0.000000,2,\n-0.000001,,a\n"


def test_a_curve_is_read_as_it_was_written(tmp_path: Path):
    curve = [{"step": 1.0, "loss": 0.1 + 0.2}, {"step": 2.0, 'a,b "c"\nd': 1e-17}, {"step": 3.0, "loss": math.inf}]
    save_curve(tmp_path / "curve.csv", curve)
    assert load_curve(tmp_path / "curve.csv") == curve


def test_there_may_be_none(tmp_path: Path):
    assert load_curve(tmp_path / "curve.csv") is None


@pytest.mark.parametrize(
    "text",
    [
        "step,loss\n1,x\n",
        "step,loss\n1\n",
        "step,loss\nnan,2\n",
        "step,seconds\n1,inf\n",
    ],
)
def test_a_damaged_one_is_named(tmp_path: Path, text: str):
    (tmp_path / "curve.csv").write_text(text)
    with pytest.raises(CorruptFile, match=r"curve.csv is damaged"):
        load_curve(tmp_path / "curve.csv")
