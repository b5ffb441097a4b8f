from pathlib import Path

import pytest

from tests.benchmark.tasks.editing import oracle


@pytest.fixture(scope="session")
def edits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of `oracle.make`; not to be changed."""
    pytest.importorskip("pybullet", reason="simulation needs PyBullet")
    return oracle.make(tmp_path_factory.mktemp("edits") / "moving")
