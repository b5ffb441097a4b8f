import csv
import dataclasses
from pathlib import Path

import pytest

from benchmark import leaderboard
from benchmark.metrics import METRICS
from benchmark.runner import Result
from datagen.errors import UsageError

SCORES = dict.fromkeys(METRICS, 0.5) | dict.fromkeys(leaderboard.COUNTS, 7)
RESULT = Result("plane-dbscan", 1, "moving", "abc", "test", 0, 10, SCORES, 0.01)


def test_rows_are_added_and_replaced(tmp_path: Path):
    path = tmp_path / "new" / "leaderboard.csv"
    other = dataclasses.replace(RESULT, seed=1)
    leaderboard.update(path, [RESULT])
    leaderboard.update(path, [other])
    better = dataclasses.replace(RESULT, scores={**SCORES, "ari_fg": 0.75, "msc_fg": float("nan")})
    leaderboard.update(path, [better])
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["seed"] for row in rows] == ["0", "1"]
    assert [row["ari_fg"] for row in rows] == ["0.750000", "0.500000"]
    assert rows[0]["msc_fg"] == "nan"
    assert rows[0]["n_frames"] == "7"


def test_the_order_of_updates_does_not_matter(tmp_path: Path):
    results = [dataclasses.replace(RESULT, dataset=name) for name in ("static", "moving", "noisy")]
    for name, order in (("a.csv", results), ("b.csv", results[::-1])):
        for result in order:
            leaderboard.update(tmp_path / name, [result])
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


@pytest.mark.parametrize("content", [b"name,score\nx,1\n", b"", b"\xff\xfe\x00binary"])
def test_a_foreign_file_is_left_alone(tmp_path: Path, content: bytes):
    path = tmp_path / "mine.csv"
    path.write_bytes(content)
    with pytest.raises(UsageError, match="not a leaderboard"):
        leaderboard.update(path, [RESULT])
    assert path.read_bytes() == content


def test_a_failed_write_leaves_the_old_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "leaderboard.csv"
    leaderboard.update(path, [RESULT])
    before = path.read_bytes()

    def no_space(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", no_space)
    with pytest.raises(OSError, match="No space"):
        leaderboard.update(path, [dataclasses.replace(RESULT, seed=1)])
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["leaderboard.csv"]
