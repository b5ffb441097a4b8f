from pathlib import Path

import pytest

from obpose.checkpoint import save_model
from obpose.creation.origin import Origin, load_origin
from obpose.model import ObPose
from tests import small, staged
from tests.benchmark.adapters.claims import told


@pytest.fixture(scope="session")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clips of three frames in each split, one view, 32x32."""
    folder = tmp_path_factory.mktemp("creation") / "clips"
    small.make(folder, {"train": 2, "val": 2, "test": 2})
    return folder


@pytest.fixture(scope="session")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of one frame and two views, in the split for training alone."""
    record = staged.record(staged.scene(frames=1, views=2), resolution=(32, 32))
    return staged.write_dataset(tmp_path_factory.mktemp("creation") / "stills", [record, record])


@pytest.fixture(scope="session")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of an untrained model."""
    folder = tmp_path_factory.mktemp("creation") / "model"
    model: ObPose = told.untrained()
    save_model(folder, model.state_dict(), model.config, {})
    return folder


@pytest.fixture(scope="session")
def origin(checkpoint: Path) -> Origin:
    return load_origin(str(checkpoint))
