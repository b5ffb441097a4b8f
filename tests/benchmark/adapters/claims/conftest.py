from pathlib import Path

import pytest

from tests.benchmark.adapters.claims import told


@pytest.fixture(scope="session")
def claims_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return told.dataset(tmp_path_factory.mktemp("claims") / "data")


@pytest.fixture
def short_clips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three frames are enough for a slot to follow an object."""
    monkeypatch.setattr("benchmark.adapters.claims.scenes.LEAST_FRAMES", 1)
