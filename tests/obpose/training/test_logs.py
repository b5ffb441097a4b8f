import csv
import sys
from pathlib import Path

import pytest

from obpose.errors import UsageError
from obpose.training.logs import CsvLog, TensorBoardLog


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_rows_are_there_as_soon_as_they_are_written(tmp_path: Path):
    log = CsvLog(tmp_path / "log.csv", steps=0)
    log.write({"step": 1, "total": 0.1})
    assert table(tmp_path / "log.csv") == [{"step": "1", "total": "0.1"}]


def test_values_are_read_back_exactly(tmp_path: Path):
    value = 0.1 + 0.2
    CsvLog(tmp_path / "log.csv", steps=0).write({"step": 1, "total": value})
    assert float(table(tmp_path / "log.csv")[0]["total"]) == value


def test_a_name_that_comes_later_has_a_column_for_all_rows(tmp_path: Path):
    log = CsvLog(tmp_path / "log.csv", steps=0)
    log.write({"step": 1, "colour": 1.0})
    log.write({"step": 2, "colour": 2.0, "air": 3.0})
    log.write({"step": 3, "air": 4.0})
    assert table(tmp_path / "log.csv") == [
        {"step": "1", "colour": "1.0", "air": ""},
        {"step": "2", "colour": "2.0", "air": "3.0"},
        {"step": "3", "colour": "", "air": "4.0"},
    ]


def test_a_run_that_goes_on_drops_what_it_will_do_again(tmp_path: Path):
    path = tmp_path / "log.csv"
    log = CsvLog(path, steps=0)
    for step in (1, 2, 3):
        log.write({"step": step, "total": float(step)})
    with path.open("a") as file:
        file.write("2,0.")  # a kill cut the line short
    log = CsvLog(path, steps=2)
    log.write({"step": 3, "total": 9.0})
    assert [row["total"] for row in table(path)] == ["1.0", "2.0", "9.0"]


def test_tensorboard_gets_the_same_values(tmp_path: Path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    log = TensorBoardLog(tmp_path, steps=0)
    for step in (1, 2):
        log.write("training", {"step": step, "total": step / 4})
    log.close()
    events = accumulator.EventAccumulator(str(tmp_path)).Reload()
    assert [(event.step, event.value) for event in events.Scalars("training/total")] == [(1, 0.25), (2, 0.5)]


def test_without_tensorboard_the_remedy_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard.writer", None)
    with pytest.raises(UsageError, match="pip install"):
        TensorBoardLog(tmp_path, steps=0)


def test_rows_that_a_crash_damaged_are_dropped(tmp_path: Path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"step,total\n1,0.5\n\0\0\0,\0\xff\n,\n2,3,4,5\n2,0.25\n")
    CsvLog(path, steps=2)
    assert [row["total"] for row in table(path)] == ["0.5", "0.25"]


@pytest.mark.parametrize(
    "text",
    [
        "name,grade\nAda,1\n",
        "accuracy,step\n0.9,1\n",
        '"' + 200_000 * "x" + '"\n1\n',
        "\0step\n1\n",
        "\n\n",
        "step;total\n1;2\n",
        "name,grade",
    ],
)
def test_a_table_of_somebody_else_is_not_overwritten(tmp_path: Path, text: str):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"log\.csv is no table of a training"):
        CsvLog(path, steps=9)
    assert path.read_text() == text


@pytest.mark.parametrize("row", ["9" * 5000 + ",1", "٣,1", "-1,1", "1.5,1", "x,1", "1,2,3"])
def test_rows_that_are_damaged_are_dropped(tmp_path: Path, row: str):
    path = tmp_path / "log.csv"
    path.write_text(f"step,total\n1,0.5\n{row}\n2,0.25\n")
    CsvLog(path, steps=9)
    assert [row["total"] for row in table(path)] == ["0.5", "0.25"]
