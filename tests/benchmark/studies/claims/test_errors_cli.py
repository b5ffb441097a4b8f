from pathlib import Path

import numpy as np
import pytest

from benchmark.models.interface import Prediction
from benchmark.results.labels import write_labels
from benchmark.studies.claims.errors_cli import dealt_with, main
from datagen.errors import EXIT_USAGE
from datagen.storage.reader import Dataset
from tests.worlds.traced import write_dataset


def test_objects_that_share_a_slot_from_the_second_frame_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    data = write_dataset(tmp_path / "data", scenes=3, frames=4, spheres=3)
    with write_labels(tmp_path / "one.h5", 3, data) as writer:
        for index, record in enumerate(Dataset(data).split("test")):
            labels = record["segmentation"].astype(np.int64)
            labels[1:] = np.where(labels[1:] > 0, 1, 0)
            writer.put(index, Prediction(labels, 0))
    objects, found = dealt_with(tmp_path / "one.h5", data)
    assert (found.overlap[objects.frame == 0] == 1).all()
    merged = found.errors[:, 0] == 1
    several = objects.companions > 1
    assert several.any()
    assert np.array_equal(merged, several & (objects.frame > 0))
    assert main([str(tmp_path / "one.h5")]) == 0
    said = capsys.readouterr().out
    assert "merged: shares its slot with another object" in said
    assert f"one.h5: merged {merged.mean():.0%}, split 0%, missed 0%, leaked 0%" in said
    assert "mean best IoU 1.000 in first frames" in said
    least = objects.companions.min()
    assert f"  {least} in view: merged {merged[objects.companions == least].mean():.0%}, split 0%" in said


def test_a_missing_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    data = write_dataset(tmp_path / "data")
    with write_labels(tmp_path / "one.h5", 0, data):
        pass
    assert main([str(tmp_path / "one.h5"), str(tmp_path / "none.h5")]) == EXIT_USAGE
    said, told = capsys.readouterr()
    assert not said
    assert "none.h5; expected label maps" in told
    assert "delete" not in told
