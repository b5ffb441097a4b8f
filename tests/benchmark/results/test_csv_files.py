from pathlib import Path

import pytest

from benchmark.results.csv_files import read_csv
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
