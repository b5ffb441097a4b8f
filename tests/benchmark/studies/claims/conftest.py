from pathlib import Path

import pytest

from tests.benchmark.studies.claims import oracle_model


@pytest.fixture(scope="session")
def claims_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle_model.dataset(tmp_path_factory.mktemp("claims") / "data")


@pytest.fixture
def short_clips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three frames are enough for a slot to follow an object."""
    monkeypatch.setattr("benchmark.studies.claims.scenes.LEAST_FRAMES", 1)
