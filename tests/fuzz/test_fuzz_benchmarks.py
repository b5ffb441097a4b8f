"""Predictions, rows, scores, label maps, curves and edits of the benchmark that are damaged."""

from pathlib import Path

import pytest

from tests.fuzz.inputs import faults_among
from tests.fuzz.running import endings_of

INPUTS = 250


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_damaged_files_end_in_plain_messages(tmp_path: Path):
    endings = endings_of(tmp_path, "benchmarks", INPUTS)
    assert len(endings) >= 0.98 * INPUTS
    assert {ending.code for ending in endings} >= {0, 2, 3}
    # A training that cannot go on is a failed row: the table and the row's reason tell of it, in words of the model.
    rows = [ending for ending in endings if ending.file.startswith("unfinished/") and "did not name" in ending.fault]
    assert len(rows) <= 10
    assert faults_among([ending for ending in endings if ending not in rows]) == ""
