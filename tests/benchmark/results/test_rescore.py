"""Label maps that were exchanged or damaged since they were made."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmark.results.rescore import rescore
from benchmark.results.run_folder import load_runs
from datagen.errors import CorruptFile
from tests.worlds.runs import MODELS, write_runs


@pytest.fixture
def run(tmp_path: Path) -> Path:
    write_runs(tmp_path, scenes=2, seeds=1, models={name: MODELS[name] for name in ("merger", "splitter")})
    return tmp_path / "run"


def test_scores_come_out_as_before_and_progress_is_shown(run: Path, tmp_path: Path):
    before = {path.name: path.read_bytes() for path in (run / "scenes").iterdir()}
    heard: list[str] = []

    def progress(items, title: str):
        heard.append(f"{title} {len(items)}")
        return items

    assert rescore(run, load_runs(run), [tmp_path / "moving", tmp_path / "static"], progress=progress) == 4
    assert {path.name: path.read_bytes() for path in (run / "scenes").iterdir()} == before
    assert heard == ["scoring rows 4"]


def test_label_maps_of_another_dataset_are_named(run: Path, tmp_path: Path):
    path = next((run / "labels").glob("moving--merger--*"))
    with h5py.File(path, "a") as file:
        del file["labels"]
        file["labels"] = np.zeros((1, 1, 1, 4, 4), np.uint8)
    with pytest.raises(
        CorruptFile, match=rf"{path.name} does not fit the dataset's scenes: it has label maps of shape"
    ):
        rescore(run, load_runs(run), [tmp_path / "moving", tmp_path / "static"])
