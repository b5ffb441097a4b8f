"""Some thirty damaged files; `make test-slow` has thousands."""

from pathlib import Path

from tests.fuzz.inputs import faults_among
from tests.fuzz.running import endings_of


def test_damaged_files_end_in_plain_messages(tmp_path: Path):
    endings = endings_of(tmp_path, "smoke", 30)
    assert len(endings) >= 28
    assert {ending.code for ending in endings} >= {0, 3}
    assert faults_among(endings) == ""
