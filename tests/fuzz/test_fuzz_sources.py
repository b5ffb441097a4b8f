"""Meshes, cameras and datasets of other projects that are damaged."""

from pathlib import Path

import pytest

from tests.fuzz.inputs import faults_among
from tests.fuzz.running import endings_of

INPUTS = 200


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_damaged_files_end_in_plain_messages(tmp_path: Path):
    endings = endings_of(tmp_path, "sources", INPUTS)
    assert len(endings) >= 0.98 * INPUTS
    assert {ending.code for ending in endings} >= {0, 2, 3}
    assert faults_among(endings) == ""
