from pathlib import Path

import pytest
import torch

from obpose.model.build import build_obpose
from obpose.scenes.model_ref import Origin, load_origin
from obpose.storage.checkpoint import save_model
from obpose.variants import make_config
from tests.worlds import generated, rendered


@pytest.fixture(scope="session")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clips of three frames in each split, one view, 32x32."""
    folder = tmp_path_factory.mktemp("creation") / "clips"
    generated.make(folder, {"train": 2, "val": 2, "test": 2})
    return folder


@pytest.fixture(scope="session")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of one frame and two views, in the split for training alone."""
    record = rendered.record(rendered.scene(frames=1, views=2), resolution=(32, 32))
    return rendered.write_dataset(tmp_path_factory.mktemp("creation") / "stills", [record, record])


@pytest.fixture(scope="session")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Checkpoint of an untrained model with small objects, several of which have room beside each other."""
    folder = tmp_path_factory.mktemp("creation") / "model"
    torch.manual_seed(0)
    sizes = {"model.pose.box_size": 0.05, "model.workspace_size": 1.5, "model.attention.inactive_points": 0}
    model = build_obpose(make_config(**sizes)).eval()
    save_model(folder, model.state_dict(), model.config, {})
    return folder


@pytest.fixture(scope="session")
def origin(checkpoint: Path) -> Origin:
    return load_origin(str(checkpoint))


def printed_table(text: str) -> list[dict[str, str]]:
    """Cells of the last Markdown table in a text, one dictionary per line."""
    lines = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    start = max(index for index, cells in enumerate(lines) if {*cells} == {"---"})
    header = [cell.strip() for cell in lines[start - 1]]
    return [dict(zip(header, (cell.strip() for cell in cells), strict=True)) for cells in lines[start + 1 :]]
